"""Problems with other limits than their scene's, or with another target."""

from dataclasses import replace

import numpy as np

from transopt.base.signals import FloatArray
from transopt.problem.answer import Multipliers
from transopt.problem.limits import KINDS, limits_of
from transopt.problem.limits.command import CommandLimit
from transopt.problem.limits.current import CurrentLimit
from transopt.problem.limits.limit import Limit, Limits
from transopt.problem.limits.slew import SlewLimit
from transopt.problem.limits.supply import SupplyLimit
from transopt.problem.problem import TransientProblem

MADE = {"current_A": CurrentLimit, "command_A": CommandLimit}


def numbers_of(limits: Limits, dt_s: float, **numbers: float | None) -> Limits:
    """Change numbers, by the keys current_A, command_A and slew_A_per_s; None takes a limit out."""
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


def aiming_in_window(problem: TransientProblem, reference_m_s2: FloatArray) -> TransientProblem:
    """The problem with another target (N,) within the window."""
    return problem.aiming_at(replace(problem.target, window_m_s2=reference_m_s2))


def command_limit_A(problem: TransientProblem) -> float:
    """The amplifier's range; of a problem whose amplifier is not ideal."""
    return problem.limits["command"].stated


def supply_of(problem: TransientProblem) -> SupplyLimit:
    """The rail of a problem that has one."""
    found = problem.limits["supply"]
    assert isinstance(found, SupplyLimit)
    return found


def with_rail(problem: TransientProblem, limit_V: float) -> TransientProblem:
    """The problem with its rail at another voltage."""
    return problem.replaced(replace(supply_of(problem), limit_V=limit_V))


def drawn_ray(problem: TransientProblem, random: np.random.Generator, scale: float = 1.0) -> Multipliers:
    """Multipliers by lot on a twentieth of all bounds that any kind of limit may have, in force or not."""
    N = problem.grid.stages
    ray = Multipliers.zero(problem)
    for row in (row for kind in KINDS for row in kind.row_names):
        lower, upper = (scale * random.exponential(size=N) * (random.random(N) < 0.05) for _ in range(2))
        ray = ray.with_pair(row, lower, upper)
    return ray


def with_limit(problem: TransientProblem, limit: Limit | None) -> TransientProblem:
    """The problem with this limit too, in the place of the one of its name."""
    if limit is None:
        return problem
    return replace(problem, limits=limits_of(*problem.limits.without(limit.name), limit))
