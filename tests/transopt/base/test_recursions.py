"""Both ways of computing a recursion, compiled and by banded substitution, against the recursion itself."""

import numpy as np
import pytest
from scipy import signal
from scipy.interpolate import CubicSpline

from transopt.base.recursions import (
    CHUNK,
    MOST_DENSE,
    MOST_LARGEST,
    MOST_STATES,
    MOST_WIDTH,
    LinearSystem,
    Recursion,
    backwards,
    bilinear,
    filtered,
    forwards,
    spline,
    spline_even,
)

pytestmark = pytest.mark.usefixtures("way")


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


@pytest.mark.parametrize(
    ("m", "p", "q"), [(1, 1, 1), (2, 1, 1), (4, 1, 3), (5, 1, 4), (7, 2, 6), (3, 5, 2), (13, 1, 9)]
)
@pytest.mark.parametrize("N", [1, 2, 90])
def test_outputs_of_a_linear_system_and_their_transpose(m: int, p: int, q: int, N: int) -> None:
    random = np.random.default_rng(m + p + q + N)
    A, B, C, D = (random.standard_normal(shape) for shape in ((m, m), (m, p), (q, m), (q, p)))
    A /= 1.1 * np.abs(np.linalg.eigvals(A)).max()
    inputs, by_outputs = random.standard_normal((p, N)), random.standard_normal((q, N))
    x, expected = np.zeros(m), np.empty((q, N))
    for k in range(N):
        expected[:, k] = C @ x + D @ inputs[:, k]
        x = A @ x + B @ inputs[:, k]
    system = LinearSystem(A, B, C, D)
    found, by_inputs = system.outputs(inputs), system.transposed(by_outputs)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-12 * np.abs(expected).max())
    assert by_inputs.shape == (p, N)
    np.testing.assert_allclose(np.sum(by_inputs * inputs), np.sum(by_outputs * expected), rtol=0, atol=1e-11)


@pytest.mark.parametrize("shape", [(2, 1), (3,), (2, 3), (8,), (5, 2), (17,)])  # of fewer and more than a register
@pytest.mark.parametrize("dtype", [np.float64, np.longdouble])
def test_many_courses_through_a_linear_system_are_one_by_one(dtype: type, shape: tuple[int, ...]) -> None:
    random = np.random.default_rng(0)
    A, B, C, D = (0.3 * random.standard_normal(of).astype(dtype) for of in ((3, 3), (3, 2), (4, 3), (4, 2)))
    system, inputs, by_outputs = (
        LinearSystem(A, B, C, D),
        random.random((*shape, 2, 9)),
        random.random((*shape, 4, 9)),
    )
    found, by_inputs = system.outputs(inputs), system.transposed(by_outputs)
    assert found.dtype == dtype
    for each in np.ndindex(*shape):
        np.testing.assert_allclose(found[each], system.outputs(inputs[each]), rtol=1e-14)
        np.testing.assert_allclose(by_inputs[each], system.transposed(by_outputs[each]), rtol=1e-14)


def test_a_linear_system_too_wide_to_be_compiled() -> None:
    random = np.random.default_rng(0)
    inputs = random.standard_normal((1, 20))
    system = LinearSystem(np.zeros((1, 1)), np.ones((1, 1)), np.ones((MOST_WIDTH, 1)), np.zeros((MOST_WIDTH, 1)))
    np.testing.assert_allclose(system.outputs(inputs)[:, 1:], np.tile(inputs[:, :-1], (MOST_WIDTH, 1)))
    np.testing.assert_allclose(system.transposed(np.ones((MOST_WIDTH, 20)))[0, :-1], MOST_WIDTH)


