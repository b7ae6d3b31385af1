"""From recordings to references: the recorded acceleration, and the motion of the stylus without current.

The stylus shall feel the recorded acceleration r, unchanged. The motor has to add what the hand does not do by
itself, r - a_free. a_free, integrated twice from the incoming speed, gives the nominal motion z_nom: the motion of
the stylus without the motor. All courses are sampled at the switching instants of the problem's grid.
"""

import itertools
import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from transopt.base.errors import InputError
from transopt.base.shown import brief
from transopt.base.signals import FloatArray, Signal, fast_length, integral, nrmse, splined
from transopt.plant.time_grid import TimeGrid
from transopt.problem.objective.target import Target, along_normal
from transopt.recordings.tap import PreparedTap

# (speed [m/s], grip [N], a0 [m/s^2]) -> a_free as a function of time: the motion of the hand without current, linear
# in speed and a0.
Free = Callable[[float, float, float], Callable[[FloatArray], FloatArray]]

ALIGNMENT_S = 1e-3  # largest shift of repeats against each other
SETTLING_S = 20e-3  # the filters start this long before contact
FADING_S = 5e-3  # before its end a tap fades out of the mean of those that go on, so that the mean has no step

# Fields of a reference that are courses over time; all are blended by the same rule. Those of one quantity follow
# each other in time.
COURSES = (
    "recorded_before_m_s2",
    "recorded_m_s2",
    "recorded_after_m_s2",
    "free_before_m_s2",
    "free_m_s2",
    "free_after_m_s2",
    "nominal_position_m",
    "nominal_velocity_m_s",
    "nominal_position_at_ticks_m",
)

Within = dict[str, tuple[slice, tuple[int, ...]]]  # name in `COURSES` -> its part of one array of all, and its shape


def _parts(shapes: Sequence[tuple[int, ...]]) -> Within:
    """Parts of an array (K,) in which courses of these shapes follow each other, in the order of `COURSES`."""
    ends = itertools.accumulate(map(math.prod, shapes), initial=0)
    parts = [(slice(*of), shape) for of, shape in zip(itertools.pairwise(ends), shapes, strict=True)]
    return dict(zip(COURSES, parts, strict=True))


def _views(stacked: FloatArray, within: Within) -> dict[str, Any]:
    """Courses by name, as parts of an array (K,)."""
    return {
        name: stacked[part] if len(shape) == 1 else stacked[part].reshape(shape)
        for name, (part, shape) in within.items()
    }


