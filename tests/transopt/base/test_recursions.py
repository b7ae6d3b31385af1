"""Both ways of computing a recursion, compiled and by banded substitution, against the recursion itself."""

import numpy as np
import pytest

from transopt.base import recursions
from transopt.base.recursions import CHUNK, MOST_STATES, Recursion, backwards, forwards


@pytest.fixture(params=["compiled", "banded"], autouse=True)
def way(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    if request.param == "banded":
        monkeypatch.setattr(recursions, "COMPILED", None)
    elif recursions.COMPILED is None:
        pytest.skip("the extension is not built")


@pytest.mark.parametrize("m", [1, 2, 4, 5, 6, 7, 8, 9, MOST_STATES + 1])
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
    np.testing.assert_allclose(Recursion(A).run(forcing), x, rtol=0, atol=1e-12 * np.abs(x).max())
    np.testing.assert_array_equal(forcing, kept)


def test_arrays_in_any_order_of_memory() -> None:
    random = np.random.default_rng(0)
    A, forcing = random.uniform(-0.3, 0.3, (3, 3)), random.standard_normal((20, 3))
    expected = Recursion(A.copy()).run(forcing)
    turned = np.asfortranarray(forcing)
    np.testing.assert_allclose(Recursion(np.asfortranarray(A)).run(turned), expected, rtol=0, atol=1e-14)
    backed = np.ascontiguousarray(forcing[::-1])[::-1]
    np.testing.assert_allclose(Recursion(A).run(backed), expected, rtol=0, atol=1e-14)


@pytest.mark.parametrize("m", [1, 2, 3])
@pytest.mark.parametrize("K", [1, 2, 40])
def test_matrices_that_change_and_the_transpose(m: int, K: int) -> None:
    random = np.random.default_rng(m)
    P, forcing = random.uniform(-0.6, 0.6, (K - 1, m, m)), random.standard_normal((K, m))
    ahead, back = forcing.copy(), forcing.copy()
    for k in range(1, K):
        ahead[k] += P[k - 1] @ ahead[k - 1]
    for k in range(K - 2, -1, -1):
        back[k] += P[k].T @ back[k + 1]
    kept = forcing.copy()
    np.testing.assert_allclose(forwards(P, forcing), ahead, atol=1e-13)
    np.testing.assert_allclose(backwards(P, forcing), back, atol=1e-13)
    np.testing.assert_array_equal(forcing, kept)


def test_what_overflows_is_not_hidden() -> None:
    assert not np.isfinite(Recursion(np.array([[1e10]])).run(np.ones((200, 1)))[-1, 0])
