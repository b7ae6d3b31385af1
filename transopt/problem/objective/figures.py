"""Figures that compare a movement with the recorded tap, for all tables, reports and verdicts.

They compare a = y'' + a_free, the whole acceleration of the stylus, with the recorded r, independently of the
objective's weights. Samples run from contact or tau_0, whichever is earlier, to the end of the tail; the L lost
samples, which no command reaches, are included.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from transopt.base.signals import FloatArray, samples_before
from transopt.plant.intention import INTENTION_S
from transopt.plant.time_grid import TimeGrid
from transopt.problem.objective.target import Target
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
        """`tap_errors` of one movement (K,) or (p, K)."""
        return float(self.tap_errors([target], acceleration_m_s2[None])[0])

    def tap_errors(self, targets: Sequence[Target], accelerations_m_s2: FloatArray) -> FloatArray:
        """(m,) `Figures.tap_error` alone, for y'' (m, K) from tau_0 on with K at least the samples of the intention.

        Of a plant with several directions, y'' (m, p, K), they are those along the normal.

        Parameters
        ----------
        targets : one per movement, all with the same numbers of samples.
        """
        targets = [target.normal for target in targets]
        along = accelerations_m_s2[:, 0] if accelerations_m_s2.ndim > 2 else accelerations_m_s2
        first = self._intention(targets[0].lost, targets[0].whole_m_s2.size)
        recorded = np.stack([target.recorded_m_s2[first] for target in targets])
        made = np.stack([target.free_m_s2 for target in targets])
        lost = targets[0].lost
        made[:, lost : first.stop] += along[:, : max(first.stop - lost, 0)]
        return _over(_size(made[:, first] - recorded), _size(recorded))

    def across(self, target: Target, acceleration_m_s2: FloatArray) -> tuple[float, float]:
        """Error across the normal over the intention, over |r| along it, and the angle by which that turns y'' [rad].

        Parameters
        ----------
        acceleration_m_s2 : (p, K) y'' from tau_0 on, the normal first, K at least the samples of window and tail.
        """
        made = target.free_m_s2.copy()
        made[:, target.lost :] += acceleration_m_s2[:, : made.shape[1] - target.lost]
        first = self._intention(target.lost, made.shape[1])
        recorded = target.recorded_m_s2[:, first]
        aside, straight = (float(np.linalg.norm(x)) for x in (made[1:, first] - recorded[1:], made[0, first]))
        error = _over(np.array([aside]), _size(recorded[:1]))
        return float(error[0]), float(np.arctan2(aside, straight))

    def figures(self, target: Target, acceleration_m_s2: FloatArray) -> Figures:
        """`figures_of` one movement (K,)."""
        return self.figures_of([target], acceleration_m_s2[None])[0]

    def figures_of(self, targets: Sequence[Target], accelerations_m_s2: FloatArray) -> list[Figures]:
        """Figures of y'' (m, K) from tau_0 on, with K at least the samples of the targets' windows and tails.

        For a tap of zero the errors are 0 without motion, else infinite. For a plant with several directions, y''
        (m, p, K), they are those along the normal.

        Parameters
        ----------
        targets : one per movement, all with the same numbers of samples.
        """
        targets = [target.normal for target in targets]
        along = accelerations_m_s2[:, 0] if accelerations_m_s2.ndim > 2 else accelerations_m_s2
        lost, N = targets[0].before_m_s2.size, targets[0].window_m_s2.size
        recorded = np.stack([target.recorded_m_s2 for target in targets])
        both = np.empty((2, *recorded.shape))
        off, made = both
        np.stack([target.free_m_s2 for target in targets], out=made)
        made[:, lost:] += along[:, : made.shape[1] - lost]
        np.subtract(made, recorded, out=off)
        first = self._intention(lost, off.shape[1])
        tail, meant = off[:, lost + N :], recorded[:, first]
        size, change, swept = _size(meant), np.sum(meant, axis=1), np.sum(np.abs(meant), axis=1)
        unknown = np.full(len(targets), NAN)
        speed, felt_error, felt_dB, bump = unknown, unknown, unknown, unknown
        if not self.named:
            changes = np.abs(change) > MIN_SPEED_CHANGE * swept
            speed = np.where(changes, np.sum(made[:, first], axis=1) / np.where(changes, change, 1.0), NAN)
            if first.stop < off.shape[1] and self._bump:
                bump = np.abs(_through(self._bump, off)[:, first.stop :]).max(axis=1)
        if self._felt:
            off_felt, made_felt = _through(self._felt, both)
            felt_off, felt_made, felt_recorded = map(_size, (off_felt, made_felt, made_felt - off_felt))
            felt_error, felt_dB = _over(felt_off, felt_recorded), _dB(felt_made**2, felt_recorded**2)
        columns = (
            _over(_size(off[:, first]), size),
            felt_error,
            felt_dB,
            speed,
            bump,
            _over(_size(tail), size),
            np.abs(tail).max(axis=1, initial=0.0),
        )
        return [Figures(*row) for row in np.stack(columns, axis=1).tolist()]


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


def _size(courses: FloatArray) -> FloatArray:
    """(m,) root of the sum of squares of each course (m, K)."""
    return np.asarray(np.sqrt(np.einsum("mk,mk->m", courses, courses)))


def _over(error: FloatArray, size: FloatArray) -> FloatArray:
    """(m,) relative errors; of a size of zero 0 where there is no error either, else infinite."""
    return np.asarray(np.where(size == 0, np.where(error == 0, 0.0, np.inf), error / np.where(size == 0, 1.0, size)))


def _dB(made: FloatArray, wanted: FloatArray) -> FloatArray:
    """(m,) energies over those that are wanted [dB]; NaN where nothing is."""
    ratio = np.maximum(made / np.where(wanted > 0, wanted, 1.0), np.finfo(float).tiny)
    return np.asarray(np.where(wanted > 0, 10 * np.log10(ratio), NAN))
