"""An inertial actuator such as an LRA in a phone: a moving mass in a case, by its datasheet.

Resonance f0 and quality Q are those of the mounted actuator with open terminals, with the moving mass vibrating
against the case: k = mu (2 pi f0)^2 and c = mu 2 pi f0 / Q with the reduced mass mu = m M / (m + M). Datasheets state
them on a jig of some 100 g, which is then the case. Outputs: "position" and "velocity" of the mass against the case,
and "current" if a voltage drives a coil with an inductance.
"""

from typing import Literal, Self

import numpy as np

from transopt.base.section import Positive
from transopt.plant.moving_coil import Mechanics, MovingCoil


class Inertial(MovingCoil):
    """A mass on a spring that shakes its case, such as an LRA, by f0, Q, moving mass, force factor, R and L.

    Attributes
    ----------
    resonance_Hz : f0 with open terminals, in the stated case.
    quality : mechanical Q with open terminals.
    moving_mass_kg : mass that moves inside the case.
    case_mass_kg : mass of the case and of what is mounted on it, which shall shake.
    """

    kind: Literal["inertial"]
    resonance_Hz: Positive
    quality: Positive
    moving_mass_kg: Positive
    case_mass_kg: Positive

    def produced(self, resonance: float, quality: float) -> Self:
        return self.model_copy(
            update={"resonance_Hz": resonance * self.resonance_Hz, "quality": quality * self.quality}
        )

    @property
    def mechanics(self) -> Mechanics:
        w = 2 * np.pi * self.resonance_Hz
        reduced_kg = self.moving_mass_kg * self.case_mass_kg / (self.moving_mass_kg + self.case_mass_kg)
        return Mechanics(self.moving_mass_kg, self.case_mass_kg, reduced_kg * w**2, reduced_kg * w / self.quality)
