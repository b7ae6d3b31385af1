"""The default device: a motor that drives a hand-held stylus through a transmission.

Outputs: "position" and "velocity" of the motor mass, also called "motor position" and "motor velocity"; the same for
"stylus" and, at grips above 0, "hand"; and "transmission stretch", the displacement between motor and stylus.
"""

from typing import ClassVar, Literal

import numpy as np

from transopt.base.section import Positive
from transopt.plant.chain import Link, chain
from transopt.plant.hand import HandSection, held
from transopt.plant.kind import PlantKind
from transopt.plant.motor import Tip
from transopt.plant.state_space import Output, StateSpace


def drive(
    grip_N: float,
    *,
    hand: HandSection,
    stylus_mass_kg: float,
    moving_mass_kg: float,
    transmission: Link,
    force_per_current_N_A: float,
    driven: int = 0,
) -> StateSpace:
    """The chain motor mass - transmission - stylus - skin - hand mass - arm, with the encoder on the motor mass.

    At grip 0 the chain ends with the stylus, which is free.

    Parameters
    ----------
    driven : 0 for a force on the motor mass, 1 for one on the stylus.

    Raises
    ------
    InputError : parameters that are not passive at this grip.
    """
    masses, links = held([moving_mass_kg, stylus_mass_kg], [transmission], hand, grip_N)
    return chain(
        masses,
        links,
        force_per_current_N_A=force_per_current_N_A,
        driven=driven,
        stylus=1,
        names=("motor", "stylus", "hand")[: len(masses)],
        further={"transmission stretch": Output(np.eye(1, 2 * len(masses)), "m")},
    )


class Drive(PlantKind):
    """Motor, transmission, stylus and hand.

    Attributes
    ----------
    stylus_mass_kg : mass beyond the transmission, that of the accelerometer.
    """

    is_chain: ClassVar[bool] = True
    through_transmission: ClassVar[bool] = True

    kind: Literal["drive"]
    stylus_mass_kg: Positive
    hand: HandSection

    def plant(self, grip_N: float, tip: Tip | None, *, struck: bool = False) -> StateSpace:
        assert tip is not None
        assert tip.stiffness_N_m is not None
        assert tip.damping_N_s_m is not None
        return drive(
            grip_N,
            hand=self.hand,
            stylus_mass_kg=self.stylus_mass_kg,
            moving_mass_kg=tip.moving_mass_kg,
            transmission=Link(tip.stiffness_N_m, tip.damping_N_s_m),
            force_per_current_N_A=1.0 if struck else tip.force_per_current_N_A,
            driven=1 if struck else 0,
        )