@dataclass(frozen=True)
class Reference:
    """The motion that the device has to produce at one grid speed, at the switching instants.

    Attributes
    ----------
    speed_m_s : incoming speed.
    grip_N : grip force of the hand.
    recorded_m_s2, recorded_before_m_s2, recorded_after_m_s2 : (N,), (L,), (M,) r, the recorded acceleration: at the
        switching instants of the window; at those between contact and tau_0, which no command can reach; and at those
        after the window. Zero after the end of the recording. If all directions were asked for, (3, N) and so on,
        along the normal and two tangents.
    free_m_s2, free_before_m_s2, free_after_m_s2 : (N,), (L,), (M,) a_free, acceleration of the stylus without
        current.
    nominal_position_m : (N,) z_nom.
    nominal_velocity_m_s : (N,) derivative of z_nom.
    nominal_position_at_ticks_m : (N + M,) z_nom at the servo ticks t_k, where the encoder is read.
    repeatability : mean relative error of the aligned repeats against their mean; NaN for one tap.
    repeatability_unaligned : the same error before alignment.
    taps : the n recordings used.
    factors : (n,) factors that scaled them to the grid speed.
    between_m_s : the two recorded speeds that it is blended from; None if its speed was recorded.
    of_grips_N : recorded grips that it is made from: its own or the nearest one, or those it is blended from; empty
        if its taps state no grip and serve every grip.
    missing_s : end of the tail that none of its recordings reaches, where r counts as zero.
    slow_part_known : whether frequencies below those of the tap were recorded, so that the unfiltered error has
        meaning.
    name : name of a named target, which has no speed; empty for a tap.
    ends_s : end of a named target; infinite for a tap.
    peak_m_s2 : largest magnitude of a named target, also between the instants; NaN for a tap.
    sha256 : hash of the file of a named target; empty for one stated by parameters.
    """

    speed_m_s: float
    grip_N: float
    recorded_m_s2: FloatArray
    recorded_before_m_s2: FloatArray
    recorded_after_m_s2: FloatArray
    free_m_s2: FloatArray
    free_before_m_s2: FloatArray
    free_after_m_s2: FloatArray
    nominal_position_m: FloatArray
    nominal_velocity_m_s: FloatArray
    nominal_position_at_ticks_m: FloatArray
    repeatability: float
    repeatability_unaligned: float
    taps: tuple[PreparedTap, ...]
    factors: FloatArray
    between_m_s: tuple[float, float] | None = None
    of_grips_N: tuple[float, ...] = ()
    missing_s: float = 0.0
    slow_part_known: bool = True
    name: str = ""
    ends_s: float = math.inf
    peak_m_s2: float = math.nan
    sha256: str = ""

    __repr__ = brief

    @cached_property
    def stacked(self) -> FloatArray:
        """(K,) all its courses concatenated, in the form that `with_courses` takes."""
        return np.concatenate([getattr(self, name).ravel() for name in COURSES])

    @cached_property
    def within_stacked(self) -> Within:
        """Name in `COURSES` -> its part of `stacked`, and its shape."""
        return _parts([getattr(self, name).shape for name in COURSES])

    def with_courses(self, stacked: FloatArray, **others: Any) -> "Reference":
        """A copy whose courses are parts of one array (K,), in the order of `stacked`, and with other fields."""
        found, within = object.__new__(type(self)), self.within_stacked
        vars(found).update(vars(self), **others, stacked=stacked, **_views(stacked, within))
        for of_courses in ("target", "aims_at_recorded"):
            vars(found).pop(of_courses, None)
        return found

    @cached_property
    def target(self) -> Target:
        """Target of the device at this speed: r - a_free and a_free itself."""
        return self.aimed()

    @cached_property
    def aims_at_recorded(self) -> bool:
        """Whether r - a_free is r itself, along a single direction."""
        return self.recorded_m_s2.ndim == 1 and not any(getattr(self, name).any() for name in COURSES[3:6])

    def aimed(self, into: FloatArray | None = None) -> Target:
        """`target` with r - a_free written into an array (K,), or (p, K), which it shares unless it is r itself."""
        lost, stages = self.recorded_before_m_s2.shape[-1], self.recorded_m_s2.shape[-1]
        count = lost + stages + self.recorded_after_m_s2.shape[-1]
        if self.recorded_m_s2.ndim == 1:
            recorded, free = self.stacked[: 2 * count].reshape(2, count)
        else:
            recorded = np.concatenate([getattr(self, name) for name in COURSES[:3]], axis=-1)
            free = np.concatenate([getattr(self, name) for name in COURSES[3:6]], axis=-1)
        if recorded.ndim > free.ndim:  # a_free is along the normal only
            free = along_normal(free, len(recorded))
        whole = recorded if self.aims_at_recorded else np.subtract(recorded, free, out=into)
        return Target.of_whole(whole, free, lost, stages)

    @property
    def in_words(self) -> str:
        """Name of the target or speed of the tap, for messages."""
        return self.name or f"the tap at {self.speed_m_s:g} m/s"

    @property
    def incoming_acceleration_m_s2(self) -> float:
        """Mean a0 of its taps, scaled to its speed; 0 for a named target."""
        own = [factor * tap.incoming_acceleration_m_s2 for factor, tap in zip(self.factors, self.taps, strict=True)]
        return float(np.mean(own)) if own else 0.0

    @property
    def scalings(self) -> FloatArray:
        """(n,) total factor on each recorded acceleration."""
        return np.asarray([factor * tap.amplitude for factor, tap in zip(self.factors, self.taps, strict=True)])


