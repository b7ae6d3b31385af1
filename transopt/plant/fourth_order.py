"""A hand-held stylus with the drive rigidly on it: the seed's Fig. 4b.

Outputs: "position" and "velocity" of the stylus, also called "stylus position" and "stylus velocity", and at grips
above 0 "hand position" and "hand velocity".
"""

from typing import ClassVar, Literal

from transopt.base.section import Positive
from transopt.plant.chain import chain
from transopt.plant.hand import HandSection, held
from transopt.plant.kind import PlantKind
from transopt.plant.motor import Tip
from transopt.plant.state_space import StateSpace


def fourth_order(
    grip_N: float, *, hand: HandSection, stylus_mass_kg: float, moving_mass_kg: float, force_per_current_N_A: float
) -> StateSpace:
    """The chain stylus and drive - skin - hand mass - arm (seed Fig. 4b); a free mass at grip 0.

    Raises
    ------
    InputError : parameters that are not passive at this grip.
    """
    masses, links = held([stylus_mass_kg + moving_mass_kg], [], hand, grip_N)
    return chain(
        masses, links, force_per_current_N_A=force_per_current_N_A, stylus=0, names=("stylus", "hand")[: len(masses)]
    )


class FourthOrder(PlantKind):
    """Stylus and hand (seed Fig. 4b).

    Attributes
    ----------
    stylus_mass_kg : mass of the stylus without the drive.
    """

    is_chain: ClassVar[bool] = True

    kind: Literal["fourth_order"]
    stylus_mass_kg: Positive
    hand: HandSection

    def plant(self, grip_N: float, tip: Tip | None, *, struck: bool = False) -> StateSpace:
        assert tip is not None
        return fourth_order(
            grip_N,
            hand=self.hand,
            stylus_mass_kg=self.stylus_mass_kg,
            moving_mass_kg=tip.moving_mass_kg,
            force_per_current_N_A=1.0 if struck else tip.force_per_current_N_A,
        )
