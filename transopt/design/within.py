"""Number of instants per servo period at which limits on outputs are stated: enough for a margin that costs little.

A limit is tightened by a margin d for the time between its instants (`limits.output`). The optimal J is convex in d
with derivative sum mu, the sum of the limit's multipliers, so J(0) >= J(d) - d sum mu: the multipliers of an answer
bound the cost of its margin. If that cost is above `MOST_COST`, or if the margin does not cover the possible
excursion between the instants, the limit is stated at 2, 4, 8 ... instants.
"""

from collections.abc import Mapping

import numpy as np

from transopt.problem.answer import OBJECTIVE_SCALE, Certificate, Multipliers
from transopt.problem.limits.output import MOST_KEPT, PARTS, OutputLimit
from transopt.problem.problem import TransientProblem
from transopt.proof.designed import Designed
from transopt.proof.effect import Effect

MOST_COST = 5e-3  # largest cost of the margins, relative to J without them
AIM = 3e-3  # relative cost aimed at when instants are added, and the largest one once there are any
FINE, FINE_PARTS = 1e-3, 8  # margin, relative to the limit, with which infeasibility is judged; most parts for it
MOST_ROWS = 96  # rows of all limits together; leaves the project's own solver some rows for other terms


def finer(designed: Designed) -> dict[str, int]:
    """Limits to be stated at more instants -> number of parts of a servo period; empty if none is needed."""
    problem, solution = designed.problem, designed.solution
    if not problem.parts:
        return {}
    if not designed.is_proven:
        return _finer(problem, {limit.name: FINE * limit.limit for limit in _of_outputs(problem)}, FINE_PARTS)
    wanted = {
        limit.name: MOST_KEPT * limit.limit for limit in _of_outputs(problem) if not _covered(limit, designed.effect)
    }
    costs = {limit.name: margin_cost(limit, problem, solution.multipliers) for limit in _of_outputs(problem)}
    least = Certificate.GAP_TOLERANCE * OBJECTIVE_SCALE  # a certificate does not resolve smaller differences
    without = max(designed.certificate.objective - sum(costs.values()), 0.0)
    most = MOST_COST if max(problem.parts.values(), default=1) == 1 else AIM
    if sum(costs.values()) > max(most * without, least):
        # Divide the allowed cost evenly among the limits, at the present multipliers.
        dear = {name: cost for name, cost in costs.items() if cost > least / len(costs)}
        for name, cost in dear.items():
            enough = AIM * without / len(dear) / cost * problem.limits[name].kept_back
            wanted[name] = min(enough, wanted.get(name, np.inf))
    return _finer(problem, wanted, PARTS[-1])


def margin_cost(limit: OutputLimit, problem: TransientProblem, multipliers: Multipliers) -> float:
    """Upper bound on the increase of J due to the margin of a limit."""
    return sum(
        limit.margin(row.device) * float((multipliers.lower(row.name) + multipliers.upper(row.name)).sum())
        for row in limit.rows(problem)
    )


def why_no_more_instants(designed: Designed) -> dict[str, str]:
    """Left-out part, a limit on an output at still more instants -> why it is left out.

    A nonlinear plant keeps the switching instants. J is not convex there, so the cost holds to first order only.
    """
    known = "at most" if designed.nonlinear is None else "to first order"
    problem, multipliers, J = designed.problem, designed.solution.multipliers, designed.certificate.objective
    found = {}
    for limit in _of_outputs(problem):
        cost = margin_cost(limit, problem, multipliers) / max(J, np.finfo(float).tiny)
        stated = "at the switching instants" if limit.parts == 1 else f"at {limit.parts} instants of a servo period"
        found[f"{limit.label} at more instants"] = (
            f"it is stated {stated}: the {limit.kept_back:.2g} {limit.unit} that it keeps back between them cost "
            f"{known} {100 * cost:.2g} % of J"
        )
    return found


def _of_outputs(problem: TransientProblem) -> list[OutputLimit]:
    return [limit for limit in problem.limits if isinstance(limit, OutputLimit)]


def _covered(limit: OutputLimit, effect: Effect) -> bool:
    """Whether the answer's values at the instants plus the possible excursion between them keep a limit."""
    return all(
        float(np.abs(effect.value(row)).max()) + limit.excursion(row.device) <= limit.limit + limit.tolerance
        for row in limit.rows(effect.problem)
    )


def _finer(problem: TransientProblem, wanted: Mapping[str, float], most: int) -> dict[str, int]:
    """Number of parts for each limit at which its excursion between the instants falls to about the wanted value."""
    limits, found = _of_outputs(problem), dict[str, int]()
    others = sum(not isinstance(limit, OutputLimit) for limit, _ in problem.rows())
    each = (MOST_ROWS - others) / max(len(limits) * len(problem.devices), 1)
    for limit in limits:
        parts, now = limit.parts, limit
        while _excursion(now) > wanted.get(limit.name, np.inf) and 2 * parts <= min(most, each):
            parts *= 2
            now = limit.within(problem, parts)
        if parts > limit.parts and _excursion(now) < _excursion(limit):
            found[limit.name] = parts
    return found


def _excursion(limit: OutputLimit) -> float:
    return max(limit.excursion(device) for device in range(len(limit.bends)))
