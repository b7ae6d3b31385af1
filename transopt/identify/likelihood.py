"""The likelihood of condensed records under a model, its maximum, and the covariance there.

The records themselves tell the noise of each line (`condensed`), so the negative logarithm of the likelihood is a sum
of squares of W (H(theta) - H_measured) over all bins, outputs and grips. Its minimum is found by bounded nonlinear
least squares with exact derivatives. Amplifiers, chains and hands are different models H.

The covariance is the inverse of the information, widened for two errors that the noise within a trial does not show:
the residual of the model (the scatter), and differences between trials (a hand is never held twice alike). For the
latter, each trial's own score tells how far that trial alone would move each unknown; where the sum of their squares
exceeds what the noise explains, it replaces the variance (the sandwich of White 1982, unknown by unknown).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from transopt.base.signals import BoolArray, ComplexArray, FloatArray, IndexArray
from transopt.identify.condensed import Condensed
from transopt.identify.squares import Squares, inverse

LEAST_TRIALS = 3  # trials, over all grips, from which on differences between them are evaluated

Model = Callable[[FloatArray, int, FloatArray], tuple[ComplexArray, ComplexArray]]
"""theta (p,), number of the group, frequencies (m,) -> responses (o, m) and derivatives (p, o, m)."""


@dataclass(frozen=True)
class Maximum:
    """The unknowns of maximum likelihood.

    Attributes
    ----------
    unknowns : (p,).
    covariance : (p, p); zero for a fixed unknown.
    chi_square : sum of squares of each output, an array (o,) per group; groups may differ in their outputs.
    points : number of real values in each sum of squares, in the same arrays.
    free : (p,) whether an unknown was sought.
    bounded : (p,) whether an unknown ended at a bound; its deviation is then a quarter of the range searched.
    between : (p,) observed variance between the trials over that explained by noise within them; 1 where not known.
    """

    unknowns: FloatArray
    covariance: FloatArray
    chi_square: tuple[FloatArray, ...]
    points: tuple[IndexArray, ...]
    free: BoolArray
    bounded: BoolArray
    between: FloatArray

    @property
    def scatter(self) -> float:
        """Mean square of the residuals: near 1 if the model is right."""
        return self.total / max(self.count - int(self.free.sum()), 1)

    @property
    def count(self) -> int:
        """Number of real values of all outputs of all groups."""
        return sum(int(points.sum()) for points in self.points)

    @property
    def total(self) -> float:
        """Sum of squares of all outputs of all groups."""
        return float(sum(squares.sum() for squares in self.chi_square))


class Likelihood(Squares):
    """The likelihood as a sum of squares over all groups.

    `loose` adds a relative error to every response, so that one sharp peak does not dominate a search; `step` > 1
    takes only every step-th bin.
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
    def points(self) -> tuple[IndexArray, ...]:
        """Number of real values that count for each output, an array (o,) per group."""
        return tuple(2 * (group.known[:, :, None] & group.used).sum(axis=(1, 2)) for group in self.groups)

    def _responses(self, unknowns: FloatArray, j: int) -> tuple[ComplexArray, ComplexArray]:
        """Responses (o, b, q) of group j and their derivatives (p, o, b, q)."""
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
        self, start: FloatArray, low: FloatArray, high: FloatArray, free: BoolArray, most: int = 200
    ) -> Maximum:
        """The best unknowns near `start`, with their covariance."""
        unknowns, _ = self.search(start, low, high, free, most=most)
        return self.maximum_at(unknowns, low, high, free)

    def maximum_at(self, unknowns: FloatArray, low: FloatArray, high: FloatArray, free: BoolArray) -> Maximum:
        """The `Maximum` at unknowns that a search has already found: their covariance and residuals."""
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
        found.covariance[bounded, bounded] = ((high - low)[bounded] / 4) ** 2  # 2 deviations to a side span the range
        return found

    def _between(self, unknowns: FloatArray, covariance: FloatArray, inside: BoolArray) -> FloatArray:
        """(free,) variance of each unknown by the trials' scores, over that from the noise within trials."""
        moves = []
        for j, group in enumerate(self.groups):
            value, slope = self._responses(unknowns, j)
            weight = 2 * group.known / group.noise
            own = group.right - np.einsum("kbij,obj->kobi", group.normal, value)
            score = np.einsum("pobi,kobi,ob->kp", slope[inside].conj(), own, weight, optimize=True).real
            K = score.shape[0]
            if K > 1:
                # The mean score, common to all trials, is subtracted: the scatter accounts for it.
                moves.append((score - score.mean(axis=0)) @ covariance * np.sqrt(K / (K - 1)))
        if sum(map(len, moves)) < LEAST_TRIALS:
            return np.ones(int(inside.sum()))
        return np.asarray((np.concatenate(moves) ** 2).sum(axis=0) / np.diag(covariance))
