"""Uniformly sampled signals, and the few filters and measures that the design uses."""

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Literal

import numpy as np
import scipy
from numpy.typing import NDArray

from transopt.base.errors import InputError
from transopt.base.shown import brief

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

STANDARD_GRAVITY_M_S2 = 9.80665


@dataclass(frozen=True)
class Signal:
    """A uniformly sampled scalar signal; the unit of `values` is the owner's business.

    Attributes
    ----------
    start_s : time of the first sample.
    dt_s : sampling period, > 0.
    values : (n,) finite samples, n >= 2.
    """

    start_s: float
    dt_s: float
    values: FloatArray

    __repr__ = brief

    def __post_init__(self) -> None:
        if self.values.ndim != 1 or self.values.size < 2:
            raise InputError(f"a signal needs at least 2 samples in one column, got shape {self.values.shape}")
        if not (np.isfinite(self.start_s) and np.isfinite(self.dt_s) and self.dt_s > 0):
            raise InputError(f"sampling period {self.dt_s:g} s from {self.start_s:g} s: must be finite and > 0")
        if not np.all(np.isfinite(self.values)):
            first = int(np.flatnonzero(~np.isfinite(self.values))[0])
            raise InputError(f"sample {first} is {self.values[first]}: every sample must be a finite number")

    @property
    def times_s(self) -> FloatArray:
        """(n,) sample times [s]."""
        return np.asarray(self.start_s + self.dt_s * np.arange(self.values.size), dtype=float)

    @property
    def end_s(self) -> float:
        """Time of the last sample [s]."""
        return self.start_s + self.dt_s * (self.values.size - 1)

    @property
    def rate_Hz(self) -> float:
        """Samples per second."""
        return 1.0 / self.dt_s

    @property
    def spline(self) -> "scipy.interpolate.CubicSpline":
        """The cubic spline through all samples; NaN outside them."""
        return scipy.interpolate.CubicSpline(self.times_s, self.values, extrapolate=False)

    def at(self, times_s: FloatArray) -> FloatArray:
        """Cubic-spline samples at `times_s` (m,); zero before the first and after the last sample."""
        return sampled(self.spline, times_s)

    def scaled(self, factor: float) -> "Signal":
        """The signal with all its values multiplied by `factor`."""
        return replace(self, values=factor * self.values)


def sampled(spline: "scipy.interpolate.CubicSpline", times_s: FloatArray) -> FloatArray:
    """Values of a spline at `times_s` (m,); zero before its first and after its last knot."""
    values = np.asarray(spline(times_s, extrapolate=False), dtype=float)
    return np.asarray(np.nan_to_num(values, copy=False, nan=0.0))


@lru_cache(maxsize=16)  # all taps of a scene pass the same few
def _butterworth(
    kind: Literal["lowpass", "highpass"], cutoff_Hz: float, rate_Hz: float
) -> tuple[FloatArray, FloatArray]:
    """A second-order Butterworth filter as one section (1, 6), and its state (1, 2) after ones for ever."""
    sos = np.asarray(scipy.signal.butter(2, cutoff_Hz, btype=kind, fs=rate_Hz, output="sos"))
    return sos, np.asarray(scipy.signal.sosfilt_zi(sos))


def lowpass(x: Signal, cutoff_Hz: float) -> Signal:
    """Zero-phase low-pass: a second-order Butterworth run forwards and backwards.

    The gain at `cutoff_Hz` is therefore -6 dB. Zero phase because a causal filter would delay the tap by
    0.2 ms, two servo ticks. A cut-off at or above 0.45 of the sampling rate leaves the signal as it is:
    there is nothing left to remove.
    """
    if cutoff_Hz >= 0.45 * x.rate_Hz:
        return x
    sos, settled = _butterworth("lowpass", cutoff_Hz, x.rate_Hz)
    # Constant padding: a tap recorded without a baseline must not be continued by its mirror image.
    # Ten time constants of the filter, so that a step at the edge has decayed inside the padding.
    pad = min(x.values.size - 1, int(np.ceil(10 * x.rate_Hz / (2 * np.pi * cutoff_Hz))))
    course = np.pad(x.values, pad, mode="edge")
    for _ in range(2):
        # Forwards, then backwards, each time from the steady state of its first value.
        course = scipy.signal.sosfilt(sos, course, zi=settled * course[0])[0][::-1]
    return replace(x, values=np.ascontiguousarray(course[pad : pad + x.values.size]))


def highpass(x: Signal, cutoff_Hz: float) -> Signal:
    """Causal second-order Butterworth high-pass, from rest.

    Applied to a recorded acceleration it gives the share of a tap that the motor has to make: r = H r_raw. What it
    takes away, r_raw - r, is slow and is the user's own motion. It is causal because a zero-phase filter would make
    the motor move before the contact.
    """
    sos, _ = _butterworth("highpass", cutoff_Hz, x.rate_Hz)
    return replace(x, values=np.asarray(scipy.signal.sosfilt(sos, x.values)))


def nrmse(value: FloatArray, reference: FloatArray) -> float:
    """|value - reference| / |reference| over all samples; 0 if both are zero, inf if only the reference is."""
    size = float(np.linalg.norm(reference))
    error = float(np.linalg.norm(value - reference))
    if size == 0.0:
        return 0.0 if error == 0.0 else float("inf")
    return error / size
