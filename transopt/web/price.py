"""What wider limits buy for one tap, as the curves that the page draws: every point is solved and certified."""

from dataclasses import dataclass, replace

import numpy as np

from transopt.design.context import Posed
from transopt.design.design import design
from transopt.design.entry import Entry
from transopt.design.price import Price
from transopt.problem.answer import Status
from transopt.solvers.options import SolverOptions

TIGHTEST = 0.5  # of the limit as it stands: where the curve begins
POINTS = 4  # that are solved beside those of the price


@dataclass(frozen=True)
class Priced:
    """The price of one limit that binds.

    Attributes
    ----------
    sentence : in words.
    label, unit : of the limit.
    now : where it stands.
    points : (bound, tap error) of certified optima, rising in the bound; for the dearest limit from half of it on.
    """

    sentence: str
    label: str
    unit: str
    now: float
    points: tuple[tuple[float, float], ...]


def priced(posed: Posed, entry: Entry, options: SolverOptions) -> tuple[Priced, ...]:
    """Prices of the limits that bind at an admitted entry, the dearest first and with the longest curve."""
    found = []
    for number, price in enumerate(entry.prices):
        points = _known(price)
        if number == 0:
            points |= _solved(posed, entry, price, options)
        found.append(Priced(price.sentence, price.limit, price.unit, price.bound, tuple(sorted(points.items()))))
    return tuple(found)


def _known(price: Price) -> dict[float, float]:
    """Bound -> tap error, as the price has them."""
    found = {price.bound: price.tap_error, price.bound + price.step: price.then, price.enough: price.there}
    return {bound: error for bound, error in found.items() if np.isfinite(bound) and np.isfinite(error)}


def _solved(posed: Posed, entry: Entry, price: Price, options: SolverOptions) -> dict[float, float]:
    """Bound -> tap error at some bounds more: below the limit, and between it and where it stops mattering."""
    limit = next((each for each in entry.problem.limits if each.label == price.limit), None)
    if limit is None or not price.bound > 0 or limit.step_unit != limit.unit:
        return {}  # a temperature counts from a zero of its own
    widest = price.enough if np.isfinite(price.enough) else price.bound + price.step
    asked = np.linspace(TIGHTEST * price.bound, max(widest, price.bound), POINTS + 2)[:-1]
    problems = [posed.problem.replaced(limit.raised(float(bound) - price.bound)) for bound in asked]
    found = design([replace(posed, problem=problem) for problem in problems], options=options)
    return {
        float(bound): other.problem.yardstick.tap_error(other.told, other.predicted_m_s2)
        for bound, other in zip(asked, found, strict=True)
        if other.solution.status is Status.OPTIMAL and other.certificate.accepted
    }
