"""What a kind of plant is: the table `[model]` of a scene, and the state space that it makes of it at a grip.

A new kind of plant is a file beside this one with a class of this interface, named in `transopt.plant.kinds`. Its
keys are then keys of a scene, and its named outputs may be limited (`limits.own`); nothing else has to know it.
"""

from abc import abstractmethod
from typing import ClassVar

from transopt.base.section import Section
from transopt.plant.circuit import Circuit
from transopt.plant.motor import Tip, Winding
from transopt.plant.state_space import CURRENT_INPUT, Input, StateSpace


class PlantKind(Section):
    """A kind of plant; each has a field `kind`, by whose word a scene chooses it.

    Attributes
    ----------
    through_transmission : whether it needs the stiffness and the damping of the transmission at the tip.
    driven_at_tip : whether the scene states what drives it, by motor and transmission or by a tip; a kind that is a
        whole actuator states its own drive.
    held_by_hand : whether it depends on the grip; else grip 0 is its only one.
    is_chain : whether its states are the elongations of a chain of masses, then their velocities.
    """

    through_transmission: ClassVar[bool] = False
    driven_at_tip: ClassVar[bool] = True
    held_by_hand: ClassVar[bool] = True
    is_chain: ClassVar[bool] = False

    @property
    def driven_by(self) -> Input:
        """What its input is."""
        return CURRENT_INPUT

    def circuit(self) -> Circuit | None:
        """Terminals of the actuator, where a whole actuator states them."""
        return None

    @property
    def known_winding(self) -> Winding | None:
        """How its winding heats, where a whole actuator states it."""
        return None

    @abstractmethod
    def plant(self, grip_N: float, tip: Tip | None, *, struck: bool = False) -> StateSpace:
        """The model at one grip from its input, or with `struck` from a force on the stylus [N].

        Parameters
        ----------
        grip_N : 0 where nobody holds the stylus.
        tip : what the stylus feels of the motor; None for a kind that is not `driven_at_tip`.

        Raises
        ------
        InputError : parameters that are not passive at this grip.
        """
