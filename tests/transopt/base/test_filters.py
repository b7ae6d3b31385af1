"""The Butterworth filters against those of scipy.signal, and against their gains."""

from collections.abc import Callable

import mpmath
import numpy as np
import pytest
from scipy import signal

from transopt.base.filters import highpass, highpassed, lowpass, lowpassed
from transopt.base.signals import FloatArray, Signal

RATES = [(20.0, 1e5), (20.0, 2e3), (1000.0, 1e5), (700.0, 2e3), (0.5, 1e4)]


def pulse(rate_Hz: float) -> Signal:
    """A tap on an offset, with noise: what is recorded."""
    times = np.arange(3000) / rate_Hz
    tap = np.exp(-(((times - 0.4 * times[-1]) * 40 / times[-1]) ** 2))
    return Signal(0.0, 1 / rate_Hz, 3.0 + 80 * tap + np.random.default_rng(3).normal(0, 0.2, times.size))


def off(found: FloatArray, wanted: FloatArray) -> float:
    return float(np.abs(found - wanted).max() / np.abs(wanted).max())


@pytest.mark.parametrize(("cutoff_Hz", "rate_Hz"), RATES)
def test_highpass_is_scipys(cutoff_Hz: float, rate_Hz: float) -> None:
    x = pulse(rate_Hz)
    sections = signal.butter(2, cutoff_Hz, btype="highpass", fs=rate_Hz, output="sos")
    assert off(highpass(x, cutoff_Hz).values, signal.sosfilt(sections, x.values)) < 1e-9


@pytest.mark.parametrize(("cutoff_Hz", "rate_Hz"), RATES)
def test_lowpass_is_scipys_forwards_and_backwards(cutoff_Hz: float, rate_Hz: float) -> None:
    x = pulse(rate_Hz)
    b, a = signal.butter(2, cutoff_Hz, fs=rate_Hz)
    pad = min(x.values.size - 1, int(np.ceil(10 * rate_Hz / (2 * np.pi * cutoff_Hz))))
    # The edge's value goes on for ever on both sides there as here.
    wanted = signal.filtfilt(b, a, x.values, padtype="constant", padlen=pad)
    assert off(lowpass(x, cutoff_Hz).values, wanted) < 1e-9


def test_a_low_cutoff_keeps_its_digits() -> None:
    """Against the difference equation with thirty digits."""
    x = pulse(1e5)
    with mpmath.workdps(30):
        ratio = mpmath.tan(mpmath.pi * 8 / 100000)
        whole = 1 + mpmath.sqrt(2) * ratio + ratio**2
        a1, a2 = 2 * (ratio**2 - 1) / whole, (1 - mpmath.sqrt(2) * ratio + ratio**2) / whole
        values, wanted = [mpmath.mpf(0)] * 2 + [mpmath.mpf(float(v)) for v in x.values], [mpmath.mpf(0)] * 2
        for k in range(2, len(values)):
            risen = (values[k] - 2 * values[k - 1] + values[k - 2]) / whole
            wanted.append(risen - a1 * wanted[k - 1] - a2 * wanted[k - 2])
    assert off(highpass(x, 8.0).values, np.array(wanted[2:], dtype=float)) < 1e-12


def test_gain_at_the_cutoff() -> None:
    rate_Hz, cutoff_Hz = 1e4, 500.0
    wave = Signal(0.0, 1 / rate_Hz, np.sin(2 * np.pi * cutoff_Hz * np.arange(4000) / rate_Hz))
    middle = slice(1000, 3000)
    assert np.abs(lowpass(wave, cutoff_Hz).values[middle]).max() == pytest.approx(0.5, rel=1e-3)
    assert np.abs(highpass(wave, cutoff_Hz).values[middle]).max() == pytest.approx(np.sqrt(0.5), rel=1e-3)


def test_what_does_not_change_passes_as_it_is() -> None:
    level = Signal(0.0, 1e-4, np.full(500, 7.25))
    assert lowpass(level, 400.0).values == pytest.approx(7.25, rel=1e-12)
    assert lowpass(level, 4500.0) is level


@pytest.mark.parametrize(("one", "all_of"), [(lowpass, lowpassed), (highpass, highpassed)])
def test_side_by_side_each_course_is_filtered_as_alone(
    one: Callable[[Signal, float], Signal], all_of: Callable[[FloatArray, float, float], FloatArray]
) -> None:
    """There are more courses than fit side by side."""
    given = [pulse(1e4).scaled(1 + i) for i in range(21)]
    found = all_of(np.stack([x.values for x in given]), 1e4, 190.0)
    for x, values in zip(given, found, strict=True):
        assert off(values, one(x, 190.0).values) < 1e-13
