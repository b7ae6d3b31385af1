"""Tap error of one tap over its binding limits, as curves for the page; every point is solved and certified."""

from dataclasses import dataclass, replace

import numpy as np

from transopt.design.context import Posed
from transopt.design.design import design
from transopt.design.entry import Entry
from transopt.design.price import Price
from transopt.problem.answer import Status
from transopt.solvers.options import SolverOptions

TIGHTEST = 0.5  # lower end of the curve, as a share of the present limit
POINTS = 4  # points solved in addition to those of the price


@dataclass(frozen=True)
class Priced:
    """The price of one limit that binds.

    Attributes
    ----------
    sentence : the price in words.
    label, unit : label and unit of the limit.
    now : present limit.
    points : (bound, tap error) of certified optima, increasing in the bound; the dearest limit's from half of it on.
    """

    sentence: str
    label: str
    unit: str
    now: float
    points: tuple[tuple[float, float], ...]


def priced(posed: Posed, entry: Entry, options: SolverOptions) -> tuple[Priced, ...]:
    """Prices of the limits that bind at an admitted entry, dearest first; that one has the longest curve."""
    found = []
    for number, price in enumerate(entry.prices):
        points = _known(price)
        if number == 0:
            points |= _solved(posed, entry, price, options)
        found.append(Priced(price.sentence, price.limit, price.unit, price.bound, tuple(sorted(points.items()))))
    return tuple(found)


def _known(price: Price) -> dict[float, float]:
    """Bound -> tap error of the points that the price contains."""
    found = {price.bound: price.tap_error, price.bound + price.step: price.then, price.enough: price.there}
    return {bound: error for bound, error in found.items() if np.isfinite(bound) and np.isfinite(error)}


def _solved(posed: Posed, entry: Entry, price: Price, options: SolverOptions) -> dict[float, float]:
    """Bound -> tap error at further bounds: below the limit, and up to where it no longer matters."""
    limit = next((each for each in entry.problem.limits if each.label == price.limit), None)
    if limit is None or limit.step_unit != limit.unit:
        return {}  # a share of a temperature has no meaning, as its zero is arbitrary
    outwards = np.sign(price.step) * limit.key_scale
    widest = (price.enough if np.isfinite(price.enough) else price.bound + price.step) - price.bound
    raised = np.linspace((TIGHTEST - 1) * limit.room, max(widest / outwards, 0.0), POINTS + 2)[:-1]
    bounds = price.bound + outwards * raised
    problems = [posed.problem.replaced(limit.raised(float(by))) for by in raised]
    found = design([replace(posed, problem=problem) for problem in problems], options=options)
    return {
        float(bound): other.problem.yardstick.tap_error(other.uncorrected, other.lasting_m_s2)
        for bound, other in zip(bounds, found, strict=True)
        if other.solution.status is Status.OPTIMAL and other.certificate.accepted
    }
