"""Stylus and hand as one mass on one spring and damper: the seed's Fig. 4a.

Outputs: "position" and "velocity" of the mass, also called "stylus position" and "stylus velocity".
"""

from typing import ClassVar, Literal

from transopt.plant.chain import Link, chain
from transopt.plant.hand import LinearInGrip
from transopt.plant.kind import PlantKind
from transopt.plant.motor import Tip
from transopt.plant.state_space import StateSpace

SEED_HAND_MASS_KG = LinearInGrip(0.215, -0.00328)  # seed Eq. 3
SEED_HAND_DAMPING_N_S_M = LinearInGrip(6.713, 0.369)  # seed Eq. 4
SEED_HAND_STIFFNESS_N_M = LinearInGrip(75.65, 14.72)  # seed Eq. 5


def second_order(
    grip_N: float,
    *,
    force_per_current_N_A: float,
    mass_kg: LinearInGrip = SEED_HAND_MASS_KG,
    damping_N_s_m: LinearInGrip = SEED_HAND_DAMPING_N_S_M,
    stiffness_N_m: LinearInGrip = SEED_HAND_STIFFNESS_N_M,
) -> StateSpace:
    """Stylus and hand as one mass on one spring and damper (seed Fig. 4a), by default with the fits of Eqs. 3-5.

    The fits describe the whole hand during real taps. The mass of Eq. 3 falls to zero at a grip of 65 N.

    Raises
    ------
    InputError : parameters that are not passive at this grip.
    """
    link = Link(stiffness_N_m.at(grip_N), damping_N_s_m.at(grip_N))
    return chain(
        [mass_kg.at(grip_N)], [link], force_per_current_N_A=force_per_current_N_A, stylus=0, names=("stylus",)
    )


class SecondOrder(PlantKind):
    """The whole hand as one mass (seed Fig. 4a)."""

    is_chain: ClassVar[bool] = True

    kind: Literal["second_order"]

    def plant(self, grip_N: float, tip: Tip | None, *, struck: bool = False) -> StateSpace:
        assert tip is not None
        return second_order(grip_N, force_per_current_N_A=1.0 if struck else tip.force_per_current_N_A)
