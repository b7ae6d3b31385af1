"""What every fit states: intervals that hold what they say, and a verdict that names each shortfall."""

from typing import Any

import numpy as np
import pytest
from scipy import stats

from transopt.identify.fit import LEVEL, Fit, intervals_around, known, quantile


@pytest.mark.parametrize("degrees", [3.0, 12.0, np.inf])
def test_so_many_intervals_hold_the_truth_as_their_level_says(degrees: float) -> None:
    off = quantile(degrees)
    inside = stats.t.cdf(off, degrees) - stats.t.cdf(-off, degrees)
    assert inside == pytest.approx(LEVEL, abs=1e-9)


def test_a_part_states_its_numbers_in_their_order_with_a_symmetric_covariance() -> None:
    covariance = np.array([[4.0, 1.0 + 1e-9], [1.0, 9.0]])
    told = known(("a", "b"), covariance, intervals_around(np.array([1.0, -2.0]), covariance))
    assert told["parameters"] == ["a", "b"]
    assert np.array_equal(told["covariance"], np.transpose(told["covariance"]))
    low, high = told["intervals"]["b"]
    assert (low + high) / 2 == pytest.approx(-2.0)
    assert (high - low) / 2 == pytest.approx(3 * quantile())


class Stated(Fit):
    """A fit with the shortfalls that it is given."""

    def __init__(self, short: list[str]) -> None:
        self._short = short

    def stated(self) -> dict[str, Any]:
        return {"gain": 1.0}

    def shortfalls(self) -> list[str]:
        return self._short

    def supports(self) -> str:
        return "supports all designs"


@pytest.mark.parametrize(
    ("short", "verdict"),
    [
        ([], "supports all designs"),
        (["too short: sweep longer", "too faint"], "not fit to design with: too short: sweep longer; too faint"),
    ],
)
def test_the_verdict_is_what_is_supported_or_every_shortfall(short: list[str], verdict: str) -> None:
    assert Stated(short).content([]) == {"gain": 1.0, "verdict": verdict, "shortfalls": short, "sources": []}