def _lags(repeats: FloatArray, step_s: float, finer: int) -> FloatArray:
    """(n,) delay of each repeat (n, K), `finer` steps a sample, against their mean, to a part of a step [s]."""
    reach = round(ALIGNMENT_S / step_s)
    length = fast_length(repeats.shape[1] + math.ceil(reach / finer))
    # The correlation is cyclic, padded for the lags considered; negative lags are at the end. The inverse transform
    # is longer, so that it has the correlation between the samples too.
    spectra = np.fft.rfft(repeats, length)
    matches = np.fft.irfft(spectra * spectra.mean(axis=0).conj(), finer * length)
    lags = []
    for window in np.hstack([matches[:, -reach:], matches[:, : reach + 1]]):
        best = int(np.argmax(window))
        shift = float(best - reach)
        if 0 < best < window.size - 1:
            left, centre, right = window[best - 1 : best + 2]
            curvature = left - 2 * centre + right
            shift += 0.5 * (left - right) / curvature if curvature < 0 else 0.0
        lags.append(shift * step_s)
    return np.asarray(lags)


def _spread(repeats: FloatArray) -> float:
    """Mean relative error of repeats (n, K) against their mean."""
    mean = repeats.mean(axis=0)
    return float(np.mean([nrmse(repeat, mean) for repeat in repeats]))


class TimeAxis:
    """A time axis on which references are made, and the motions without current along it, kept by grip.

    Parameters
    ----------
    grid : switching instants, those beside the window, and servo ticks.
    free : motion of the hand without current.
    """

    def __init__(self, grid: TimeGrid, free: Free) -> None:
        self.grid, self._free, self._kept = grid, free, dict[tuple[float, float, float], FloatArray]()
        # At least ten points per servo period, with t = 0 among them.
        self.step_s = min(grid.dt_s / 10, 1e-5)
        self.contact = math.ceil((SETTLING_S + grid.lead_s) / self.step_s)
        # Lost samples, window and tail, evenly spaced, at which r is sampled; ticks.
        self._instants = grid.before_times_s, grid.switching_times_s, grid.after_times_s, grid.all_issue_times_s
        self.felt_at_s = np.concatenate(self._instants[:3])

    def points(self, end_s: float) -> int:
        """How many points of the fine axis reach from the settling to a time after contact."""
        return self.contact + math.ceil(max(end_s, 0.0) / self.step_s) + 2

    def within_stacked(self, directions: int) -> Within:
        """Parts of all courses of a reference of one or three directions, in one array (K,)."""
        lost, stages, after, ticks = (each.size for each in self._instants)
        along = () if directions == 1 else (directions,)
        recorded = [(*along, size) for size in (lost, stages, after)]
        return _parts([*recorded, *((size,) for size in (lost, stages, after, stages, stages, ticks))])

    def motion(self, speed_m_s: float, grip_N: float, incoming_m_s2: float) -> FloatArray:
        """(m,) a_free, z_nom, its derivative and z_nom at the ticks, in the order of `COURSES`.

        At contact z_nom = 0 and dz_nom/dt = -speed.
        """
        found = speed_m_s * self._unit(1.0, grip_N, 0.0)
        return found if incoming_m_s2 == 0 else found + incoming_m_s2 * self._unit(0.0, grip_N, 1.0)

    def _unit(self, speed_m_s: float, grip_N: float, incoming_m_s2: float) -> FloatArray:
        key = speed_m_s, grip_N, incoming_m_s2
        if key not in self._kept:
            count = self.points(self.grid.end_s + self.grid.after_stages * self.grid.dt_s)
            times = np.asarray(self.step_s * np.arange(-self.contact, count - self.contact), dtype=float)
            by_itself = self._free(*key)(times)
            velocity = integral(by_itself, self.step_s)
            velocity += -speed_m_s - velocity[self.contact]
            position = integral(velocity, self.step_s)
            position -= position[self.contact]
            free, z, velocity = splined(
                times, np.stack([by_itself, position, velocity]), np.concatenate(self._instants)
            )
            felt, first = self.felt_at_s.size, self.grid.before_times_s.size
            window = slice(first, first + self.grid.stages)
            self._kept[key] = np.concatenate([free[:felt], z[window], velocity[window], z[felt:]])
        return self._kept[key]


