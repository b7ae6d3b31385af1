"""Bounded nonlinear least squares, the one search for unknowns of amplifier, chain, state space, hand and coil.

The callers differ in the model behind the residuals. Termination, the treatment of bounds, and the covariance of the
unknowns are common to all.
"""

from collections.abc import Callable, Iterable

import numpy as np
from scipy import optimize

from transopt.base.signals import BoolArray, FloatArray

TOLERANCE = 1e-10
STEP = 1e-6  # of finite differences, relative to the scale of an unknown

Found = tuple[FloatArray, float]
"""Unknowns (p,) and the sum of squares of their residuals."""


class Squares:
    """A sum of squares that caches its last evaluation.

    Parameters
    ----------
    evaluate : unknowns (p,) -> residuals (n,) and their Jacobian (n, p).
    """

    def __init__(self, evaluate: Callable[[FloatArray], tuple[FloatArray, FloatArray]]) -> None:
        self._evaluate = evaluate
        self._at, self._last = np.zeros(0), (np.zeros(0), np.zeros((0, 0)))

    def evaluate(self, unknowns: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Residuals (n,) and their Jacobian (n, p)."""
        if not np.array_equal(self._at, unknowns):
            self._at, self._last = unknowns.copy(), self._evaluate(unknowns)
        return self._last

    def search(
        self,
        start: FloatArray,
        low: FloatArray,
        high: FloatArray,
        free: BoolArray | None = None,
        *,
        most: int = 200,
        tolerance: float = TOLERANCE,
        releases: int = 0,
    ) -> Found:
        """Minimise the sum of squares within the bounds, from one start.

        Parameters
        ----------
        free : (p,) whether an unknown is sought; the others keep their start.
        most : largest number of evaluations.
        tolerance : relative tolerance of the sum and of the unknowns.
        releases : how often the search is repeated from unknowns stuck at a bound with descent pointing inward.
        """
        free = np.ones(start.size, dtype=bool) if free is None else free
        point, total = self._unconstrained(start, low, high, free, most, tolerance)
        for _ in range(releases):
            residuals, slopes = self.evaluate(point)
            size = np.linalg.norm(slopes, axis=0) * float(np.linalg.norm(residuals))
            downhill = -(slopes.T @ residuals) / np.maximum(size, np.finfo(float).tiny)
            inward = np.where(point <= low, downhill, np.where(point >= high, -downhill, 0.0))
            if not np.any(inward[free] > np.sqrt(tolerance)):
                break
            again, less = self._unconstrained(point, low, high, free & (inward >= 0), most, tolerance)
            if less >= total:
                break
            point, total = again, less
        return point, total

    def _unconstrained(
        self,
        start: FloatArray,
        low: FloatArray,
        high: FloatArray,
        free: BoolArray,
        most: int,
        tolerance: float,
    ) -> Found:
        """Search with unknowns clipped at their bounds; beyond a bound the derivative is zero, so they may stick."""

        def whole(part: FloatArray) -> FloatArray:
            full = start.copy()
            full[free] = np.clip(part, low[free], high[free])
            return full

        def value(part: FloatArray) -> FloatArray:
            return self.evaluate(whole(part))[0]

        def jacobian(part: FloatArray) -> FloatArray:
            outside = (part < low[free]) | (part > high[free])
            return np.where(outside, 0.0, self.evaluate(whole(part))[1][:, free])

        # MINPACK with clipped unknowns: the factorisations of scipy's bounded methods take ten times as long when
        # their threads meet busy cores.
        found = optimize.least_squares(
            value,
            start[free],
            jac=jacobian,
            method="lm",
            ftol=tolerance,
            xtol=tolerance,
            gtol=TOLERANCE,
            max_nfev=most,
        )
        return whole(found.x), 2 * float(found.cost)

    def searches(
        self,
        starts: Iterable[FloatArray],
        low: FloatArray,
        high: FloatArray,
        *,
        most: int = 200,
    ) -> list[Found]:
        """Results of searches from several starts, the least sum first."""
        return sorted((self.search(start, low, high, most=most) for start in starts), key=lambda one: one[1])


def by_differences(
    residuals: Callable[[FloatArray], FloatArray],
) -> Callable[[FloatArray], tuple[FloatArray, FloatArray]]:
    """Residuals and their Jacobian by forward differences, for unknowns of order one.

    Parameters
    ----------
    residuals : several sets of unknowns (k, p) -> the residuals of each (k, n).
    """

    def evaluate(unknowns: FloatArray) -> tuple[FloatArray, FloatArray]:
        with np.errstate(over="ignore", invalid="ignore"):  # far from the optimum; such a step is not taken
            sets = residuals(np.vstack([unknowns, unknowns + STEP * np.eye(unknowns.size)]))
            return sets[0], np.asarray((sets[1:] - sets[0]).T / STEP)

    return evaluate


def inverse(jacobian: FloatArray) -> FloatArray:
    """Inverse of J^T J, the covariance of the unknowns where residuals have a variance of one.

    Eigenvalues get a floor: an unknown without information then has a huge variance. A pseudo-inverse would give it
    a variance of zero.
    """
    norm = np.linalg.norm(jacobian, axis=0)
    norm = np.where(norm > 0, norm, 1.0)
    scaled = jacobian / norm
    size, axes = np.linalg.eigh(scaled.T @ scaled)
    spread = 1 / np.maximum(size, np.finfo(float).eps * size.max(initial=0.0) + np.finfo(float).tiny)
    return np.asarray((axes * spread) @ axes.T / np.outer(norm, norm))
