"""The second waveform of an entry: the optimum at a stated share of the heat, found by a price on heat.

J + price sum i^2 is convex, and its minimiser is the best tap of all those with no more heat than it makes itself:
for any admissible command with as little heat J is no smaller, up to the certified gap. The heat falls as the price
rises. So all that is searched for is one number, as for intensity.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from transopt.problem.problem import TransientProblem
from transopt.proof.designed import Designed

CLOSE = 2e-3  # of the heat, between what is asked for and what is attained: less than a coil's estimate knows
MOST_PROBLEMS = 24
FIRST = 0.1  # of the objective of rest, that all of the first waveform's heat costs at the first price
FARTHEST = 30.0  # by which a price is multiplied or divided before there is a bracket


def heat_of(designed: Designed) -> float:
    """Sum of i^2 over the window of an answer [A^2 or V^2]."""
    current = designed.effect.motion.plant_input
    return float(current @ current)


def at_share_of_heat(
    problem: TransientProblem, first: Designed, share: float, solve: Callable[[TransientProblem], Designed]
) -> Designed:
    """The optimum with so large a share of the heat of the first one.

    Parameters
    ----------
    problem : of the first answer; a price on heat that it has already is where the search begins from below.
    share : of the heat, between 0 and 1.
    solve : the optimum of a problem.

    Returns
    -------
    The answer at the price that was found; its heat is within 0.2 % of what is asked for, or the nearest below it.
    Where the first answer has no heat, or none is proven, the first answer itself.
    """
    whole = heat_of(first)
    if not (first.is_proven and whole > 0):
        return first
    wanted, low, high = np.log(share * whole), (0.0, np.log(whole)), (np.inf, -np.inf)
    price, best = max(FIRST / whole, 2 * problem.heat_price), first
    for _ in range(MOST_PROBLEMS):
        found = solve(replace(problem, heat_price=price))
        heat = heat_of(found)
        if not (found.is_proven and heat > 0):
            break
        point = (price, float(np.log(heat)))
        if point[1] <= wanted + CLOSE:
            best, high = found, point
        else:
            low = point
        if abs(point[1] - wanted) <= CLOSE:
            break
        price = _next(low, high, float(wanted))
    return best


def _next(low: tuple[float, float], high: tuple[float, float], wanted: float) -> float:
    """The price to try next, between one that leaves too much heat and one that leaves too little."""
    if not np.isfinite(high[0]):
        return low[0] * FARTHEST
    if low[0] == 0:
        return high[0] / FARTHEST if high[1] < wanted - 1 else high[0] * 0.5
    # The logarithms of price and heat go about evenly; the chord's point stays off the ends of the bracket.
    share = float(np.clip((low[1] - wanted) / (low[1] - high[1]), 0.05, 0.95))
    return float(low[0] * (high[0] / low[0]) ** share)
