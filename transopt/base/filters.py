"""Second-order Butterworth filters for recordings and measurements.

Each is two trapezoidal integrators in a loop (Zavalishin, The Art of VA Filter Design, chapter 4), which is accurate
for any cut-off. A difference equation loses digits with the square of rate over cut-off; its error is 200 times as
large at 8 Hz and 100 kHz. It also avoids loading scipy.signal, which takes a seventh of a whole `transopt solve`.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from transopt.base.recursions import LinearSystem
from transopt.base.signals import FloatArray, Signal, alike

ABREAST = 8  # courses that one call filters: as many as the widest register has numbers


@dataclass(frozen=True)
class _Butterworth:
    """Low-pass and high-pass of one cut-off, each a discrete system that starts at rest."""

    low: LinearSystem
    high: LinearSystem


@lru_cache(maxsize=16)  # all taps of a scene use the same few filters
def _butterworth(cutoff_Hz: float, rate_Hz: float) -> _Butterworth:
    """1 / (s^2 + sqrt(2) s + 1) and s^2 over the same, by the bilinear transform, prewarped at the cut-off."""
    g, k = np.tan(np.pi * cutoff_Hz / rate_Hz), np.sqrt(2)
    share = 1 / (1 + g * (g + k))
    # Outputs of the first and of the second integrator, as rows over the states s and the input u.
    first = share * np.array([1.0, -g, g])
    second = np.array([0.0, 1.0, 0.0]) + g * first
    A, B = np.array([2 * first[:2], 2 * second[:2]]) - np.eye(2), 2 * np.array([first[2], second[2]])
    outputs = second, np.array([0.0, 0.0, 1.0]) - k * first - second
    return _Butterworth(*(LinearSystem(A, B[:, None], row[None, :2], row[None, 2:]) for row in outputs))


def lowpass(x: Signal, cutoff_Hz: float) -> Signal:
    """Zero-phase low-pass: a second-order Butterworth run forwards and backwards.

    The gain at `cutoff_Hz` is therefore -6 dB. Zero phase because a causal filter would delay the tap by
    0.2 ms, two servo ticks. A cut-off at or above 0.45 of the sampling rate leaves the signal as it is:
    there is nothing left to remove.
    """
    return lowpass_all([x], cutoff_Hz)[0]


def lowpass_all(signals: Sequence[Signal], cutoff_Hz: float) -> list[Signal]:
    """`lowpass` of each signal, those of one rate and length side by side."""

    def filtered(courses: FloatArray, rate_Hz: float) -> FloatArray:
        low, size = _butterworth(cutoff_Hz, rate_Hz).low, courses.shape[1]
        # Constant padding: a tap recorded without a baseline must not be continued by its mirror image.
        # Ten time constants of the filter, so that a step at the edge has decayed inside the padding.
        pad = min(size - 1, int(np.ceil(10 * rate_Hz / (2 * np.pi * cutoff_Hz))))
        before, after = (np.repeat(courses[:, edge], pad, axis=1) for edge in (slice(0, 1), slice(size - 1, size)))
        courses = np.hstack([before, courses, after])
        for _ in range(2):
            # Forwards, then backwards, each time starting in the steady state of the first value.
            first = courses[:, :1]
            courses = (first + low.outputs((courses - first)[:, None])[:, 0])[:, ::-1]
        return courses[:, pad : pad + size]

    found = iter(_side_by_side([x for x in signals if cutoff_Hz < 0.45 * x.rate_Hz], filtered))
    return [next(found) if cutoff_Hz < 0.45 * x.rate_Hz else x for x in signals]


def highpass(x: Signal, cutoff_Hz: float) -> Signal:
    """Causal second-order Butterworth high-pass, from rest.

    It is causal, so that nothing of a tap appears before its contact.
    """
    return highpass_all([x], cutoff_Hz)[0]


def highpass_all(signals: Sequence[Signal], cutoff_Hz: float) -> list[Signal]:
    """`highpass` of each signal, those of one rate and length side by side."""

    def filtered(courses: FloatArray, rate_Hz: float) -> FloatArray:
        return _butterworth(cutoff_Hz, rate_Hz).high.outputs(courses[:, None])[:, 0]

    return _side_by_side(signals, filtered)


def _side_by_side(signals: Sequence[Signal], filtered: Callable[[FloatArray, float], FloatArray]) -> list[Signal]:
    """Signals with the values that `filtered` makes of courses (n, K) at a rate [Hz]; `ABREAST` courses at a time."""
    found = list(signals)
    for numbers, courses in alike(signals, ABREAST):
        for i, values in zip(numbers, filtered(courses, signals[numbers[0]].rate_Hz), strict=True):
            found[i] = signals[i].with_values(np.array(values))
    return found
