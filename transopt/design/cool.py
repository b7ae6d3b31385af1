"""The cool command of an entry: the optimum with a stated share of the first command's heat, by a price on heat.

J + price sum i^2 is convex. Its minimiser has the smallest J of all admissible commands that make no more heat than
it does, up to the certified gap. The heat falls as the price rises, so the search is for one scalar, the price, as it
is for intensity.
"""

from dataclasses import dataclass, replace

import numpy as np

from transopt.design.context import Posed
from transopt.design.intensity import best
from transopt.proof.designed import Designed
from transopt.solvers.options import SolverOptions
from transopt.solvers.side_by_side import Search

CLOSE = 2e-3  # share of the allowed heat that may be left unused; a coil's heat is not known more accurately
MOST_PROBLEMS = 24
FIRST = 0.1  # cost of the first command's heat at the first price, relative to the objective of zero command
FARTHEST = 30.0  # factor by which the price grows until a price with little enough heat is known
INSET = 0.05  # share of the bracket by which the next price keeps away from its ends


@dataclass(frozen=True)
class _Tried:
    """A price [1/A^2] whose problem was solved, its optimum, and the logarithm of the heat that this makes."""

    price: float
    log_heat: float
    designed: Designed


def at_share_of_heat(posed: Posed, first: Designed, share: float, options: SolverOptions) -> Search[Designed]:
    """Search for the optimum with at most a given share of the first answer's heat.

    Parameters
    ----------
    posed : the problem of the first answer; the search starts at the price on heat that it already has, if any.
    first : its optimum.
    share : allowed heat relative to that of `first`, between 0 and 1.

    Returns
    -------
    The optimum at the price that was found; its heat in the window is at most 0.2 % below the allowed heat. If the
    hand-over to a wall needs more heat than allowed, it is the optimum with the least heat found. If `first` makes no
    heat or is not proven, it is `first` itself.
    """
    whole = first.effect.heat_A2
    if not (first.is_proven and whole > 0):
        return first
    wanted, spent_s = float(np.log(share * whole)), 0.0
    warm, cold = _Tried(posed.problem.heat_price, float(np.log(whole)), first), None
    price, latest = max(FIRST / whole, 2 * warm.price), first
    for _ in range(MOST_PROBLEMS):
        problem = replace(posed.problem.within(first.problem.parts), heat_price=price, shares=latest.problem.shares)
        designed = latest = yield from best(problem, options, objective=posed.objective)
        spent_s += designed.solution.solve_time_s
        heat = designed.effect.heat_A2
        if not (designed.is_proven and heat > 0):
            break
        tried = _Tried(price, float(np.log(heat)), designed)
        if cold is None and tried.log_heat > max(wanted, warm.log_heat - CLOSE):
            break
        if tried.log_heat <= wanted:
            cold = tried
        else:
            warm = tried
        if wanted - CLOSE <= tried.log_heat <= wanted:
            break
        price = _next(warm, cold, wanted - CLOSE / 2)
    found = (warm if cold is None else cold).designed
    return replace(found, solution=replace(found.solution, solve_time_s=spent_s))


def _next(warm: _Tried, cold: _Tried | None, wanted: float) -> float:
    """The price to try next, between one that leaves too much heat and one that leaves too little."""
    if cold is None:
        return warm.price * FARTHEST
    # Interpolate the logarithm of the heat linearly: in the price where the warm end has price 0, otherwise in the
    # logarithm of the price.
    place = float(np.clip((warm.log_heat - wanted) / (warm.log_heat - cold.log_heat), INSET, 1 - INSET))
    if warm.price == 0:
        return cold.price * place
    return float(warm.price * (cold.price / warm.price) ** place)
