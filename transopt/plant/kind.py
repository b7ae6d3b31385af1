"""What a kind of plant is: the table `[model]` of a scene, and the state space that it makes of it at a grip.

A new kind of plant is a file beside this one with a class of this interface, named in `transopt.plant.kinds`. Its
keys are then keys of a scene, and its named outputs may be limited (`limits.own`); nothing else has to know it.
"""

from abc import abstractmethod
from typing import ClassVar

from transopt.base.section import Section
from transopt.plant.motor import Tip
from transopt.plant.state_space import StateSpace


class PlantKind(Section):
    """A kind of plant; each has a field `kind`, by whose word a scene chooses it.

    Attributes
    ----------
    through_transmission : whether it needs the stiffness and the damping of the transmission at the tip.
    """

    through_transmission: ClassVar[bool] = False

    @abstractmethod
    def plant(self, grip_N: float, tip: Tip, *, struck: bool = False) -> StateSpace:
        """The model at one grip from motor current [A], or with `struck` from a force on the stylus [N].

        Parameters
        ----------
        grip_N : 0 where nobody holds the stylus.
        tip : what the stylus feels of the motor.

        Raises
        ------
        InputError : parameters that are not passive at this grip.
        """
