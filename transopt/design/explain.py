"""Why no command meets all limits: which limit, by how much, when, and what would do."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from transopt.base.signals import FloatArray
from transopt.base.writing import rounded_up
from transopt.problem.answer import Multipliers, Status
from transopt.problem.limits import hand_over
from transopt.problem.limits.limit import Limit
from transopt.problem.problem import TransientProblem
from transopt.proof.certify import Box, boxes, certify
from transopt.solvers.choose import capable, solve
from transopt.solvers.feasibility import least_widening
from transopt.solvers.options import SolverOptions

WIDEST = 64.0  # times the limit: beyond, widening it alone is no remedy
MOST_ITERATIONS = 100
GROWS = 1e-6  # per tick: more than rounding
MOST_SOLVERS = 2  # asked whether a limit can be met
PRECISION = 0.005  # relative, of the least limit that would do


def unstable_wall(problem: TransientProblem) -> str:
    """Whether the pressing wall grows by itself on this device; empty if it does not."""
    if problem.wall is None:
        return ""
    wall, growth = problem.wall.wall, hand_over.growth(problem)
    if growth <= 1 + GROWS:
        return ""
    keys = (
        ("feedback.stiffness_N_m", wall.stiffness_N_m, " N/m"),
        ("feedback.damping_N_s_m", wall.damping_N_s_m, " N s/m"),
        ("feedback.latency_ticks", wall.latency_ticks, ""),
    )
    lower = " or ".join(f"{key} ({value:g}{unit})" for key, value, unit in keys if value > 0)
    return f"feedback: on this device the pressing wall grows {growth:.4g} times per tick; lower {lower}"


def unavoidable(problem: TransientProblem) -> list[str]:
    """Limits that are missed whatever is commanded: known without a solve."""
    return [said for limit in reversed(problem.limits.members) if (said := limit.unavoidable(problem))]


def _feasible(problem: TransientProblem, options: SolverOptions) -> FloatArray | None:
    """A command inside all limits, optimal or not, from the first solver that finds one or says there is none."""
    briefly = replace(options, max_iterations=min(options.max_iterations, MOST_ITERATIONS))
    for name in capable(problem)[:MOST_SOLVERS]:
        answer = solve(problem, replace(briefly, solver=name))
        if certify(problem, answer.command_A, answer.multipliers).excess <= 1:
            return answer.command_A
        if answer.status is Status.INFEASIBLE:
            return None
    return None


def infeasibility(problem: TransientProblem, options: SolverOptions) -> list[str]:
    """One sentence for each limit whose widening alone would help or, if none would, for all of them together.

    Empty if even that is not enough. What the linear limits lack is found by linear programs; only where they can be
    met it is the temperature, whose least limit is found by bisection. The command that just meets the wider limit
    tells by how much and when the stated one is missed.
    """
    linear = [limit for limit in reversed(problem.limits.members) if limit.linear]
    together = least_widening(problem, [limit.name for limit in linear])
    if together is None:
        return []
    if together[0] > 1:
        found = []
        for limit in linear:
            least = least_widening(problem, [limit.name])
            if least is not None:
                found.append(_sentence(problem, problem.replaced(limit.wider(least[0])), limit, least[1]))
        if found:
            return found
        factor, command = together
        wide = problem
        for limit in linear:
            wide = wide.replaced(limit.wider(factor))
        missed = [limit for limit in linear if _worst(problem, limit, command)[1] > 0]
        return [f"{_sentence(problem, wide, limit, command)}, all limits wider at once" for limit in missed]
    for limit in problem.limits:
        if limit.linear:
            continue
        found_least = _least(lambda factor, limit=limit: problem.replaced(limit.wider(factor)), options)  # type: ignore[misc]
        if found_least is not None:
            wide = problem.replaced(limit.wider(found_least[0]))
            return [_sentence(problem, wide, limit, found_least[1])]
    return []


def _least(widen: Callable[[float], TransientProblem], options: SolverOptions) -> tuple[float, FloatArray] | None:
    """The least factor, to `PRECISION`, at which a command meets all limits, and that command; None if none does."""
    command = _feasible(widen(WIDEST), options)
    if command is None:
        return None
    low, high = 1.0, WIDEST
    while high / low > 1 + PRECISION:
        middle = float(np.sqrt(low * high))
        tried = _feasible(widen(middle), options)
        if tried is None:
            low = middle
        else:
            high, command = middle, tried
    return high, command


def _worst(problem: TransientProblem, limit: Limit, command_A: FloatArray) -> tuple[Box, float]:
    """The row of a limit that a command leaves farthest, and how far; negative inside."""
    motion = problem.stage.motion(command_A)
    of = [box for box in boxes(problem, command_A, motion, Multipliers.zero(problem)) if box.limit.name == limit.name]
    worst = max(of, key=lambda box: float(box.excess.max()))
    return worst, float(worst.excess.max())


def _sentence(problem: TransientProblem, wide: TransientProblem, limit: Limit, command_A: FloatArray) -> str:
    worst, _ = _worst(problem, limit, command_A)
    k = int(np.argmax(worst.excess))
    time_ms = problem.grid.switching_times_s[k] * 1e3
    enough, unit = wide.limits[limit.name].stated, limit.unit
    if limit is problem.thermal:
        # What is widened there is the headroom over the unpowered course.
        motion, unit = problem.stage.motion(command_A), limit.step_unit
        found = boxes(wide, command_A, motion, Multipliers.zero(problem))
        wider = [box for box in found if box.limit.name == limit.name]
        enough = float(wider[0].upper[np.isfinite(wider[0].upper)].max())
    return (
        f"{limit.label} {worst.excess[k]:.3g} {unit} over its {limit.stated:.8g} {limit.unit} at {time_ms:.1f} ms at "
        f"the least; {rounded_up(enough):.8g} {limit.unit} would do"
    )
