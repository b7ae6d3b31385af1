"""The first term of the objective: how far the stylus accelerates from the recorded tap."""

from dataclasses import dataclass

import numpy as np

from transopt.base.signals import FloatArray
from transopt.problem.objective.weighting import ErrorFilter


@dataclass(frozen=True)
class Tracking:
    """sum_k w_k (F e)_k^2 / sum_k r_k^2 with e_k = y''_k - r_k, the mean over the devices that one command serves.

    Attributes
    ----------
    reference_m_s2 : (N,) r at the switching instants.
    weights : (N,) w_k >= 0.
    error_filter : F; None for 1.
    """

    reference_m_s2: FloatArray
    weights: FloatArray
    error_filter: ErrorFilter | None

    def error(self, accelerations_m_s2: FloatArray) -> FloatArray:
        """(..., N) F e of accelerations (..., N)."""
        error = accelerations_m_s2 - self.reference_m_s2
        return error if self.error_filter is None else self.error_filter.apply(error)

    def value(self, accelerations_m_s2: FloatArray) -> float:
        """The term at the accelerations (S, N) of every device."""
        r = self.reference_m_s2
        error = np.atleast_2d(self.error(accelerations_m_s2))
        return float(np.mean(error**2 @ self.weights)) / float(r @ r)

    def gradient(self, acceleration_m_s2: FloatArray, devices: int) -> FloatArray:
        """(N,) of the term by the acceleration (N,) of one of so many devices."""
        r = self.reference_m_s2
        by_error = 2 / (float(r @ r) * devices) * self.weights * self.error(acceleration_m_s2)
        return by_error if self.error_filter is None else self.error_filter.transpose(by_error)

    @property
    def filtered_m_s2(self) -> FloatArray:
        """(N,) F r."""
        return self.reference_m_s2 if self.error_filter is None else self.error_filter.apply(self.reference_m_s2)

    @property
    def unit_reference(self) -> FloatArray:
        """(N,) F r / |r|, the outputs' target where they are in units of |r|; zero for a reference of zero."""
        return np.asarray(self.filtered_m_s2 / (np.linalg.norm(self.reference_m_s2) or 1.0))

    def nrmse(self, acceleration_m_s2: FloatArray) -> float:
        """|F e| / |F r|: the NRMSE as the filter hears it."""
        return float(np.linalg.norm(self.error(acceleration_m_s2)) / np.linalg.norm(self.filtered_m_s2))
