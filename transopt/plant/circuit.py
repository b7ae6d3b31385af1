"""The motor's terminal voltage, and the supply rail that it may not pass."""

from dataclasses import dataclass

import numpy as np

from transopt.base.errors import InputError
from transopt.base.signals import FloatArray
from transopt.plant.discretise import Motion


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


@dataclass(frozen=True)
class Supply:
    """|V| <= limit just before and just after each switching instant, through an amplifier of one pole.

    Between two instants R i + L di/dt goes monotonically from the value after the one to the value before the next.
    The voltage is therefore checked at both sides of each instant and nowhere between.

    Attributes
    ----------
    limit_V : > 0.
    circuit : the motor's.
    pole_rad_s : w of di/dt = w (c - i).
    nominal_m_s : (N,) velocity of the nominal motion at tau_k; the back-EMF follows dz/dt, not dy/dt.
    """

    limit_V: float
    circuit: Circuit
    pole_rad_s: float
    nominal_m_s: FloatArray

    def __post_init__(self) -> None:
        if not 0 < self.limit_V < np.inf:
            raise InputError(f"limits.supply_V = {self.limit_V:g}: must be > 0 and finite")

    @property
    def by_current(self) -> float:
        """dV/di at a fixed command: R - L w [ohm]."""
        return self.circuit.R_ohm - self.by_command

    @property
    def by_command(self) -> float:
        """dV/dc: L w [ohm]."""
        return self.circuit.L_H * self.pole_rad_s

    @property
    def nominal_V(self) -> FloatArray:
        """(N,) back-EMF of the nominal motion."""
        return self.circuit.emf_V_s_m * self.nominal_m_s

    def voltages_V(self, motion: Motion, command_A: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(N,) terminal voltage just before and just after each switching instant."""
        held = np.append(0.0, command_A[:-1])
        common = self.by_current * motion.current_A + self.circuit.emf_V_s_m * motion.velocity_m_s + self.nominal_V
        return common + self.by_command * held, common + self.by_command * command_A

    def transpose(self, by_before: FloatArray, by_after: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Gradients (N,) by current, velocity and command for gradients by the two voltages."""
        both = by_before + by_after
        by_command = self.by_command * (by_after + np.append(by_before[1:], 0.0))
        return self.by_current * both, self.circuit.emf_V_s_m * both, by_command
