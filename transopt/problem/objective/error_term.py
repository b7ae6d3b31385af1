"""One term of the tracking error: by what filter and with what weights it counts."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from transopt.base.shown import brief
from transopt.base.signals import FloatArray
from transopt.problem.objective.weighting import ErrorFilter


@dataclass(frozen=True)
class ErrorTerm:
    """sum_k weight_k (F e)_k^2 with e = y'' - (r - a_free), from the first lost sample to the end of the tail.

    The filter F starts at rest at the first of the L samples that no command reaches, and runs on through the N of
    the window and the M after it.

    Attributes
    ----------
    name : of the term, as a library states it.
    weights : (N,) weight_k >= 0 within the window.
    before, after : weight >= 0 of each of the L lost samples and of each of the M samples after the window.
    error_filter : F; None for 1.
    """

    name: str
    weights: FloatArray
    before: float = 1.0
    after: float = 1.0
    error_filter: ErrorFilter | None = None

    __repr__ = brief

    @cached_property
    def is_sound(self) -> bool:
        """Whether all weights are numbers >= 0."""
        weights = self.all_weights(1, 1)
        return bool(np.isfinite(weights).all() and weights.min() >= 0)

    def filtered(self, courses: FloatArray) -> FloatArray:
        """(..., K) F of courses (..., K) that are at rest before their first sample."""
        return courses if self.error_filter is None else self.error_filter.apply(courses)

    def transposed(self, by_filtered: FloatArray) -> FloatArray:
        """(..., K) gradient by the courses for a gradient by the filtered ones."""
        return by_filtered if self.error_filter is None else self.error_filter.transpose(by_filtered)

    def all_weights(self, before: int, after: int) -> FloatArray:
        """(L + N + M,) weights of the lost samples, of the window and of what comes after it."""
        return np.concatenate([np.full(before, self.before), self.weights, np.full(after, self.after)])
