"""The one search and what every fit states; dead times told from states."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from scipy import stats
from scipy.optimize import lsq_linear

from transopt.base.signals import FloatArray
from transopt.identify.dead_time import DeadTime, dead_time
from transopt.identify.fit import LEVEL, Fit, intervals_around, known, quantile
from transopt.identify.response_fit import fit_response
from transopt.identify.squares import Squares, by_differences, inverse
from transopt.plant.state_space import CURRENT_INPUT


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


@pytest.mark.parametrize("seed", range(6))
def test_a_linear_problem_ends_where_a_method_for_bounds_does(seed: int) -> None:
    random = np.random.default_rng(seed)
    A, b = random.standard_normal((30, 6)), 3 * random.standard_normal(30)
    low, high = np.full(6, -0.2), np.full(6, 0.3)
    found, total = Squares(lambda u: (A @ u - b, A)).search(random.uniform(-0.2, 0.3, 6), low, high, releases=20)
    right = lsq_linear(A, b, (low, high), tol=1e-14)
    assert found == pytest.approx(right.x, abs=1e-4)
    assert total == pytest.approx(2 * right.cost, rel=1e-8)


def banana(sets: FloatArray) -> FloatArray:
    """Rosenbrock's residuals (k, 2), with the minimum 0 at (1, 1)."""
    return np.stack([10 * (sets[:, 1] - sets[:, 0] ** 2), 1 - sets[:, 0]], axis=1)


def test_what_is_not_free_stays_and_what_was_clipped_comes_back() -> None:
    squares, wide = Squares(by_differences(banana)), np.full(2, 5.0)
    found, _ = squares.search(np.array([2.0, 0.5]), -wide, wide, np.array([True, False]))
    assert found[1] == 0.5
    # On the way from here an unknown is thrown out of the bounds, within which the minimum lies.
    for start in ([-1.2, 1.0], [4.0, -4.0], [0.0, 1.4]):
        found, total = squares.search(
            np.array(start), np.array([-1.5, 0.9]), np.array([4.0, 1.5]), most=400, releases=20
        )
        assert found == pytest.approx([1.0, 1.0], abs=1e-5)
        assert total < 1e-10


def test_several_starts_come_back_with_the_least_sum_first() -> None:
    """(u^2 - 1)^2 + (u - 1)^2 / 100 has a second, worse minimum near -1."""

    def two_valleys(sets: FloatArray) -> FloatArray:
        return np.concatenate([sets**2 - 1, (sets - 1) / 10], axis=1)

    starts = [np.array([-2.0]), np.array([2.0])]
    found = Squares(by_differences(two_valleys)).searches(starts, np.array([-5.0]), np.array([5.0]))
    assert [round(float(one[0])) for one, _ in found] == [1, -1]
    assert found[0][1] < found[1][1]


def test_the_inverse_is_the_covariance_and_what_shows_nothing_is_wide_open() -> None:
    jacobian = np.random.default_rng(0).standard_normal((40, 3))
    assert inverse(jacobian) == pytest.approx(np.linalg.inv(jacobian.T @ jacobian), rel=1e-9)
    assert inverse(jacobian * [1.0, 1e8, 1.0])[0, 0] == pytest.approx(inverse(jacobian)[0, 0], rel=1e-9)
    assert inverse(jacobian * [1.0, 0.0, 1.0])[1, 1] > 1e10


F_HZ = np.linspace(5, 1000, 300)
S = 2j * np.pi * F_HZ
W = 2 * np.pi * 150.0

Response = Callable[[np.ndarray], np.ndarray]


def resonance(s: np.ndarray) -> np.ndarray:
    return 10 * s**2 / (s**2 + s * W / 8 + W**2)


def lagged(s: np.ndarray) -> np.ndarray:
    """The resonance behind an amplifier of 700 Hz."""
    return resonance(s) / (1 + s / (2 * np.pi * 700))


def unstable_zero(s: np.ndarray) -> np.ndarray:
    """The resonance beside a real zero at +400 Hz and a pole at -200 Hz, as of an actuator and sensor apart."""
    return resonance(s) * (1 - s / (2 * np.pi * 400)) / (1 + s / (2 * np.pi * 200))


def apart(s: np.ndarray) -> np.ndarray:
    """Three resonances of unlike signs, as between two places of one body, behind a lag of 2 kHz."""
    parts = ((60.0, 9.0, 1.0), (260.0, 15.0, -0.8), (520.0, 6.0, 0.5))
    rates = [(2 * np.pi * f, quality, gain) for f, quality, gain in parts]
    return sum(g * s**2 / (s**2 + s * w / q + w**2) for w, q, g in rates) / (1 + s / (2 * np.pi * 2000))


def found(plant: Response, order: int, delay_s: float = 0.0, noise: float = 0.0) -> DeadTime | None:
    G = plant(S) * np.exp(-S * delay_s)
    random, deviation = np.random.default_rng(3), noise * np.abs(G).max()
    G = G + deviation * (random.standard_normal(F_HZ.size) + 1j * random.standard_normal(F_HZ.size))
    deviations = np.full(F_HZ.size, deviation) if noise else None
    return dead_time(fit_response(F_HZ, G, order, CURRENT_INPUT, deviations=deviations))


@pytest.mark.parametrize(("delay_s", "order", "noise"), [(3e-4, 3, 0.01), (5e-4, 5, 0.003), (2e-3, 8, 0.01)])
def test_a_dead_time_is_told_from_states(delay_s: float, order: int, noise: float) -> None:
    late = found(resonance, order, delay_s, noise)
    assert late is not None
    assert late.order == 2
    assert late.delay_s == pytest.approx(delay_s, abs=1e-5)


@pytest.mark.parametrize(("more", "noise"), [(0, 0.003), (1, 0.0), (3, 0.01)])
@pytest.mark.parametrize(("plant", "order"), [(resonance, 2), (lagged, 3), (unstable_zero, 3), (apart, 7)])
def test_a_plant_without_one_is_not_late(plant: Response, order: int, more: int, noise: float) -> None:
    assert found(plant, order + more, noise=noise) is None
