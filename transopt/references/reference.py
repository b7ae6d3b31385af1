"""From recordings to references: the recorded acceleration, and the motion of the stylus without current.

The stylus shall feel the recorded acceleration r, unchanged. The motor has to add what the hand does not do by
itself, r - a_free. a_free, integrated twice from the incoming speed, gives the nominal motion z_nom: the motion of
the stylus without the motor. All courses are sampled at the switching instants of the problem's grid.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from transopt.base.errors import InputError
from transopt.base.shown import brief
from transopt.base.signals import FloatArray, fast_length, integral, nrmse, splined
from transopt.plant.discretise import TimeGrid
from transopt.problem.objective.target import Target, along_normal
from transopt.recordings.tap import PreparedTap

# (speed [m/s], grip [N], a0 [m/s^2]) -> a_free as a function of time: the motion of the hand without current.
Free = Callable[[float, float, float], Callable[[FloatArray], FloatArray]]

ALIGNMENT_S = 1e-3  # largest shift of repeats against each other
SETTLING_S = 20e-3  # the filters start this long before contact

# Fields of a reference that are courses over time; all are blended by the same rule.
COURSES = (
    "recorded_m_s2",
    "recorded_before_m_s2",
    "recorded_after_m_s2",
    "free_m_s2",
    "free_before_m_s2",
    "free_after_m_s2",
    "nominal_position_m",
    "nominal_velocity_m_s",
    "nominal_position_at_ticks_m",
)


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

    def with_courses(self, stacked: FloatArray, **others: Any) -> "Reference":
        """A copy with courses from one array (K,), in the order of `stacked`, and other values of fields."""
        shapes = {name: getattr(self, name).shape for name in COURSES}
        ends = np.cumsum([math.prod(shape) for shape in shapes.values()]).tolist()
        parts: dict[str, Any] = {
            name: stacked[i:j].reshape(shape)
            for (name, shape), i, j in zip(shapes.items(), [0, *ends], ends, strict=False)
        }
        found = replace(self, **parts, **others)
        vars(found)["stacked"] = stacked
        return found

    @property
    def target(self) -> Target:
        """Target of the device at this speed: r - a_free and a_free itself."""
        recorded = self.recorded_m_s2, self.recorded_after_m_s2, self.recorded_before_m_s2
        free = self.free_m_s2, self.free_after_m_s2, self.free_before_m_s2
        if recorded[0].ndim > free[0].ndim:  # a_free is along the normal only
            now, after, before = (along_normal(each, len(recorded[0])) for each in free)
            free = now, after, before
        window, tail, lost = (of - by for of, by in zip(recorded, free, strict=True))
        return Target(window, tail, lost, *free)

    @property
    def said(self) -> str:
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


def _pieces(times_s: FloatArray, courses: FloatArray, ended: int, at_s: FloatArray) -> FloatArray:
    """(c, m) courses (c, K) at instants (m,), by one spline up to sample `ended` and another one from there on.

    r jumps to zero at the end of a recording, and a single spline would ring around the jump.
    """
    if times_s.size - ended < 4:  # all instants lie before the end
        return splined(times_s, courses, at_s)
    early, late = slice(0, ended), slice(ended, None)
    parts = [splined(times_s[part], courses[:, part], at_s, beyond=True) for part in (early, late)]
    return np.asarray(np.where(at_s < times_s[ended], *parts))


def _lags(repeats: FloatArray, step_s: float) -> FloatArray:
    """(n,) delay of each repeat (n, K) against their mean [s], to a fraction of the step."""
    reach = round(ALIGNMENT_S / step_s)
    length = fast_length(repeats.shape[1] + reach)
    # The correlation is cyclic, padded for the lags considered; negative lags are at the end.
    spectra = np.fft.rfft(repeats, length)
    matches = np.fft.irfft(spectra * spectra.mean(axis=0).conj(), length)
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
    """Mean relative error of repeats (n, K) against their mean; NaN for one repeat."""
    if repeats.shape[0] < 2:
        return float("nan")
    mean = repeats.mean(axis=0)
    return float(np.mean([nrmse(repeat, mean) for repeat in repeats]))


def build_reference(
    speed_m_s: float, grip_N: float, taps: Sequence[PreparedTap], factors: FloatArray, grid: TimeGrid, free: Free
) -> Reference:
    """Scale, align and average the taps of one grid speed and grip.

    Their mean is r, up to the end of the shortest tap. z_nom integrates a_free twice from z = 0, dz/dt = -speed at
    contact.

    Parameters
    ----------
    speed_m_s, grip_N : of the reference.
    taps : n taps.
    factors : (n,) factors that scale their accelerations to that speed.
    grid : time axis of the reference.
    free : motion of the hand without current.

    Raises
    ------
    InputError : a tap ends before the horizon does.
    """
    needed = float(grid.switching_times_s[-1])
    for tap in taps:
        if tap.acceleration.end_s < needed:
            raise InputError(
                f"{tap.recording.name}: ends {tap.acceleration.end_s * 1e3:.1f} ms after contact, the window needs "
                f"{np.ceil(needed * 1e4) / 10:.1f} ms: record longer or lower time.stages"
            )
    # At least ten points per servo period, with t = 0 among them.
    step_s = min(grid.dt_s / 10, 1e-5)
    contact = math.ceil((SETTLING_S + grid.lead_s) / step_s)
    # Similarity and delay of the taps are computed over the window, independently of what follows it.
    ends_s = grid.end_s, grid.end_s + grid.after_stages * grid.dt_s
    compared, count = (contact + math.ceil(max(end_s, 0.0) / step_s) + 2 for end_s in ends_s)
    times = np.asarray(step_s * np.arange(-contact, count - contact), dtype=float)

    def scaled(shifts_s: FloatArray, count: int, tangent: int | None = None) -> FloatArray:
        found = np.empty((len(taps), count))
        for course, factor, tap, by in zip(found, factors, taps, shifts_s.tolist(), strict=True):
            x = tap.acceleration if tangent is None else tap.across[tangent]
            np.multiply(x.evenly(by - step_s * contact, step_s, count), factor, out=course)
        return found

    shifts, unaligned = np.zeros(len(taps)), float("nan")
    if len(taps) > 1:
        as_recorded = scaled(shifts, compared)
        unaligned, lags = _spread(as_recorded), _lags(as_recorded, step_s)
        # Subtract the mean, so that alignment does not move the contact.
        shifts = lags - lags.mean()
    repeats = scaled(shifts, count)
    end_s = min(tap.acceleration.end_s - by for tap, by in zip(taps, shifts, strict=True))
    ended = int(np.searchsorted(times, end_s, side="right"))
    recorded = repeats.mean(axis=0)
    tangents = range(min(len(tap.across) for tap in taps))
    across = [scaled(shifts, count, tangent).mean(axis=0) for tangent in tangents]
    for course in (recorded, *across):
        course[ended:] = 0.0
    incoming = float(np.mean([f * tap.incoming_acceleration_m_s2 for f, tap in zip(factors, taps, strict=True)]))
    by_itself = free(speed_m_s, grip_N, incoming)(times)
    velocity = integral(by_itself, step_s)
    velocity += -speed_m_s - velocity[contact]
    position = integral(velocity, step_s)
    position -= position[contact]
    # Memory layout of a spline.
    courses = np.stack([recorded, by_itself, position, velocity, *across], axis=1).T

    # One spline evaluation for all instants, split by kind afterwards.
    instants = (grid.switching_times_s, grid.after_times_s, grid.before_times_s, grid.all_issue_times_s)
    sampled_at = _pieces(times, courses, ended, np.concatenate(instants))
    window, after, before, ticks = np.split(sampled_at, np.cumsum([each.size for each in instants])[:-1], axis=1)
    directed: Any = [0, *range(4, 4 + len(across))] if across else 0
    return Reference(
        speed_m_s=speed_m_s,
        grip_N=grip_N,
        slow_part_known=all(tap.slow_part_known for tap in taps),
        recorded_m_s2=window[directed],
        recorded_before_m_s2=before[directed],
        recorded_after_m_s2=after[directed],
        free_m_s2=window[1],
        free_before_m_s2=before[1],
        free_after_m_s2=after[1],
        nominal_position_m=window[2],
        nominal_velocity_m_s=window[3],
        nominal_position_at_ticks_m=ticks[2],
        repeatability=_spread(repeats[:, :compared]),
        repeatability_unaligned=unaligned,
        taps=tuple(taps),
        factors=np.asarray(factors),
    )
