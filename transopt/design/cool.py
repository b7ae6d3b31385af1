"""The cool command of an entry: the optimum at a stated share of the first one's heat, found by a price on heat.

J + price sum i^2 is convex, and its minimiser is the best tap of all those with no more heat than it makes itself:
for any admissible command with as little heat J is no smaller, up to the certified gap. The heat falls as the price
rises. All that is searched for is therefore one number, as for intensity.
"""

from dataclasses import dataclass, replace

import numpy as np

from transopt.design.context import Posed
from transopt.design.intensity import best
from transopt.proof.designed import Designed
from transopt.solvers.options import SolverOptions
from transopt.solvers.side_by_side import Search

CLOSE = 2e-3  # relative, between the heat that is asked for and the heat attained: less than a coil's estimate knows
MOST_PROBLEMS = 24
FIRST = 0.1  # of the objective of rest, that all of the first command's heat costs at the first price
FARTHEST = 30.0  # by which a price is multiplied before one is known that leaves too little heat
INSET = 0.05  # of a bracket, which the next price stays away from its ends


@dataclass(frozen=True)
class _Tried:
    """A price that was solved for [1/A^2], with the logarithm of the heat that its optimum makes."""

    price: float
    log_heat: float
    designed: Designed


def heat_of(designed: Designed) -> float:
    """Sum of i^2 over the window of an answer [A^2]."""
    current = designed.effect.motion.plant_input
    return float(current @ current)


def at_share_of_heat(posed: Posed, first: Designed, share: float, options: SolverOptions) -> Search[Designed]:
    """Search for the optimum with no more than a share of the heat of the first answer.

    Parameters
    ----------
    posed : the problem of the first answer; a price on heat that it has already is where the search begins.
    first : its optimum.
    share : of the heat, between 0 and 1.

    Returns
    -------
    The optimum at the price that was found, whose heat is within 0.2 % of what is asked for. Where a hand-over to a
    wall asks for more heat than that, it is the optimum with the least heat that was found. Where the first answer
    makes no heat or is not proven, it is the first answer.
    """
    whole = heat_of(first)
    if not (first.is_proven and whole > 0):
        return first
    wanted, spent_s = float(np.log(share * whole)), 0.0
    warm, cold = _Tried(posed.problem.heat_price, float(np.log(whole)), first), None
    price = max(FIRST / whole, 2 * warm.price)
    for _ in range(MOST_PROBLEMS):
        problem = replace(posed.problem.within(first.problem.parts), heat_price=price)
        designed = yield from best(problem, options, objective=posed.objective)
        spent_s += designed.solution.solve_time_s
        heat = heat_of(designed)
        if not (designed.is_proven and heat > 0):
            break
        tried = _Tried(price, float(np.log(heat)), designed)
        if cold is None and tried.log_heat > max(wanted, warm.log_heat - CLOSE):
            break
        if tried.log_heat <= wanted + CLOSE:
            cold = tried
        else:
            warm = tried
        if abs(tried.log_heat - wanted) <= CLOSE:
            break
        price = _next(warm, cold, wanted)
    found = (warm if cold is None else cold).designed
    return replace(found, solution=replace(found.solution, solve_time_s=spent_s))


def _next(warm: _Tried, cold: _Tried | None, wanted: float) -> float:
    """The price to try next, between one that leaves too much heat and one that leaves too little."""
    if cold is None:
        return warm.price * FARTHEST
    # From a warm end without a price on, the logarithm of the heat is taken to fall in proportion to the price.
    place = float(np.clip((warm.log_heat - wanted) / (warm.log_heat - cold.log_heat), INSET, 1 - INSET))
    if warm.price == 0:
        return cold.price * place
    return float(warm.price * (cold.price / warm.price) ** place)