def build_reference(
    speed_m_s: float,
    grip_N: float,
    taps: Sequence[PreparedTap],
    factors: FloatArray,
    axis: TimeAxis,
    of_grips_N: tuple[float, ...] = (),
) -> Reference:
    """Scale, align and average the taps of one grid speed and grip.

    Their mean is r, at each instant that of the taps that reach it, up to the end of the longest one. z_nom
    integrates a_free twice from z = 0, dz/dt = -speed at contact.

    Parameters
    ----------
    speed_m_s, grip_N : of the reference.
    taps : n taps.
    factors : (n,) factors that scale their accelerations to that speed.
    axis : time axis of the reference.
    of_grips_N : see `Reference`.

    Raises
    ------
    InputError : a tap ends before the horizon does.
    """
    grid, step_s = axis.grid, axis.step_s
    needed = float(grid.switching_times_s[-1])
    for tap in taps:
        if tap.acceleration.end_s < needed:
            raise InputError(
                f"{tap.recording.name}: ends {tap.acceleration.end_s * 1e3:.1f} ms after contact, the window needs "
                f"{np.ceil(needed * 1e4) / 10:.1f} ms: record longer or lower time.stages"
            )
    shifts, unaligned, repeatability = np.zeros(len(taps)), float("nan"), float("nan")
    if len(taps) > 1:
        # Similarity and delay of the taps are computed over the window, independently of what follows it, at twice
        # the rate of the recordings.
        finer = max(int(min(tap.acceleration.dt_s for tap in taps) / (2 * step_s)), 1)

        def compared(shifts_s: FloatArray) -> FloatArray:
            first_s, count = -step_s * axis.contact, axis.points(grid.end_s) // finer
            courses = [
                tap.acceleration.evenly(first_s + by, finer * step_s, count)
                for tap, by in zip(taps, shifts_s, strict=True)
            ]
            return factors[:, None] * courses

        as_recorded = compared(shifts)
        unaligned, lags = _spread(as_recorded), _lags(as_recorded, step_s, finer)
        # Subtract the mean, so that alignment does not move the contact.
        shifts = lags - lags.mean()
        repeatability = _spread(compared(shifts))
    ends_s = np.array([tap.acceleration.end_s - by for tap, by in zip(taps, shifts, strict=True)])
    left = np.subtract.outer(ends_s, axis.felt_at_s) / FADING_S
    shares = np.where(left >= 0, np.clip(left, 1e-9, 1.0), 0.0)
    count = np.maximum(shares.sum(axis=0), np.finfo(float).tiny)  # so the last one alone counts in full up to its end

    def recorded(signals: Iterable[Signal]) -> FloatArray:
        first_s, of = float(axis.felt_at_s[0]), zip(shares, factors, signals, shifts, strict=True)
        total = sum(share * factor * x.evenly(first_s + by, grid.dt_s, count.size) for share, factor, x, by in of)
        return np.asarray(total / count)

    directions = 1 + min(len(tap.across) for tap in taps)
    felt = [recorded(([tap.acceleration, *tap.across])[i] for tap in taps) for i in range(directions)]
    incoming = float(np.mean([f * tap.incoming_acceleration_m_s2 for f, tap in zip(factors, taps, strict=True)]))
    within = axis.within_stacked(directions)
    blocks = np.split(np.stack(felt), [grid.before_times_s.size, grid.before_times_s.size + grid.stages], axis=-1)
    stacked = np.concatenate([*map(np.ravel, blocks), axis.motion(speed_m_s, grip_N, incoming)])
    found = Reference(
        speed_m_s=speed_m_s,
        grip_N=grip_N,
        slow_part_known=all(tap.slow_part_known for tap in taps),
        missing_s=max(float(axis.felt_at_s[-1] - ends_s.max()), 0.0),
        repeatability=repeatability,
        repeatability_unaligned=unaligned,
        taps=tuple(taps),
        factors=np.asarray(factors),
        of_grips_N=of_grips_N,
        **_views(stacked, within),
    )
    vars(found).update(stacked=stacked, within_stacked=within)
    return found
