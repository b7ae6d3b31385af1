"""Uniformly sampled signals, the spline through them, and the measure of their error."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from transopt.base.errors import InputError
from transopt.base.recursions import spline, spline_even
from transopt.base.shown import brief

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
BoolArray = NDArray[np.bool_]
IndexArray = NDArray[np.intp]
AnyArray = NDArray[Any]

STANDARD_GRAVITY_M_S2 = 9.80665
REACTION_S = 30e-3  # nobody reacts to a tap sooner (seed Eq. 2)
WHOLE_COUNTS = 0.01  # tolerance, in counts, of a change that has to be a multiple of one count
FLAT_RUN, FLAT_COUNT = 3, 6  # least samples in a row, and in all, exactly at the extreme to count as clipped
FAR_PART = 0.5  # least part of the span of a signal by which an end of a sensor's range lies away from rest
CROWD = 0.02  # of the amplitude below the extreme: an unclipped sine is there more often than at the extreme itself


@dataclass(frozen=True)
class Signal:
    """A uniformly sampled scalar signal; its user knows the unit of `values`.

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
        if not (math.isfinite(self.start_s) and math.isfinite(self.dt_s) and self.dt_s > 0):
            raise InputError(f"sampling period {self.dt_s:g} s from {self.start_s:g} s: must be finite and > 0")
        if not is_finite(self.values):
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

    @cached_property
    def count(self) -> float:
        """Quantisation step of the values, as of an encoder; 0 if their changes are not multiples of a step."""
        steps = np.abs(self.values[1:] - self.values[:-1])
        steps = steps[steps > 0]
        if steps.size == 0:
            return 0.0
        least = float(steps.min())
        counts = steps / least
        return least if (np.abs(counts - np.rint(counts)) <= WHOLE_COUNTS).all() else 0.0

    def before(self, time_s: float) -> int:
        """Number of samples before a time."""
        return samples_before(time_s, self.start_s, self.dt_s, self.values.size)

    def until(self, time_s: float) -> int:
        """Number of samples up to and including a time."""
        return _until(time_s, self.start_s, self.dt_s, self.values.size)

    def at(self, times_s: FloatArray) -> FloatArray:
        """Cubic-spline samples at `times_s` (m,); zero before the first and after the last sample."""
        if self.values.size < 4:
            return splined(self.times_s, self.values, times_s)
        found = spline(self.values[:, None], (times_s - self.start_s) / self.dt_s)[:, 0]
        return np.where((times_s >= self.start_s) & (times_s <= self.end_s), found, 0.0)

    def evenly(self, first_s: float, step_s: float, count: int) -> FloatArray:
        """(count,) samples as by `at`, at the times first, first + step, ..., step > 0, in a third of its time."""
        if self.values.size < 4:
            return self.at(np.asarray(first_s + step_s * np.arange(count), dtype=float))
        found = np.zeros(count)
        begin, end = samples_before(self.start_s, first_s, step_s, count), _until(self.end_s, first_s, step_s, count)
        place = (first_s + step_s * begin - self.start_s) / self.dt_s
        found[begin:end] = spline_even(self.values, place, step_s / self.dt_s, end - begin)
        return found

    def part(self, first: int, end: int) -> "Signal":
        """The samples from `first` up to `end`, at their own times."""
        return Signal(self.start_s + first * self.dt_s, self.dt_s, self.values[first:end])

    def scaled(self, factor: float) -> "Signal":
        """The signal with all its values multiplied by `factor`."""
        return self.with_values(factor * self.values)

    def with_values(self, values: FloatArray) -> "Signal":
        """A signal of other values (n,) at the same times."""
        return Signal(self.start_s, self.dt_s, values)


def is_finite(array: FloatArray) -> bool:
    """Whether all numbers are finite; the sum of their squares, fast, settles that unless it overflows."""
    return math.isfinite(np.vdot(array, array)) or bool(np.isfinite(array).all())


def read_only(values: FloatArray) -> FloatArray:
    """A view of numbers that cannot be edited in place, because what is computed from them is cached."""
    if not values.flags.writeable:
        return values
    found = values.view()
    found.flags.writeable = False
    return found


def samples_before(time_s: float, first_s: float, step_s: float, count: int) -> int:
    """How many of the `count` times first, first + step, ... lie before a time."""
    k = math.ceil(min(max((time_s - first_s) / step_s, 0.0), count))
    # Correct a division that rounding has put on the wrong side of the time.
    while k > 0 and first_s + step_s * (k - 1) >= time_s:
        k -= 1
    while k < count and first_s + step_s * k < time_s:
        k += 1
    return k


def _until(time_s: float, first_s: float, step_s: float, count: int) -> int:
    """How many of the `count` times first, first + step, ... lie before a time or at it."""
    k = samples_before(time_s, first_s, step_s, count)
    return k + int(k < count and first_s + step_s * k == time_s)


