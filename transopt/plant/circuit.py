"""The motor's terminal voltage, and the supply rail that it may not pass."""

from dataclasses import dataclass, replace

import numpy as np

from transopt.base.signals import FloatArray
from transopt.plant.coil import COPPER_PER_K, RESISTANCE_REFERENCE_C


@dataclass(frozen=True)
class Circuit:
    """Motor terminals: V = R i + L di/dt + k_e w, the back-EMF stated at the tip.

    Attributes
    ----------
    R_ohm : resistance of the winding; of one from a datasheet at 25 C.
    L_H : its inductance.
    emf_V_s_m : k_e times the transmission's ratio: volt per m/s of the stylus tip; in SI also the force per ampere.
    """

    R_ohm: float
    L_H: float
    emf_V_s_m: float

    def voltage_V(self, current_A: FloatArray, rate_A_s: FloatArray | float, velocity_m_s: FloatArray) -> FloatArray:
        """V for a current, its rate, and the velocity of the motor mass dz/dt, (...) each."""
        return np.asarray(self.R_ohm * current_A + self.L_H * rate_A_s + self.emf_V_s_m * velocity_m_s)

    def at(self, winding_C: float) -> "Circuit":
        """Terminals with the copper at another temperature, from a datasheet that states R at 25 C."""
        warmer = 1 + COPPER_PER_K * (winding_C - RESISTANCE_REFERENCE_C)
        return replace(self, R_ohm=self.R_ohm * warmer)
