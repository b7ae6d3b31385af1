"""The interface of a kind of plant: the table `[model]` of a scene, and the state space built from it at a grip.

To add a kind of plant, write a class of this interface and name it in `transopt.plant.kinds`. Its
keys are then keys of a scene, and limits may be stated on its named outputs (`limits.own`); no other code changes.
"""

from abc import abstractmethod
from typing import Annotated, ClassVar

from pydantic import Field

from transopt.base.section import Section
from transopt.plant.coil import Circuit
from transopt.plant.motor import Tip, Winding
from transopt.plant.state_space import CURRENT_INPUT, Input, StateSpace

# Share of the limit on the input that one of several motors has.
Share = Annotated[float, Field(gt=0, le=1)]


class PlantKind(Section):
    """A kind of plant; the scene selects it by the value of the field `kind`.

    Attributes
    ----------
    through_transmission : whether it needs stiffness and damping of the transmission at the tip.
    driven_at_tip : whether the scene states its drive separately, by motor and transmission or by a tip; a kind that
        is a complete actuator includes its drive.
    held_by_hand : whether it depends on the grip; otherwise its only grip is 0.
    is_chain : whether its states are the elongations of a chain of masses, then their rates.
    """

    through_transmission: ClassVar[bool] = False
    driven_at_tip: ClassVar[bool] = True
    held_by_hand: ClassVar[bool] = True
    is_chain: ClassVar[bool] = False

    @property
    def driven_by(self) -> Input:
        """The plant's input, a current or a voltage."""
        return CURRENT_INPUT

    @property
    def shares(self) -> list[float]:
        """Share of the limit on the input that each of several motors has; empty for a single motor."""
        return []

    @property
    def directions(self) -> int:
        """Number of tracked accelerations, the one that a target is for first."""
        return 1

    def circuit(self) -> Circuit | None:
        """Circuit at the actuator's terminals; None if the kind does not state it."""
        return None

    @property
    def known_winding(self) -> Winding | None:
        """Thermal data of the winding; None if the kind does not state them."""
        return None

    @abstractmethod
    def plant(self, grip_N: float, tip: Tip | None, *, struck: bool = False) -> StateSpace:
        """The model at one grip; with `struck` its input is a force on the stylus [N] in place of the drive's.

        Parameters
        ----------
        grip_N : 0 for a free stylus.
        tip : the drive as it acts at the tip; None for a kind that is not `driven_at_tip`.

        Raises
        ------
        InputError : parameters that are not passive at this grip.
        """