@pytest.mark.parametrize("M", [1, 3, 8, 33])
@pytest.mark.parametrize("terms", [1, 3])
def test_the_largest_outputs_are_those_of_all_outputs(M: int, terms: int) -> None:
    random = np.random.default_rng(M)
    A, B, C, D = (0.3 * random.standard_normal(of) for of in ((3, 3), (3, 2), (6, 3), (6, 2)))
    C[4], D[4] = 0.0, 0.0
    system, inputs = LinearSystem(A, B, C, D), random.standard_normal((M, 2, 40))
    inputs[M // 2, 1, 5:7] = np.nan
    sums = np.abs(system.outputs(inputs)).reshape(M, -1, terms, 40).sum(axis=2)
    found, states = system.largest(inputs, terms=terms)
    np.testing.assert_allclose(
        found[inputs[:, 1, 5] < np.inf], sums.max(axis=2)[inputs[:, 1, 5] < np.inf], rtol=1e-13
    )
    assert np.isnan(found[M // 2, 0])
    # In two parts, of which the second goes on where the first ended; before the NaN there is none.
    first, between = system.largest(inputs[..., :5], terms=terms)
    second, last = system.largest(inputs[..., 5:], between, terms=terms)
    assert np.isfinite(first).all()
    np.testing.assert_allclose(np.maximum(first, second), found, rtol=1e-13)
    np.testing.assert_allclose(last, states, rtol=1e-13)


@pytest.mark.parametrize("q", [26, 60, 189, MOST_DENSE + 2])  # from a few registers to more than stand together
@pytest.mark.parametrize("M", [1, 5])
@pytest.mark.parametrize("terms", [1, 2])
def test_the_largest_of_many_outputs(q: int, M: int, terms: int) -> None:
    random, q = np.random.default_rng(q), q - q % terms
    A, B, C, D = (0.3 * random.standard_normal(of) for of in ((7, 7), (7, 2), (q, 7), (q, 2)))
    inputs, start = random.standard_normal((M, 2, 30)), random.standard_normal((M, 7))
    expected, x = np.zeros((M, q // terms)), start
    for k in range(30):
        y = x @ C.T + inputs[..., k] @ D.T
        expected = np.maximum(expected, np.abs(y).reshape(M, -1, terms).sum(axis=2))
        x = x @ A.T + inputs[..., k] @ B.T
    found, states = LinearSystem(A, B, C, D).largest(inputs, start, terms=terms)
    np.testing.assert_allclose(found, expected, rtol=1e-11)
    np.testing.assert_allclose(states, x, rtol=0, atol=1e-11 * np.abs(x).max())


def test_the_largest_of_more_outputs_than_are_compiled() -> None:
    q, inputs = MOST_LARGEST + 1, np.random.default_rng(0).standard_normal((2, 1, 20))
    system = LinearSystem(np.zeros((1, 1)), np.ones((1, 1)), np.ones((q, 1)), np.zeros((q, 1)))
    found, states = system.largest(inputs)
    np.testing.assert_allclose(found, np.tile(np.abs(inputs[..., :-1]).max(axis=2), (1, q)))
    np.testing.assert_allclose(states, inputs[..., -1])


def test_a_linear_system_in_extended_precision() -> None:
    third = np.longdouble(1) / 3
    system = LinearSystem(np.full((1, 1), third), *(np.ones((1, 1), dtype=np.longdouble),) * 2, np.zeros((1, 1)))
    found = system.outputs(np.eye(1, 5))
    assert found.dtype == np.longdouble
    np.testing.assert_allclose(found[0], [0, *third ** np.arange(4)], rtol=4 * np.finfo(np.longdouble).eps)


@pytest.mark.parametrize("N", [1, 50])
def test_a_recursion_that_is_bilinear(N: int) -> None:
    random = np.random.default_rng(N)
    M, b, start = random.uniform(-0.5, 0.5, (2, 2)), random.standard_normal(2), random.standard_normal(2)
    gain, h = random.standard_normal(N), random.uniform(0, 1, N)
    x = np.empty((N + 1, 2))
    x[0] = start
    for k in range(N):
        x[k + 1] = M @ x[k] + b * (gain[k] + 0.2 * x[k, 0]) * h[k]
    np.testing.assert_allclose(bilinear(M, b, gain, 0.2, h, start), x, atol=1e-12)


@pytest.mark.parametrize("K", [4, 5, 40])
def test_the_not_a_knot_spline_within_and_beyond_its_knots(K: int) -> None:
    random = np.random.default_rng(K)
    y = random.standard_normal((K, 4))
    places = np.concatenate([[-0.7, 0.0, K - 1.0, K - 0.4], random.uniform(0, K - 1, 30)])
    expected = CubicSpline(np.arange(K), y)(places)
    np.testing.assert_allclose(spline(y, places), expected, atol=1e-11)
    for part in (slice(1, 2), slice(0, 3)):
        np.testing.assert_allclose(spline(y[:, part], places), expected[:, part], atol=1e-11)
    even = spline_even(y[:, 0], -0.7, 0.23, 6 * K)
    np.testing.assert_allclose(even, CubicSpline(np.arange(K), y[:, 0])(-0.7 + 0.23 * np.arange(6 * K)), atol=1e-9)


@pytest.mark.parametrize(
    ("b", "a"),
    [
        ([0.1], [1.0, -0.9]),  # fewer zeros than poles
        ([0.1, 0.3, -0.2], [1.0, -0.9]),  # more of them
        ([1.0, -0.5], [0.7, 0.2]),  # a leading coefficient that is not 1
        signal.butter(2, 0.2),
        signal.butter(4, [0.1, 0.4], "bandpass"),
    ],
)
def test_filtered_is_the_digital_filter_from_rest(b: list[float], a: list[float]) -> None:
    values = np.random.default_rng(1).standard_normal((2, 3, 400))
    expected = signal.lfilter(b, a, values)
    found = filtered(np.asarray(b), np.asarray(a), values)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-11 * np.abs(expected).max())
