"""A voice coil: at the tip of a stylus or a shaker's table, or with a moving magnet in a case.

Outputs: "position" and "velocity" of the moving part relative to its support, and "current" if a voltage drives a
coil with an inductance.
"""

from typing import Literal, Self

from transopt.base.section import NonNegative, Positive
from transopt.plant.motor import Winding
from transopt.plant.moving_coil import Mechanics, MovingCoil


class VoiceCoil(MovingCoil):
    """A coil in a magnet, by moving mass, suspension, force factor BL, R and L; in a case if one is stated.

    The coil's temperature is modelled if `winding` is stated and the input is a current.

    Attributes
    ----------
    moving_mass_kg : mass that moves relative to the ground or the case.
    case_mass_kg : mass of the case, which shall shake; without it the support is the ground.
    stiffness_N_m : spring of the suspension.
    damping_N_s_m : damper of the suspension.
    winding : table of the coil's thermal data.
    """

    kind: Literal["voice_coil"]
    moving_mass_kg: Positive
    case_mass_kg: Positive | None = None
    stiffness_N_m: NonNegative = 0.0
    damping_N_s_m: NonNegative
    winding: Winding | None = None

    @property
    def known_winding(self) -> Winding | None:
        return self.winding

    def produced(self, resonance: float, quality: float) -> Self:
        # w0^2 = k / mu, Q = sqrt(k mu) / c.
        return self.model_copy(
            update={
                "stiffness_N_m": resonance**2 * self.stiffness_N_m,
                "damping_N_s_m": resonance / quality * self.damping_N_s_m,
            }
        )

    @property
    def mechanics(self) -> Mechanics:
        return Mechanics(self.moving_mass_kg, self.case_mass_kg, self.stiffness_N_m, self.damping_N_s_m)
