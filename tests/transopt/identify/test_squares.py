"""The one search: it ends where nothing within the bounds is better, and says how well unknowns are known."""

import numpy as np
import pytest
from scipy.optimize import lsq_linear

from transopt.base.signals import FloatArray
from transopt.identify.squares import Squares, by_differences, inverse


@pytest.mark.parametrize("seed", range(20))
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
