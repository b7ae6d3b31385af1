"""The optimal-control problem of one entry on a nonlinear plant: the linear one's words, another device."""

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
    """Minimise J of `TransientProblem` within its limits, the motion being the nonlinear stage's.

    Every term of J and every limit is what the linear problem has: tracking, movement, what comes after the window,
    the rows of the limits with what they keep back for the time between the switching instants.

    Attributes
    ----------
    linear : the problem of the plant as it is at rest.
    stage : the nonlinear device over a period, its outputs those of the linear stage.

    Raises
    ------
    InputError : a part of the linear problem that no nonlinear plant can have yet.
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
        """What a command (N,) does."""
        return NonlinearEffect(self, command)

    def figures(self, command: FloatArray) -> Figures:
        """Figures of a command (N,) on the nonlinear plant, by its stage; NaN where its motion has no value."""
        with np.errstate(all="ignore"):
            return self.linear.figures(self.effect(command).lasting.acceleration_m_s2)


class NonlinearEffect:
    """What a command (N,) does in a problem, each part computed when it is first asked for and then kept."""

    def __init__(self, problem: NonlinearProblem, command: FloatArray) -> None:
        self.problem, self.command = problem, command

    @cached_property
    def continued(self) -> FloatArray:
        """(N + M,) the command, and zero after it."""
        return self.problem.linear.continued(self.command)

    @cached_property
    def states(self) -> FloatArray:
        """(N + M + 1, n)."""
        return self.problem.stage.states(self.continued)

    @cached_property
    def lasting(self) -> Motion:
        """(N + M,) through the window and after it."""
        return self.problem.stage.motion(self.continued, self.states)

    @cached_property
    def motion(self) -> Motion:
        """(N,) within the window."""
        return self.lasting.first(self.command.size)

    @cached_property
    def linearised(self) -> Linearised:
        """Derivatives along the motion."""
        return self.problem.stage.linearised(self.continued, self.states)

    @property
    def finite(self) -> bool:
        """Whether the motion has a value everywhere."""
        return bool(np.isfinite(self.states).all())

    @property
    def objective(self) -> float:
        """J."""
        made = self.lasting.acceleration_m_s2[None]
        return self.problem.linear.objective(self.command, made, self.motion.plant_input)