def splined(times_s: FloatArray, courses: FloatArray, at_s: FloatArray) -> FloatArray:
    """(..., m) values at instants (m,) of the cubic not-a-knot splines through series (..., K) at even times (K,).

    Before the first and after the last time the value is zero.
    The result equals that of `scipy.interpolate.CubicSpline`. It is faster, since it does not compute the
    coefficients of unused intervals and does not load scipy.interpolate, which loads scipy.optimize.
    """
    K = times_s.size
    if K < 4:  # scipy handles this case: a line through two points, a parabola through three
        import scipy.interpolate

        found = np.asarray(scipy.interpolate.CubicSpline(times_s, courses, axis=-1)(at_s))
    else:
        places = (at_s - times_s[0]) / (times_s[-1] - times_s[0]) * (K - 1)
        found = spline(courses.reshape(-1, K).T, places).T.reshape(*courses.shape[:-1], at_s.size)
    return np.where((at_s >= times_s[0]) & (at_s <= times_s[-1]), found, 0.0)


@lru_cache(maxsize=64)  # repeats on one time axis have one length
def fast_length(least: int) -> int:
    """Smallest length >= `least` with a fast Fourier transform: its only prime factors are 2, 3 and 5."""
    length = least
    while True:
        left = length
        for factor in (2, 3, 5):
            while left % factor == 0:
                left //= factor
        if left == 1:
            return length
        length += 1


def integral(rate: FloatArray, dt_s: float) -> FloatArray:
    """(..., n) cumulative integral along the last axis by the trapezoidal rule, zero at the first sample."""
    course = np.zeros(rate.shape)
    sums = course[..., 1:]
    np.add(rate[..., 1:], rate[..., :-1], out=sums)
    np.cumsum(sums, axis=-1, out=sums)
    course *= 0.5 * dt_s
    return course


def median(values: FloatArray) -> float:
    """Median of finite values (n,), n >= 1, in a third of the time of `np.median`."""
    return float(medians(values[None])[0])


def medians(courses: FloatArray) -> FloatArray:
    """(m,) median of each of m series (m, n) of finite values, n >= 1."""
    middle = courses.shape[1] // 2
    # numpy is several times faster with one place of the order than with two.
    parted = np.partition(courses, middle, axis=1)
    above = parted[:, middle]
    return above if courses.shape[1] % 2 else np.asarray(0.5 * (parted[:, :middle].max(axis=1) + above))


def alike(signals: Sequence[Signal], most: int) -> Iterator[tuple[list[int], FloatArray]]:
    """Signals of one start, period and length, at most `most` at a time: their numbers (m,) and values (m, n)."""
    groups: dict[tuple[float, float, int], list[int]] = {}
    for i, x in enumerate(signals):
        groups.setdefault((x.start_s, x.dt_s, x.values.size), []).append(i)
    for group in groups.values():
        for first in range(0, len(group), most):
            some = group[first : first + most]
            yield some, np.stack([signals[i].values for i in some])


def nrmse(value: FloatArray, reference: FloatArray) -> float:
    """|value - reference| / |reference| over all samples; 0 if both are zero, inf if only the reference is."""
    size = float(np.linalg.norm(reference))
    error = float(np.linalg.norm(value - reference))
    if size == 0.0:
        return 0.0 if error == 0.0 else float("inf")
    return error / size


def flat_extreme(values: FloatArray) -> IndexArray:
    """Indices of the samples at the maximum if the signal is clipped there; empty otherwise.

    A sine dwells at its peak, and a coarse converter turns that into runs of one value; so the signal counts as
    clipped only if the samples at the maximum outnumber those just below it.
    """
    top = float(values.max())
    at = np.flatnonzero(values >= top - 1e-9 * float(np.ptp(values)))
    if at.size < FLAT_COUNT or top <= 0:
        return np.zeros(0, dtype=np.intp)
    runs = np.split(at, np.flatnonzero(np.diff(at) > 1) + 1)
    if max(run.size for run in runs) < FLAT_RUN:
        return np.zeros(0, dtype=np.intp)
    levels = np.unique(values[values >= 0.9 * top])
    quantum = float(np.diff(levels).min()) if levels.size > 1 else 0.0
    below = max(CROWD * top, 4.5 * quantum)
    crowd = int(np.count_nonzero((values < top) & (values >= top - below)))
    return at if at.size > crowd else np.zeros(0, dtype=np.intp)


def stops(values: FloatArray) -> list[IndexArray]:
    """Indices of the samples at which a sensor stands still at an end of its range, for each end that it reaches.

    A quiet sensor may repeat its resting value; an end of the range lies far from it.
    """
    away, span = values - np.median(values), float(np.ptp(values))
    flat = (flat_extreme(away), flat_extreme(-away))
    return [at for at in flat if at.size and abs(away[at[0]]) > FAR_PART * span]
