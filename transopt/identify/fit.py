"""The statements of every fit in a model file: numbers with 95 % intervals, a verdict, and shortfalls.

A fit to design with states what it supports. Any other states its shortfalls, each with what to record again.
"""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy import special

from transopt.base.signals import FloatArray
from transopt.identify.measurement import Measurement, sources

LEVEL = 0.95  # confidence level of all intervals


def quantile(degrees: FloatArray | float = np.inf) -> FloatArray:
    """Half width of a 95 % interval in standard deviations, by Student's distribution with so many degrees (...)."""
    return np.asarray(special.stdtrit(degrees, (1 + LEVEL) / 2))


def intervals_around(values: FloatArray, covariance: FloatArray, degrees: float = np.inf) -> FloatArray:
    """(p, 2) 95 % intervals around values (p,)."""
    half = quantile(degrees) * np.sqrt(np.diagonal(covariance))
    return np.stack([values - half, values + half], axis=1)


def known(names: Sequence[str], covariance: FloatArray, intervals: FloatArray) -> dict[str, Any]:
    """Intervals, names and covariance of fitted numbers, as a part of a model file states them beside the values.

    Parameters
    ----------
    covariance : (p, p). intervals : (p, 2). Both in the order of `names`.
    """
    return {
        "intervals": dict(zip(names, intervals.tolist(), strict=True)),
        "parameters": list(names),
        "covariance": ((covariance + covariance.T) / 2).tolist(),
    }


class Fit(ABC):
    """A fit that becomes a part of a model file."""

    @abstractmethod
    def stated(self) -> dict[str, Any]:
        """The content that is specific to this kind of part: values, intervals, parameters, covariance."""

    @abstractmethod
    def shortfalls(self) -> list[str]:
        """Reasons why the fit is not fit to design with, each with what to record again; empty if it is."""

    @abstractmethod
    def supports(self) -> str:
        """The designs that a fit without shortfalls may be used for, in plain words."""

    def verdict(self) -> str:
        """One sentence for the model file and the user: what the fit supports, or why it supports nothing."""
        short = self.shortfalls()
        return f"not fit to design with: {'; '.join(short)}" if short else self.supports()

    def content(self, runs: Sequence[Measurement]) -> dict[str, Any]:
        """The part of the model file that this fit, made from these runs, becomes."""
        judged = {"verdict": self.verdict(), "shortfalls": self.shortfalls(), "sources": sources(runs)}
        return {**self.stated(), **judged}
