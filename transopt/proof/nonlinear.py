"""Certificate of a stationary point on a nonlinear plant, independent of the solver.

The command is rolled out by the nonlinear stage. The gradient of the Lagrangian follows from the adjoint of that
recursion, with derivatives by complex steps through the plant's formulas. Only the command and the multipliers of the
limits come from IPOPT, and nothing from CasADi. The dynamics have no multipliers here; the adjoint states replace
them.
"""

from dataclasses import replace
from functools import cached_property

import numpy as np

from transopt.base.signals import FloatArray
from transopt.plant.discretise import Motion
from transopt.plant.nonlinear_stage import Linearised
from transopt.problem.answer import Certificate, Multipliers
from transopt.problem.limits.row import transposed
from transopt.problem.nonlinear import NonlinearProblem
from transopt.problem.objective.tracking import gradients
from transopt.proof.certify import admissible, is_stated, left_over
from transopt.proof.effect import Effect, boxes


class NonlinearEffect(Effect):
    """What a command (N,) does on a nonlinear plant: limits and figures read it as what one does on a linear plant.

    Attributes
    ----------
    problem : that of the plant at rest, whose objective and limits are those on the nonlinear plant.
    """

    def __init__(self, problem: NonlinearProblem, command: FloatArray) -> None:
        super().__init__(problem.linear, command)
        self.stage = problem.stage

    @cached_property
    def states(self) -> FloatArray:
        """(N + M + 1, n)."""
        return self.stage.states(self.continued)

    @cached_property
    def lasting(self) -> Motion:
        """(N + M,) through the window and after it."""
        return self.stage.motion(self.continued, self.states)

    @cached_property
    def linearised(self) -> Linearised:
        """Derivatives along the motion."""
        return self.stage.linearised(self.continued, self.states)

    @property
    def finite(self) -> bool:
        """Whether the motion has a value everywhere."""
        return bool(np.isfinite(self.states).all())

    @property
    def objective(self) -> float:
        """J."""
        return self.problem.objective(self.command, self.accelerations_m_s2, self.motion.plant_input)


def reduced_gradient(effect: NonlinearEffect, multipliers: Multipliers) -> FloatArray:
    """(N,) gradient by the commands of J + sum mu (constraint) + sum hand_over c [1/A or 1/V]."""
    linear, command, m = effect.problem, effect.command, multipliers
    by_row = [(row, m.upper(row.name) - m.lower(row.name)) for _, row in linear.rows() if row.name in m.pairs]
    through, by_command = transposed(by_row, effect.motion, command)
    by_error = gradients([linear.tracking], effect.lasting.acceleration_m_s2[None, None], linear.shared)[0, 0]
    by_input = through.plant_input + linear.heat.gradient(effect.motion.plant_input)
    through = replace(through, plant_input=by_input)
    by_motion = replace(through.padded(linear.grid.after_stages), acceleration_m_s2=by_error)
    by_continued = effect.stage.adjoint(effect.linearised, by_motion)
    # The command after the window is zero, so gradients by it are dropped.
    found = by_continued[: command.size] + linear.movement.gradient(command) + by_command
    found[linear.free_stages :] += m.hand_over
    return np.asarray(found)


def with_hand_over(effect: NonlinearEffect, multipliers: Multipliers) -> Multipliers:
    """Complete multipliers by those of the hand-over, which cancel the gradient of the others there."""
    silent = replace(multipliers, hand_over=np.zeros_like(multipliers.hand_over))
    if not effect.finite:
        return silent
    return replace(silent, hand_over=-reduced_gradient(effect, silent)[effect.problem.free_stages :])


def certify_nonlinear(
    problem: NonlinearProblem,
    command: FloatArray,
    multipliers: Multipliers,
    *,
    effect: NonlinearEffect | None = None,
) -> Certificate:
    """Certify that a command is a stationary point. The problem is not convex, so no bound on the optimum follows.

    As in the convex problem (`certify.certify`) the gap is sum_j mu_j s_j + sum_k |g_k| (c_max + |c_k|) with the
    slacks s and the reduced gradient g. It is zero at a KKT point, and otherwise the possible decrease of J to first
    order. `lower_bound` is minus infinity.

    Parameters
    ----------
    command : (N,).
    effect : effect of the command, if it is known already.
    """
    linear = problem.linear
    if not is_stated(linear, command, multipliers):
        return Certificate.nothing()
    effect, clipped = effect or NonlinearEffect(problem, command), admissible(linear, multipliers)
    if not effect.finite or not np.isfinite(effect.objective):
        return Certificate.nothing()
    limits, tail = boxes(linear, command, effect.motion, clipped), command[linear.free_stages :]
    outside = [(box.limit, float(box.excess.max())) for box in limits]
    violations, excess = left_over(linear, outside, float(np.abs(tail).max()))
    g = reduced_gradient(effect, clipped)
    gap = float(np.abs(g) @ (linear.command_bound + np.abs(command)))
    gap += sum(box.complementarity for box in limits) + float(np.abs(clipped.hand_over) @ np.abs(tail))
    return Certificate(
        objective=effect.objective,
        merit=effect.objective,
        violations=violations,
        excess=excess,
        dual_residual=float(np.abs(g).max()),
        duality_gap=gap if np.isfinite(gap) else float("inf"),
        lower_bound=-float("inf"),
        finite=True,
    )
