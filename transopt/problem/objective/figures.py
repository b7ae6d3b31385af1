"""Figures that compare a movement with the recorded tap, for all tables, reports and verdicts.

They compare a = y'' + a_free, the whole acceleration of the stylus, with the recorded r, independently of the
objective's weights. Samples run from contact or tau_0, whichever is earlier, to the end of the tail; the L lost
samples, which no command reaches, are included.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from transopt.base.signals import FloatArray, samples_before
from transopt.plant.discretise import TimeGrid
from transopt.plant.intention import INTENTION_S
from transopt.problem.objective.target import Target, normal
from transopt.problem.objective.weighting import ErrorFilter, bandpass

NAN = float("nan")
FELT_Hz = (120.0, 620.0)  # first-order band in which vibration is felt; the same for every objective
BUMP_Hz = (10.0, 60.0)  # second-order band in which the hand notices that the surface lets go
ROUNDING_s = 1e-9  # rounding of a time that is a multiple of the servo period
MIN_SPEED_CHANGE = 1e-3  # as a share of the integral of |r|: a tap with less changes no speed


@dataclass(frozen=True)
class Figures:
    """The figures of one movement. The intention is the time in which the hand moves on as it came.

    Attributes
    ----------
    tap_error : |a - r| / |r| over the intention, unfiltered.
    felt_error : |B (a - r)| / |B r| over all samples, B the band-pass of 120 to 620 Hz; NaN where the servo rate is
        too low for it.
    felt_dB : energy of B a over that of B r [dB].
    speed : change of speed over the intention, that of a over that of r: 1 is a surface as hard as the real one;
        below 0 the surface pulls. NaN for a named target, and for a tap that changes no speed.
    bump_m_s2 : peak of the error in 10 to 60 Hz after the intention, when the surface lets go; NaN for a named
        target, without samples after the intention, or where the servo rate is too low for the band.
    error_after : |a - r| over the tail divided by |r| over the intention.
    peak_after_m_s2 : largest |a - r| over the tail.
    """

    tap_error: float
    felt_error: float
    felt_dB: float
    speed: float
    bump_m_s2: float
    error_after: float
    peak_after_m_s2: float


@dataclass(frozen=True)
class Yardstick:
    """The rule by which the figures of a movement are computed.

    Attributes
    ----------
    grid : time axis of the accelerations.
    intention_s : duration of the intention after contact; for a named target its whole window.
    named : whether the target is a named one, such as a click, without a hand whose speed could change.
    """

    grid: TimeGrid
    intention_s: float = INTENTION_S
    named: bool = False

    @cached_property
    def _felt(self) -> tuple[ErrorFilter, ...]:
        return _felt(self.grid.dt_s)

    @cached_property
    def _bump(self) -> tuple[ErrorFilter, ...]:
        return bandpass(*BUMP_Hz, self.grid.dt_s, 2) if 2 * BUMP_Hz[1] * self.grid.dt_s < 1 else ()

    def _intention(self, lost: int, count: int) -> slice:
        """The samples within the intention, among `count` of which the first lies `lost` samples before tau_0."""
        dt_s = self.grid.dt_s
        first_s = float(self.grid.switching_times_s[0]) - lost * dt_s
        begins, ends = (
            samples_before(time_s - ROUNDING_s, first_s, dt_s, count) for time_s in (0.0, self.intention_s)
        )
        return slice(begins, ends)

    def tap_error(self, target: Target, acceleration_m_s2: FloatArray) -> float:
        """`Figures.tap_error` alone, for y'' (K,) from tau_0 on with K at least the samples of the window.

        Of a plant with several directions, y'' (p, K), it is that along the normal.
        """
        target, acceleration_m_s2 = target.normal, normal(acceleration_m_s2)
        recorded, lost = target.recorded_m_s2, target.before_m_s2.size
        first = self._intention(lost, recorded.size)
        made = np.append(np.zeros(lost), acceleration_m_s2)
        made = np.append(made, np.zeros(max(recorded.size - made.size, 0)))[: recorded.size] + target.free_m_s2
        return _over(float(np.linalg.norm((made - recorded)[first])), float(np.linalg.norm(recorded[first])))

    def across(self, target: Target, acceleration_m_s2: FloatArray) -> tuple[float, float]:
        """Error across the normal over the intention, over |r| along it, and the angle by which that turns y'' [rad].

        Parameters
        ----------
        acceleration_m_s2 : (p, K) y'' from tau_0 on, the normal first, K at least the samples of the window.
        """
        N, lost = self.grid.stages, target.lost
        first = self._intention(lost, lost + N)
        made = target.free_m_s2[:, : lost + N].copy()
        made[:, lost:] += acceleration_m_s2[:, :N]
        recorded = target.recorded_m_s2[:, first]
        aside, straight = (float(np.linalg.norm(x)) for x in (made[1:, first] - recorded[1:], made[0, first]))
        return _over(aside, float(np.linalg.norm(recorded[0]))), float(np.arctan2(aside, straight))

    def figures(self, target: Target, acceleration_m_s2: FloatArray) -> Figures:
        """Figures of y'' (K,) from tau_0 on, with K at least the samples of the target's window and tail.

        For a tap of zero the errors are 0 without motion, else infinite. For a plant with several directions, y''
        (p, K), they are those along the normal.
        """
        target, acceleration_m_s2 = target.normal, normal(acceleration_m_s2)
        lost = target.before_m_s2.size
        free, recorded = target.free_m_s2, target.recorded_m_s2
        made = free.copy()
        made[lost:] += acceleration_m_s2[: made.size - lost]
        off = made - recorded
        first = self._intention(lost, off.size)
        tail = off[lost + target.window_m_s2.size :]
        size = float(np.linalg.norm(recorded[first]))
        felt_off, felt_made, felt_recorded = _through(self._felt, np.stack([off, made, recorded]))
        change, swept = float(np.sum(recorded[first])), float(np.sum(np.abs(recorded[first])))
        return Figures(
            tap_error=_over(float(np.linalg.norm(off[first])), size),
            felt_error=_over(float(np.linalg.norm(felt_off)), float(np.linalg.norm(felt_recorded)))
            if self._felt
            else NAN,
            felt_dB=_dB(float(felt_made @ felt_made), float(felt_recorded @ felt_recorded)) if self._felt else NAN,
            speed=NAN
            if self.named or abs(change) <= MIN_SPEED_CHANGE * swept
            else float(np.sum(made[first])) / change,
            bump_m_s2=NAN
            if self.named or first.stop == off.size or not self._bump
            else float(np.abs(_through(self._bump, off)[first.stop :]).max()),
            error_after=_over(float(np.linalg.norm(tail)), size),
            peak_after_m_s2=float(np.abs(tail).max(initial=0.0)),
        )


def _felt(dt_s: float) -> tuple[ErrorFilter, ...]:
    return bandpass(*FELT_Hz, dt_s, 1) if 2 * FELT_Hz[1] * dt_s < 1 else ()


def felt(course: FloatArray, dt_s: float) -> FloatArray:
    """(K,) acceleration from rest through the band of `Figures.felt_error`; NaN where the servo rate is too low."""
    filters = _felt(dt_s)
    return _through(filters, course) if filters else np.full_like(course, np.nan)


def _through(filters: tuple[ErrorFilter, ...], course: FloatArray) -> FloatArray:
    for each in filters:
        course = each.apply(course)
    return course


def _over(error: float, size: float) -> float:
    if size == 0:
        return 0.0 if error == 0 else float("inf")
    return error / size


def _dB(made: float, wanted: float) -> float:
    if not wanted > 0:
        return NAN
    return float(10 * np.log10(max(made / wanted, np.finfo(float).tiny)))
