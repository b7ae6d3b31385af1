"""Second-order Butterworth filters for recordings and measurements.

Each is two trapezoidal integrators in a loop (Zavalishin, The Art of VA Filter Design, chapter 4), which is accurate
for any cut-off. A difference equation loses digits with the square of rate over cut-off; its error is 200 times as
large at 8 Hz and 100 kHz. It also avoids loading scipy.signal, which takes a seventh of a whole `transopt solve`.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from transopt.base.recursions import LinearSystem
from transopt.base.signals import FloatArray, Signal

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
    courses = x.values[None]
    found = lowpassed(courses, x.rate_Hz, cutoff_Hz)
    return x if found is courses else x.with_values(found[0])


def lowpassed(courses: FloatArray, rate_Hz: float, cutoff_Hz: float) -> FloatArray:
    """`lowpass` of each of the courses (m, n) of one rate."""
    if cutoff_Hz >= 0.45 * rate_Hz:
        return courses
    low, size = _butterworth(cutoff_Hz, rate_Hz).low, courses.shape[1]
    # Constant padding: a tap recorded without a baseline must not be continued by its mirror image.
    # Ten time constants of the filter, so that a step at the edge has decayed inside the padding.
    pad = min(size - 1, int(np.ceil(10 * rate_Hz / (2 * np.pi * cutoff_Hz))))

    def filtered(some: FloatArray) -> FloatArray:
        before, after = (np.repeat(some[:, edge], pad, axis=1) for edge in (slice(0, 1), slice(size - 1, size)))
        some = np.hstack([before, some, after])
        for _ in range(2):
            # Forwards, then backwards, each time starting in the steady state of the first value.
            first = some[:, :1]
            some = (first + low.outputs((some - first)[:, None])[:, 0])[:, ::-1]
        return some[:, pad : pad + size]

    return _side_by_side(courses, filtered)


def highpass(x: Signal, cutoff_Hz: float) -> Signal:
    """Causal second-order Butterworth high-pass, from rest.

    It is causal, so that nothing of a tap appears before its contact.
    """
    return x.with_values(highpassed(x.values[None], x.rate_Hz, cutoff_Hz)[0])


def highpassed(courses: FloatArray, rate_Hz: float, cutoff_Hz: float) -> FloatArray:
    """`highpass` of each of the courses (m, n) of one rate."""
    high = _butterworth(cutoff_Hz, rate_Hz).high
    return _side_by_side(courses, lambda some: high.outputs(some[:, None])[:, 0])


def _side_by_side(courses: FloatArray, filtered: Callable[[FloatArray], FloatArray]) -> FloatArray:
    """What `filtered` makes of courses (m, n), `ABREAST` courses at a time."""
    found = np.empty(courses.shape)
    for first in range(0, len(courses), ABREAST):
        found[first : first + ABREAST] = filtered(courses[first : first + ABREAST])
    return found
