"""The likelihood of condensed records under a model, its maximum, and what is known of it.

With the noise of each line known from the records themselves (`condensed`), the negative logarithm of the likelihood
is a sum of squares: of W (H(theta) - H_measured), bin by bin, over all outputs of all grips. Its maximum is bounded
nonlinear least squares with exact derivatives. Amplifiers, chains and hands are parameterisations of it.

The covariance is the inverse of the information, widened by two things that the noise within a trial does not show:
what the model leaves unexplained (the scatter), and how much the trials differ (a hand is never held twice alike).
For the latter each trial's own score says how far this trial alone would move each unknown; where the sum of their
squares is above what the noise makes of it, the variance is the observed one (the sandwich of White 1982, unknown by
unknown).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from transopt.base.signals import ComplexArray, FloatArray
from transopt.identify.condensed import Condensed
from transopt.identify.squares import Squares, inverse

LEAST_TRIALS = 3  # of all grips together, whose differences mean something

Model = Callable[[FloatArray, int, FloatArray], tuple[ComplexArray, ComplexArray]]
"""theta (p,), number of the group, frequencies (m,) -> responses (o, m) and derivatives (p, o, m)."""


@dataclass(frozen=True)
class Maximum:
    """The unknowns that explain the records best.

    Attributes
    ----------
    unknowns : (p,).
    covariance : (p, p); zero for what was held fixed.
    chi_square : sums of squares, an array (o,) for each group, whose numbers of outputs may differ.
    points : their real numbers, in the same arrays.
    free : (p,) what was sought.
    bounded : (p,) what ended at a bound; its deviation is half the range searched.
    between : (p,) observed variance between the trials over what the noise within them makes of it; 1 where unknown.
    """

    unknowns: FloatArray
    covariance: FloatArray
    chi_square: tuple[FloatArray, ...]
    points: tuple[NDArray[np.int_], ...]
    free: NDArray[np.bool_]
    bounded: NDArray[np.bool_]
    between: FloatArray

    @property
    def scatter(self) -> float:
        """Mean square of the residuals: 1 where the model is right."""
        return self.total / max(self.count - int(self.free.sum()), 1)

    @property
    def count(self) -> int:
        """Real numbers of all outputs of all groups."""
        return sum(int(points.sum()) for points in self.points)

    @property
    def total(self) -> float:
        """Sum of squares of all outputs of all groups."""
        return float(sum(squares.sum() for squares in self.chi_square))


class Likelihood(Squares):
    """Sum of squares of all groups.

    `loose` adds a relative error to every response, so that one sharp peak does not rule a search; `step` takes each
    step-th bin.
    """

    def __init__(self, groups: Sequence[Condensed], model: Model, *, loose: float = 0.0, step: int = 1) -> None:
        super().__init__(self._all)
        self._model = model
        self.groups = [group.some(slice(step // 2, None, step)) if step > 1 else group for group in groups]
        self._roots, self._wanted = [], []
        for group in self.groups:
            roots, values = group.roots(), group.values()
            if loose:
                weight = np.abs(np.einsum("obij,obj->obi", roots, values)) ** 2
                roots = roots / np.sqrt(1 + loose**2 * weight.max(axis=2))[:, :, None, None]
            self._roots.append(roots)
            self._wanted.append(np.einsum("obij,obj->obi", roots, values))

    @property
    def points(self) -> tuple[NDArray[np.int_], ...]:
        """Real numbers that count: an array (o,) for each group, whose numbers of outputs may differ."""
        return tuple(2 * (group.known[:, :, None] & group.used).sum(axis=(1, 2)) for group in self.groups)

    def _responses(self, unknowns: FloatArray, j: int) -> tuple[ComplexArray, ComplexArray]:
        """(o, b, q) and (p, o, b, q) of a group."""
        shape = self.groups[j].frequencies_Hz.shape
        value, slope = self._model(unknowns, j, self.groups[j].frequencies_Hz.ravel())
        return value.reshape(-1, *shape), slope.reshape(slope.shape[0], -1, *shape)

    def _all(self, unknowns: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Residuals (n,) and Jacobian (n, p), group by group, real parts before imaginary ones in each."""
        residuals, jacobians = [], []
        for j, (roots, wanted) in enumerate(zip(self._roots, self._wanted, strict=True)):
            value, slope = self._responses(unknowns, j)
            error = np.einsum("obij,obj->obi", roots, value) - wanted
            moved = np.einsum("obij,pobj->pobi", roots, slope, optimize=True).reshape(slope.shape[0], -1).T
            residuals += [error.real.ravel(), error.imag.ravel()]
            jacobians += [moved.real, moved.imag]
        return np.concatenate(residuals), np.concatenate(jacobians)

    def maximum(
        self, start: FloatArray, low: FloatArray, high: FloatArray, free: NDArray[np.bool_], most: int = 200
    ) -> Maximum:
        """The best unknowns near `start`, with their covariance."""
        unknowns, _ = self.search(start, low, high, free, most=most)
        return self.around(unknowns, low, high, free)

    def around(self, unknowns: FloatArray, low: FloatArray, high: FloatArray, free: NDArray[np.bool_]) -> Maximum:
        """What is known of unknowns that were sought by other means."""
        residuals, jacobian = self.evaluate(unknowns)
        reach = 1e-6 * (high - low)
        bounded = free & ((unknowns <= low + reach) | (unknowns >= high - reach))
        chi_square, first = list[FloatArray](), 0
        for wanted in self._wanted:
            size, shape = wanted.size, (2, wanted.shape[0], -1)
            chi_square.append((residuals[first : first + 2 * size].reshape(shape) ** 2).sum(axis=(0, 2)))
            first += 2 * size
        inside = free & ~bounded
        covariance = inverse(jacobian[:, inside])
        between = np.ones(unknowns.size)
        between[inside] = self._between(unknowns, covariance, inside)
        found = Maximum(
            unknowns=unknowns,
            covariance=np.zeros((unknowns.size, unknowns.size)),
            chi_square=tuple(chi_square),
            points=self.points,
            free=free,
            bounded=bounded,
            between=between,
        )
        spread = np.sqrt(np.maximum(max(found.scatter, 1.0), between[inside]))
        found.covariance[np.ix_(inside, inside)] = spread[:, None] * covariance * spread
        found.covariance[bounded, bounded] = ((high - low)[bounded] / 4) ** 2  # all that was searched
        return found

    def _between(self, unknowns: FloatArray, covariance: FloatArray, inside: NDArray[np.bool_]) -> FloatArray:
        """(free,) observed variance of each unknown by the trials' scores, over that by the noise within them."""
        moves = []
        for j, group in enumerate(self.groups):
            value, slope = self._responses(unknowns, j)
            weight = 2 * group.known / group.noise
            own = group.right - np.einsum("kbij,obj->kobi", group.normal, value)
            score = np.einsum("pobi,kobi,ob->kp", slope[inside].conj(), own, weight, optimize=True).real
            K = score.shape[0]
            if K > 1:
                # Apart from what the trials have in common, which the scatter counts.
                moves.append((score - score.mean(axis=0)) @ covariance * np.sqrt(K / (K - 1)))
        if sum(map(len, moves)) < LEAST_TRIALS:
            return np.ones(int(inside.sum()))
        return np.asarray((np.concatenate(moves) ** 2).sum(axis=0) / np.diag(covariance))
