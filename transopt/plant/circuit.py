"""The motor's terminal voltage, and the supply rail that it may not pass."""

from dataclasses import dataclass

import numpy as np

from transopt.base.signals import FloatArray


@dataclass(frozen=True)
class Circuit:
    """Motor terminals: V = R i + L di/dt + k_e w, the back-EMF stated at the tip.

    Attributes
    ----------
    R_ohm : resistance of the winding.
    L_H : its inductance.
    emf_V_s_m : k_e times the transmission's ratio: volt per m/s of the stylus tip; in SI also the force per ampere.
    """

    R_ohm: float
    L_H: float
    emf_V_s_m: float

    def voltage_V(self, current_A: FloatArray, rate_A_s: FloatArray | float, velocity_m_s: FloatArray) -> FloatArray:
        """V for a current, its rate, and the velocity of the motor mass dz/dt, (...) each."""
        return np.asarray(self.R_ohm * current_A + self.L_H * rate_A_s + self.emf_V_s_m * velocity_m_s)
