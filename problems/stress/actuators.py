"""Random moving-coil actuators for stress cases, in a case or on the ground, driven by a current or a voltage."""

from dataclasses import dataclass

import numpy as np

from transopt.plant.moving_coil import VoiceCoil
from transopt.plant.state_space import CURRENT_INPUT, VOLTAGE_INPUT, Input, StateSpace


@dataclass(frozen=True)
class Actuator:
    """The actuator of a stress case, in place of motor, stylus and hand.

    Attributes
    ----------
    resonance_Hz, quality : of the moving part relative to its support, with open terminals.
    moving_kg : moving mass.
    case_kg : mass of the case; None where the support is the ground.
    force_N_A : force per ampere, and back-EMF per m/s.
    R_ohm, L_H : resistance and inductance of the coil.
    by_voltage : whether the input is a voltage, otherwise a current.
    stroke, velocity : limits over the static deflection, and over the velocity at resonance, under the largest force;
        None for no limit.
    current : limit on a voltage-driven coil's current, over the largest voltage divided by R; None for no limit.
    sag : share of the voltage that the supply provides from the middle of the waveform on; None for no sag.
    """

    resonance_Hz: float = 150.0
    quality: float = 8.0
    moving_kg: float = 3e-3
    case_kg: float | None = 0.1
    force_N_A: float = 1.0
    R_ohm: float = 8.0
    L_H: float = 1e-4
    by_voltage: bool = True
    stroke: float | None = None
    velocity: float | None = None
    current: float | None = None
    sag: float | None = None

    @property
    def driven_by(self) -> Input:
        """The actuator's input, a current or a voltage."""
        return VOLTAGE_INPUT if self.by_voltage else CURRENT_INPUT

    @property
    def _stiffness_N_m(self) -> float:
        m, M = self.moving_kg, self.case_kg
        return (m if M is None else m * M / (m + M)) * (2 * np.pi * self.resonance_Hz) ** 2

    def plant(self) -> StateSpace:
        """The model from the input to the acceleration of the case, or of the moving part on the ground.

        Raises
        ------
        InputError : numbers that no actuator can have.
        """
        w = 2 * np.pi * self.resonance_Hz
        coil = VoiceCoil(
            kind="voice_coil",
            input="voltage" if self.by_voltage else "current",
            moving_mass_kg=self.moving_kg,
            case_mass_kg=self.case_kg,
            stiffness_N_m=self._stiffness_N_m,
            damping_N_s_m=self._stiffness_N_m / (w * self.quality),
            force_factor_N_A=self.force_N_A,
            R_ohm=self.R_ohm,
            L_H=self.L_H,
        )
        return coil.plant(0.0, None)

    def limits(self, largest: float, lasts_s: float) -> dict[str, float | list[list[float]] | None]:
        """Key below a scene's `limits` -> number, for a largest input and a waveform of this length."""
        force_N = self.force_N_A * (largest / self.R_ohm if self.by_voltage else largest)
        at_rest_m = force_N / self._stiffness_N_m
        return {
            "stroke_m": None if self.stroke is None else self.stroke * at_rest_m,
            "velocity_m_s": None
            if self.velocity is None
            else self.velocity * at_rest_m * 2 * np.pi * self.resonance_Hz,
            **(
                {
                    "current_A": None
                    if self.current is None or self.L_H == 0
                    else self.current * largest / self.R_ohm,
                    "sag": None if self.sag is None else [[0.0, 1.0], [lasts_s / 2, self.sag]],
                }
                if self.by_voltage
                else {}
            ),
        }
