"""The spline through evenly spaced samples against that of scipy.interpolate."""

import numpy as np
import pytest
import scipy
from scipy.interpolate import CubicSpline

from transopt.base.signals import Signal, fast_length, splined


@pytest.mark.parametrize("knots", [2, 3, 4, 5, 400])
def test_it_is_the_not_a_knot_spline(knots: int) -> None:
    draws = np.random.default_rng(knots)
    times, courses = 0.3 + 1e-4 * np.arange(knots), draws.normal(size=(2, 3, knots))
    span = times[-1] - times[0]
    at = np.sort(np.concatenate([times, draws.uniform(times[0] - 0.2 * span, times[-1] + 0.2 * span, 200)]))
    wanted = CubicSpline(times, courses, axis=-1)(at)
    inside = (at >= times[0]) & (at <= times[-1])
    assert np.count_nonzero(~inside) > 0
    assert np.abs(splined(times, courses, at, beyond=True) - wanted).max() < 1e-9 * np.abs(wanted).max()
    assert np.abs(splined(times, courses, at) - wanted * inside).max() < 1e-9 * np.abs(wanted).max()


def test_a_signal_between_its_samples() -> None:
    times = np.linspace(0.0, 1e-2, 500)
    x = Signal(0.0, times[1], np.sin(800 * times))
    at = np.array([-1e-6, 1.234e-3, 7.7e-3, 1e-2 + 1e-6])
    assert x.at(at) == pytest.approx([0.0, *np.sin(800 * at[1:3]), 0.0], abs=1e-9)


def test_a_fast_length_is_that_of_scipy() -> None:
    lengths = [1, 2, 7, 97, 1024, 1601, 6401, 32001]
    assert [fast_length(n) for n in lengths] == [scipy.fft.next_fast_len(n, real=True) for n in lengths]
