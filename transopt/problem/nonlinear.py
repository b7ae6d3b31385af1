"""The optimal-control problem of one entry on a nonlinear plant: objective and limits as on a linear one."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from transopt.base.errors import InputError
from transopt.base.shown import brief
from transopt.base.signals import FloatArray
from transopt.plant.discretise import Motion
from transopt.plant.nonlinear_stage import Linearised, NonlinearStage
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

    def effect(self, command: FloatArray) -> "NonlinearEffect":
        """The motion and objective under a command (N,)."""
        return NonlinearEffect(self, command)

    def figures(self, command: FloatArray) -> Figures:
        """Figures of a command (N,) on the nonlinear plant; NaN where its motion diverges."""
        with np.errstate(all="ignore"):
            return self.linear.figures(self.effect(command).lasting.acceleration_m_s2)


class NonlinearEffect:
    """Motion, derivatives and objective of a problem under a command (N,), each computed on first use."""

    def __init__(self, problem: NonlinearProblem, command: FloatArray) -> None:
        self.problem, self.command = problem, command

    @cached_property
    def continued(self) -> FloatArray:
        """(N + M,) the command, zero after the window."""
        return self.problem.linear.continued(self.command)

    @cached_property
    def states(self) -> FloatArray:
        """(N + M + 1, n) states at the switching instants."""
        return self.problem.stage.states(self.continued)

    @cached_property
    def lasting(self) -> Motion:
        """(N + M,) motion through the window and after it."""
        return self.problem.stage.motion(self.continued, self.states)

    @cached_property
    def motion(self) -> Motion:
        """(N,) motion within the window."""
        return self.lasting.first(self.command.size)

    @cached_property
    def linearised(self) -> Linearised:
        """Derivatives along the motion."""
        return self.problem.stage.linearised(self.continued, self.states)

    @property
    def finite(self) -> bool:
        """Whether no state is NaN or infinite."""
        return bool(np.isfinite(self.states).all())

    @property
    def objective(self) -> float:
        """J."""
        made = self.lasting.acceleration_m_s2[None]
        return self.problem.linear.objective(self.command, made, self.motion.plant_input)
