"""The optimal-control problem of one entry on a nonlinear plant: objective and limits as on a linear one."""

from dataclasses import dataclass

import numpy as np

from transopt.base.errors import InputError
from transopt.base.shown import brief
from transopt.base.signals import FloatArray
from transopt.plant.nonlinear_stage import NonlinearStage
from transopt.problem.objective.figures import Figures
from transopt.problem.problem import TransientProblem


@dataclass(frozen=True)
class NonlinearProblem:
    """Minimise J of `TransientProblem` within its limits, with the motion of the nonlinear stage.

    Every term of J and every limit is that of the linear problem: tracking, movement, the tail after the window, and
    the rows of the limits with their margins for the time between the switching instants.

    Attributes
    ----------
    linear : the problem for the plant linearised at rest.
    stage : the nonlinear device over a servo period, with the outputs of the linear stage.

    Raises
    ------
    InputError : the linear problem has a part that is not implemented for nonlinear plants.
    """

    linear: TransientProblem
    stage: NonlinearStage

    __repr__ = brief

    def __post_init__(self) -> None:
        linear = self.linear
        for said, there in (
            ("robust", bool(linear.spread)),
            ("feedback", linear.wall is not None),
            ("limits.supply_V", "supply" in linear.limits),
            ("model.winding", linear.thermal is not None),
            ("limits.own with an expression that is not linear", bool(linear.nonlinear) and linear.thermal is None),
        ):
            if there:
                raise InputError(f"{said}: not with model.nonlinear; leave one of the two out")

    def figures(self, command: FloatArray) -> Figures:
        """Figures of a command (N,) on the nonlinear plant; NaN where its motion diverges."""
        with np.errstate(all="ignore"):
            lasting = self.linear.continued(command)
            motion = self.stage.motion(lasting, self.stage.states(lasting))
            return self.linear.figures(motion.acceleration_m_s2)
