"""One term of the tracking error: its filter and its weights."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from transopt.base.shown import brief
from transopt.base.signals import FloatArray
from transopt.problem.objective.weighting import ErrorFilter


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
