"""Exponential and balancing against scipy's, and by the properties that define them."""

import numpy as np
import pytest
import scipy

from transopt.base.matrices import balanced, expm


@pytest.mark.parametrize("norm", [0.0, 1e-9, 0.1, 3.0, 50.0, 1e3])
def test_the_exponential_is_that_of_scipy(norm: float) -> None:
    A = np.random.default_rng(1).standard_normal((7, 7))
    A = norm / np.linalg.norm(A, 1) * (A - 2 * np.linalg.norm(A, 2) * np.eye(7))
    wanted = scipy.linalg.expm(A)
    assert np.abs(expm(A) - wanted).max() <= 1e-12 * (1 + norm) * np.abs(wanted).max()


def test_the_exponential_of_a_chain_of_integrators_is_its_series() -> None:
    assert expm(np.diag([3.0, 3.0], 1)) == pytest.approx(np.array([[1, 3, 4.5], [0, 1, 3], [0, 0, 1.0]]), abs=1e-14)


def test_what_is_not_finite_stays_so() -> None:
    assert np.isnan(expm(np.array([[np.inf, 0.0], [0.0, 1.0]]))).all()


def test_balancing_is_exact_and_evens_rows_and_columns_out() -> None:
    draws = np.random.default_rng(2)
    units = np.exp2(draws.integers(-20, 20, 6))
    A = draws.standard_normal((6, 6)) * units[:, None] / units
    found, scale = balanced(A)
    assert np.array_equal(found * scale[:, None] / scale, A)
    rows, columns = np.linalg.norm(found, axis=1), np.linalg.norm(found, axis=0)
    assert np.all((rows < 4 * columns) & (columns < 4 * rows))


def test_a_chain_without_feedback_is_left_as_it_is() -> None:
    A = np.array([[0.0, 1e6], [0.0, 0.0]])
    assert np.array_equal(balanced(A)[0], A)
