"""Problems with other limits than their scene's."""

from dataclasses import replace

from transopt.problem.limits import limits_of
from transopt.problem.limits.command import CommandLimit
from transopt.problem.limits.current import CurrentLimit
from transopt.problem.limits.limit import Limit, Limits
from transopt.problem.limits.slew import SlewLimit
from transopt.problem.problem import TransientProblem

MADE = {"current_A": CurrentLimit, "command_A": CommandLimit}


def numbers_of(limits: Limits, dt_s: float, **numbers: float | None) -> Limits:
    """With other numbers, by the keys current_A, command_A and slew_A_per_s; None takes a limit out."""
    found = {limit.name: limit for limit in limits}
    for key, value in numbers.items():
        kind = MADE.get(key, SlewLimit)
        found.pop(kind.name, None)
        if value is not None:
            found[kind.name] = SlewLimit(value, dt_s) if kind is SlewLimit else MADE[key](value)
    return limits_of(*found.values())


def with_numbers(problem: TransientProblem, **numbers: float | None) -> TransientProblem:
    """The problem with `numbers_of`."""
    return replace(problem, limits=numbers_of(problem.limits, problem.grid.dt_s, **numbers))


def with_limit(problem: TransientProblem, limit: Limit | None) -> TransientProblem:
    """The problem with this limit too, in the place of the one of its name."""
    if limit is None:
        return problem
    return replace(problem, limits=limits_of(*problem.limits.without(limit.name), limit))
