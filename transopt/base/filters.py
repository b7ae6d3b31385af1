"""The second-order Butterworth filters that recordings and records pass.

They run as `recursions.filtered`, without scipy.signal: to load it takes a sixth of the time of a whole
`transopt solve`.
"""

from dataclasses import replace
from functools import lru_cache
from typing import Literal

import numpy as np

from transopt.base.recursions import filtered
from transopt.base.signals import FloatArray, Signal


@lru_cache(maxsize=16)  # all taps of a scene pass the same few
def _butterworth(
    kind: Literal["lowpass", "highpass"], cutoff_Hz: float, rate_Hz: float
) -> tuple[FloatArray, FloatArray]:
    """b, a : (3,) of a filter, a_0 = 1: 1 / (s^2 + sqrt(2) s + 1) or s^2 over the same, by the bilinear transform.

    With s = (1 - 1/z) / (K (1 + 1/z)), where K = tan(pi f / rate) puts the cut-off where it is stated.
    """
    K = np.tan(np.pi * cutoff_Hz / rate_Hz)
    whole = 1 + np.sqrt(2) * K + K**2
    a = np.array([1.0, 2 * (K**2 - 1) / whole, (1 - np.sqrt(2) * K + K**2) / whole])
    b = np.array([K**2, 2 * K**2, K**2] if kind == "lowpass" else [1.0, -2.0, 1.0]) / whole
    return b, a


def lowpass(x: Signal, cutoff_Hz: float) -> Signal:
    """Zero-phase low-pass: a second-order Butterworth run forwards and backwards.

    The gain at `cutoff_Hz` is therefore -6 dB. Zero phase because a causal filter would delay the tap by
    0.2 ms, two servo ticks. A cut-off at or above 0.45 of the sampling rate leaves the signal as it is:
    there is nothing left to remove.
    """
    if cutoff_Hz >= 0.45 * x.rate_Hz:
        return x
    b, a = _butterworth("lowpass", cutoff_Hz, x.rate_Hz)
    # Constant padding: a tap recorded without a baseline must not be continued by its mirror image.
    # Ten time constants of the filter, so that a step at the edge has decayed inside the padding.
    pad = min(x.values.size - 1, int(np.ceil(10 * x.rate_Hz / (2 * np.pi * cutoff_Hz))))
    course = np.pad(x.values, pad, mode="edge")
    for _ in range(2):
        # Forwards, then backwards, each time from the steady state of its first value, which the filter leaves alone.
        course = (course[0] + filtered(b, a, course - course[0]))[::-1]
    return replace(x, values=np.ascontiguousarray(course[pad : pad + x.values.size]))


def highpass(x: Signal, cutoff_Hz: float) -> Signal:
    """Causal second-order Butterworth high-pass, from rest.

    Applied to a recorded acceleration it gives the share of a tap that the motor has to make: r = H r_raw. What it
    takes away, r_raw - r, is slow and is the user's own motion. It is causal because a zero-phase filter would make
    the motor move before the contact.
    """
    b, a = _butterworth("highpass", cutoff_Hz, x.rate_Hz)
    return replace(x, values=filtered(b, a, x.values))
