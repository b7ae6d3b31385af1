"""Matrix functions, splines and formulas against those of other libraries, and by what defines them."""

import casadi as ca
import numpy as np
import pytest
import scipy
from scipy.interpolate import CubicSpline

from transopt.base.arithmetic import NUMBERS, NUMPY, Formula
from transopt.base.errors import InputError
from transopt.base.matrices import balanced, expm
from transopt.base.signals import Signal, fast_length, median, splined
from transopt.solvers.nonlinear import CASADI


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


@pytest.mark.parametrize("knots", [2, 3, 4, 5, 400])
def test_it_is_the_not_a_knot_spline(knots: int) -> None:
    draws = np.random.default_rng(knots)
    times, courses = 0.3 + 1e-4 * np.arange(knots), draws.normal(size=(2, 3, knots))
    span = times[-1] - times[0]
    at = np.sort(np.concatenate([times, draws.uniform(times[0] - 0.2 * span, times[-1] + 0.2 * span, 200)]))
    wanted = CubicSpline(times, courses, axis=-1)(at)
    inside = (at >= times[0]) & (at <= times[-1])
    assert np.count_nonzero(~inside) > 0
    assert np.abs(splined(times, courses, at) - wanted * inside).max() < 1e-9 * np.abs(wanted).max()


def test_a_signal_between_its_samples() -> None:
    times = np.linspace(0.0, 1e-2, 500)
    x = Signal(0.0, times[1], np.sin(800 * times))
    at = np.array([-1e-6, 1.234e-3, 7.7e-3, 1e-2 + 1e-6])
    assert x.at(at) == pytest.approx([0.0, *np.sin(800 * at[1:3]), 0.0], abs=1e-9)


@pytest.mark.parametrize("knots", [2, 3, 4, 40])
@pytest.mark.parametrize("step", [0.11, 0.5, 1.0, 3.7])
def test_even_times_are_times(knots: int, step: float) -> None:
    x = Signal(0.5, 0.25, np.random.default_rng(knots).normal(size=knots))
    for first_s in (-1.0, 0.5, 0.5 + 0.25 * (knots - 1), 0.61, 50.0):
        wanted = x.at(first_s + 0.25 * step * np.arange(70))
        np.testing.assert_allclose(x.evenly(first_s, 0.25 * step, 70), wanted, atol=1e-12)


def test_samples_before_and_until_a_time_are_those_of_its_times() -> None:
    draws = np.random.default_rng(3)
    for start_s, dt_s in [(0.0, 0.1), (-0.3, 1e-4), (1e6, 1 / 3)]:
        x = Signal(start_s, dt_s, np.zeros(50))
        beside = [side for time in x.times_s.tolist() for side in (time, np.nextafter(time, -1e9), time + 1e-9)]
        for time in (*beside, *draws.uniform(x.start_s - 1, x.end_s + 1, 50), -np.inf, np.inf):
            assert x.before(time) == np.searchsorted(x.times_s, time, side="left")
            assert x.until(time) == np.searchsorted(x.times_s, time, side="right")


@pytest.mark.parametrize("size", [1, 2, 7, 100])
def test_the_median_is_that_of_numpy(size: int) -> None:
    values = np.random.default_rng(size).integers(0, 9, size).astype(float)
    assert median(values) == pytest.approx(np.median(values), rel=1e-15)


def test_the_count_of_an_encoder() -> None:
    counted = Signal(0.0, 1.0, 2.5e-5 * np.array([0.0, 1.0, 1.0, 4.0, 2.0]))
    assert counted.count == pytest.approx(2.5e-5)
    assert Signal(0.0, 1.0, np.array([0.0, 1.0, 1.6])).count == 0.0
    assert Signal(0.0, 1.0, np.ones(5)).count == 0.0


def test_a_fast_length_is_that_of_scipy() -> None:
    lengths = [1, 2, 7, 97, 1024, 1601, 6401, 32001]
    assert [fast_length(n) for n in lengths] == [scipy.fft.next_fast_len(n, real=True) for n in lengths]


TEXTS = [
    "BL*(1 - 0.3*(x/0.6e-3)**2)",
    "0.01*tanh(v/1e-3) + abs(x)",
    "-x**2/(1 + exp(-v)) + 2",
    "sqrt(1 + x**2)*cos(3*v) - sin(x)*log(2 + v**2) + atan(+v)",
]


@pytest.mark.parametrize("text", TEXTS)
def test_numbers_arrays_and_expressions_have_one_value(text: str) -> None:
    formula = Formula(text, ("x", "v"), (("BL", 0.8),))
    x, v = 4e-4, -0.7
    scope = {name: getattr(np, {"atan": "arctan"}.get(name, name)) for name in NUMPY}
    expected = eval(text, {"__builtins__": {}}, {**scope, "x": x, "v": v, "BL": 0.8})
    assert formula({"x": x, "v": v}, NUMBERS) == pytest.approx(expected, rel=1e-14)
    assert formula({"x": np.full(3, x), "v": np.full(3, v)}, NUMPY) == pytest.approx(np.full(3, expected), rel=1e-14)
    symbols = ca.SX.sym("x"), ca.SX.sym("v")
    value = ca.Function("value", symbols, [formula(dict(zip("xv", symbols, strict=True)), CASADI)])
    assert float(value(x, v)) == pytest.approx(expected, rel=1e-14)


def test_it_knows_what_it_depends_on() -> None:
    assert Formula("K + x*0", ("x", "v"), (("K", 2.0),)).names == {"x"}


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("__import__('os').system('true')", "no part of a formula"),
        ("x.real", "no part of a formula"),
        ("x[0]", "no part of a formula"),
        ("[x for x in (1, 2)]", "no part of a formula"),
        ("lambda: x", "no part of a formula"),
        ("x if v else 1", "no part of a formula"),
        ("x and v", "no part of a formula"),
        ("x < 1", "no part of a formula"),
        ("tanh(x, v)", "no part of a formula"),
        ("eval(x)", "no part of a formula"),
        ("'x'", "no part of a formula"),
        ("True", "no part of a formula"),
        ("1j*x", "no part of a formula"),
        ("x // 2", "no part of a formula"),
        ("(x := 2)", "no part of a formula"),
        ("tanh", "no name that a formula may use"),
        ("BLx", "no name that a formula may use: x, v"),
        ("x +", "is no formula"),
        ("", "is no formula"),
        ("x\n+ 1; v", "is no formula"),
        ("1e999*x", "is not finite"),
        ("9" * 400, "is not finite"),
        ("-" * 60 + "x", "nested deeper"),
        ("(" * 300 + "x" + ")" * 300, "is no formula"),
        ("x+" * 600 + "x", "characters"),
        ("\x00", "is no formula"),
    ],
)
def test_what_is_no_formula_is_refused_in_one_line(text: str, said: str) -> None:
    with pytest.raises(InputError, match=said) as refused:
        Formula(text, ("x", "v"))
    assert "\n" not in str(refused.value)
