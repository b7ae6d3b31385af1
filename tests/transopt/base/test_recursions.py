"""Banded substitution against the recursion that it performs."""

import numpy as np
import pytest

from transopt.base.recursions import CHUNK, band, constant_band, run, substitute


@pytest.mark.parametrize("m", [1, 2, 7])
@pytest.mark.parametrize("N", [1, 2, CHUNK - 1, CHUNK, CHUNK + 1, 3 * CHUNK + 5])
def test_run_is_the_recursion(m: int, N: int) -> None:
    random = np.random.default_rng(m + N)
    A = random.standard_normal((m, m))
    A /= 1.1 * np.abs(np.linalg.eigvals(A)).max()
    forcing = random.standard_normal((N, m))
    x = np.zeros((N, m))
    for k in range(N):
        x[k] = forcing[k] + (A @ x[k - 1] if k else 0.0)
    kept = forcing.copy()
    np.testing.assert_allclose(run(A, constant_band(A), forcing), x, rtol=0, atol=1e-13 * np.abs(x).max())
    np.testing.assert_array_equal(forcing, kept)


@pytest.mark.parametrize("m", [1, 2])
def test_matrices_that_change_and_the_transpose(m: int) -> None:
    random = np.random.default_rng(m)
    K = 40
    P, forcing = random.uniform(-0.6, 0.6, (K, m, m)), random.standard_normal((K, m))
    forwards, backwards = forcing.copy(), forcing.copy()
    for k in range(1, K):
        forwards[k] += P[k - 1] @ forwards[k - 1]
    for k in range(K - 2, -1, -1):
        backwards[k] += P[k].T @ backwards[k + 1]
    np.testing.assert_allclose(substitute(band(P), forcing), forwards, atol=1e-13)
    np.testing.assert_allclose(substitute(band(P), forcing, transposed=True), backwards, atol=1e-13)


def test_what_overflows_is_not_hidden() -> None:
    A = np.array([[1e10]])
    assert not np.isfinite(run(A, constant_band(A), np.ones((200, 1)))[-1, 0])
