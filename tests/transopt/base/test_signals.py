"""The spline through evenly spaced samples against that of scipy.interpolate."""

import numpy as np
import pytest
import scipy
from scipy.interpolate import CubicSpline

from transopt.base.signals import Signal, fast_length, median, splined


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
