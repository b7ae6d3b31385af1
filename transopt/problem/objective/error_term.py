"""The terms of the tracking error: the plain one while the hand's motion is known, the rapid one throughout."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from transopt.base.errors import InputError
from transopt.base.shown import brief
from transopt.base.signals import FloatArray
from transopt.plant.time_grid import TimeGrid
from transopt.problem.objective.figures import ROUNDING_s
from transopt.problem.objective.weighting import RAPID, ErrorFilter, highpass, pacinian


@dataclass(frozen=True)
class ErrorTerm:
    """sum_k weight_k (F e)_k^2 with e = y'' - (r - a_free), over lost samples, window and tail.

    The filter F starts at rest at the first of the L lost samples, those before any command acts, and runs through
    the N samples of the window and the M samples of the tail after it.

    Attributes
    ----------
    name : name of the term in a library.
    weights : (N,) weight_k >= 0 within the window.
    before, after : weight >= 0 of each of the L lost samples and of each of the M samples of the tail.
    error_filter : F; None for F = 1.
    """

    name: str
    weights: FloatArray
    before: float = 1.0
    after: float = 1.0
    error_filter: ErrorFilter | None = None

    __repr__ = brief

    @cached_property
    def is_sound(self) -> bool:
        """Whether all weights are finite and >= 0."""
        weights = self.all_weights(1, 1)
        return bool(np.isfinite(weights).all() and weights.min() >= 0)

    def filtered(self, courses: FloatArray) -> FloatArray:
        """(..., K) F applied to signals (..., K) that are zero before their first sample."""
        return courses if self.error_filter is None else self.error_filter.apply(courses)

    def transposed(self, by_filtered: FloatArray) -> FloatArray:
        """(..., K) gradient by the signals for a gradient by the filtered ones."""
        return by_filtered if self.error_filter is None else self.error_filter.transpose(by_filtered)

    def all_weights(self, before: int, after: int) -> FloatArray:
        """(L + N + M,) weights of the lost samples, of the window and of the tail."""
        return np.concatenate([np.full(before, self.before), self.weights, np.full(after, self.after)])


def plain(weight: float, grid: TimeGrid, intention_s: float) -> ErrorTerm:
    """The unfiltered error with a constant weight until the intention ends, and with zero weight after it.

    During the intention the hand moves on as it came, so the surface causes the whole recorded deceleration.
    Afterwards a recording does not separate the hand's own motion from the surface's effect, so slow motion is not
    tracked.

    Parameters
    ----------
    weight : >= 0.
    intention_s : duration after contact for which the hand's intention is known; infinite for a named target.
    """
    within = grid.switching_times_s < intention_s - ROUNDING_s
    # A named target involves no hand: ringing after it is error too.
    return ErrorTerm("plain", np.where(within, weight, 0.0), weight, weight if np.isinf(intention_s) else 0.0)


def rapid_filter(kind: str, from_Hz: float, dt_s: float) -> ErrorFilter | None:
    """The filter of the rapid term by the scene's `weights.rapid`; None where the scene has no such term.

    Parameters
    ----------
    kind : "highpass", "pacinian" or "none".
    from_Hz : corner of the high-pass.

    Raises
    ------
    InputError : an unknown kind, or a servo rate too low for the filter.
    """
    if kind not in RAPID:
        raise InputError(f"weights.rapid = {kind!r}: unknown; choose {', '.join(RAPID[:-1])} or {RAPID[-1]}")
    if kind == "none":
        return None
    return highpass(from_Hz, dt_s) if kind == "highpass" else pacinian(dt_s)


def rapid(by: ErrorFilter, grid: TimeGrid) -> ErrorTerm:
    """The filtered error with weight 1 for every sample, lost samples and tail included."""
    return ErrorTerm("rapid", np.ones(grid.stages), 1.0, 1.0, by)
