"""The electric circuit at the terminals of a motor or coil."""

from dataclasses import dataclass, replace

import numpy as np

from transopt.base.signals import FloatArray
from transopt.plant.coil import COPPER_PER_K, RESISTANCE_REFERENCE_C


@dataclass(frozen=True)
class Circuit:
    """Motor terminals: V = R i + L di/dt + k_e w, the back-EMF stated at the tip.

    Attributes
    ----------
    R_ohm : resistance of the winding; that of a datasheet holds at 25 C.
    L_H : inductance of the winding.
    emf_V_s_m : back-EMF per m/s of the stylus tip, k_e times the transmission's ratio; in SI equal to the force per
        ampere.
    """

    R_ohm: float
    L_H: float
    emf_V_s_m: float

    def voltage_V(self, current_A: FloatArray, rate_A_s: FloatArray | float, velocity_m_s: FloatArray) -> FloatArray:
        """V for a current, its rate, and the velocity of the motor mass dz/dt, (...) each."""
        return np.asarray(self.R_ohm * current_A + self.L_H * rate_A_s + self.emf_V_s_m * velocity_m_s)

    def at(self, winding_C: float) -> "Circuit":
        """The circuit with the copper at another temperature, where this one states R at 25 C."""
        warmer = 1 + COPPER_PER_K * (winding_C - RESISTANCE_REFERENCE_C)
        return replace(self, R_ohm=self.R_ohm * warmer)
