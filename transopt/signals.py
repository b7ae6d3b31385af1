"""Uniformly sampled signals and the few filters the design uses."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import interpolate
from scipy.linalg import blas

from transopt.errors import InputError

FloatArray = NDArray[np.float64]

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
        return 1.0 / self.dt_s

    @property
    def spline(self) -> interpolate.CubicSpline:
        """Through all samples."""
        return interpolate.CubicSpline(self.times_s, self.values, extrapolate=False)

    def at(self, times_s: FloatArray) -> FloatArray:
        """Cubic-spline samples at `times_s` (m,); zero before the first and after the last sample."""
        return sampled(self.spline, times_s)

    def scaled(self, factor: float) -> "Signal":
        return replace(self, values=factor * self.values)

    def shifted(self, by_s: float) -> "Signal":
        """The same samples `by_s` seconds later."""
        return replace(self, start_s=self.start_s + by_s)


def sampled(spline: interpolate.CubicSpline, times_s: FloatArray) -> FloatArray:
    """Values of a spline at `times_s` (m,); zero before its first and after its last knot."""
    values = np.asarray(spline(times_s, extrapolate=False), dtype=float)
    return np.asarray(np.nan_to_num(values, copy=False, nan=0.0))


def filtered(b: FloatArray, a: FloatArray, values: FloatArray) -> FloatArray:
    """(..., n) values of the digital filter b / a from rest, a[0] = 1, along the last axis: `scipy.signal.lfilter`.

    The recursion is forward substitution in a banded triangular system. Importing scipy.signal, which loads all of
    scipy.stats, would take longer than solving a library.
    """
    n, rows = values.shape[-1], values.reshape(-1, values.shape[-1])
    moved = np.stack([np.convolve(row, b)[:n] for row in rows])
    if moved.dtype != np.float64:  # no library has extended precision
        for k in range(n):
            for j in range(1, min(a.size, k + 1)):
                moved[:, k] -= a[j] * moved[:, k - j]
        return moved.reshape(values.shape)
    band = np.repeat(a[:, None], n, axis=1)
    solved = [blas.dtbsv(a.size - 1, band, row, lower=1, diag=1) for row in moved]
    return np.asarray(solved).reshape(values.shape)


def butterworth(cutoff_Hz: float, rate_Hz: float, *, high: bool = False) -> tuple[FloatArray, FloatArray]:
    """b, a (3,) of the second-order Butterworth low- or high-pass, `scipy.signal.butter(2, ...)`.

    1 / (s^2 + sqrt(2) s + 1) and s^2 over the same by the bilinear transform s = (1 / K) (1 - 1/z) / (1 + 1/z) with
    K = tan(pi f_c / f_s), which puts the -3 dB where they are asked for.
    """
    K = np.tan(np.pi * cutoff_Hz / rate_Hz)
    size = 1 + np.sqrt(2) * K + K**2
    b = np.array([1.0, -2.0, 1.0]) if high else K**2 * np.array([1.0, 2.0, 1.0])
    return b / size, np.array([1.0, 2 * (K**2 - 1) / size, (1 - np.sqrt(2) * K + K**2) / size])


def lowpass(x: Signal, cutoff_Hz: float) -> Signal:
    """Zero-phase low-pass: a second-order Butterworth run forwards and backwards.

    The gain at `cutoff_Hz` is therefore -6 dB. Zero phase because a causal filter would delay the tap by
    0.2 ms, two servo ticks. A cut-off at or above 0.45 of the sampling rate leaves the signal as it is:
    there is nothing left to remove.
    """
    if cutoff_Hz >= 0.45 * x.rate_Hz:
        return x
    b, a = butterworth(cutoff_Hz, x.rate_Hz)
    # Constant padding: a tap recorded without a baseline must not be continued by its mirror image.
    # Ten time constants of the filter, so that a step at the edge has decayed inside the padding.
    pad = min(x.values.size - 1, int(np.ceil(10 * x.rate_Hz / (2 * np.pi * cutoff_Hz))))
    values = np.pad(x.values, pad, mode="edge")
    for _ in range(2):
        # Each way as if its first sample had stood for ever: the gain at 0 Hz is one.
        values = (values[0] + filtered(b, a, values - values[0]))[::-1]
    return replace(x, values=values[pad : values.size - pad].copy())


def highpass(x: Signal, cutoff_Hz: float) -> Signal:
    """Causal second-order Butterworth high-pass from rest: H of DESIGN 2, the motor's share of a tap.

    Causal because a zero-phase one would make the motor move before the contact.
    """
    return replace(x, values=filtered(*butterworth(cutoff_Hz, x.rate_Hz, high=True), x.values))


def nrmse(value: FloatArray, reference: FloatArray) -> float:
    """|value - reference| / |reference| over all samples; 0 if both are zero, inf if only the reference is."""
    size = float(np.linalg.norm(reference))
    error = float(np.linalg.norm(value - reference))
    if size == 0.0:
        return 0.0 if error == 0.0 else float("inf")
    return error / size
