"""The command whose worst device loses least, for a scene that asks for the worst of a spread and not for its mean.

The worst of the devices s loses max_s T_s(c), which is the largest of sum_s p_s T_s(c) over all shares p >= 0 of sum
one. Each T_s is convex in the command c, so least and largest may change places (Sion, Pacific J. Math. 8, 1958):

    min_c max_s T_s(c) = max_p g(p),   g(p) = min_c sum_s p_s T_s(c).

g(p) is an entry's ordinary problem, with these shares in the place of the mean, and concave; T(c(p)) is its gradient,
since c(p) is the only minimiser. A handful of devices bear all of p. Whatever shares the search ends with, g(p) less
its own gap is a lower bound of the least worst loss, so that the certificate of the answer needs nothing of the
search (`proof.certify`).
"""

from dataclasses import replace

import numpy as np
import scipy

from transopt.base.signals import FloatArray
from transopt.design.optimum import optimum
from transopt.problem.answer import OBJECTIVE_SCALE
from transopt.problem.problem import TransientProblem
from transopt.proof.designed import Designed
from transopt.solvers.choose import prove
from transopt.solvers.options import SolverOptions

MOST_STEPS = 200  # of the search; most need 5, a nearly flat one 70
ENOUGH = 1e-8  # of J, between worst and mean: a hundredth of what a certificate lets pass


class _Search:
    """The shares that were tried, and the answer whose worst device is nearest to the mean by them."""

    def __init__(self, problem: TransientProblem, options: SolverOptions) -> None:
        self._problem, self._options = problem, options
        self.spent_s, self._least = 0.0, np.inf
        self.best: Designed | None = None

    def at(self, shares: FloatArray) -> tuple[float, FloatArray]:
        """g and its gradient.

        Raises
        ------
        _UnprovenError : there is no proven optimum.
        _FoundError : these are the shares that were looked for.
        """
        shares = np.maximum(shares, 0.0)
        shares = shares / shares.sum()
        designed = optimum(replace(self._problem, worst=False, shares=shares), self._options)
        self._problem = self._problem.within(designed.problem.parts)
        self.spent_s += designed.solution.solve_time_s
        if not designed.is_proven:
            raise _UnprovenError(designed)
        problem, J = designed.problem, designed.certificate.objective
        accelerations = designed.effect.accelerations_m_s2
        above = problem.tracking.above_mean(accelerations)
        if above < self._least:
            self.best, self._least = designed, above
        if above <= ENOUGH * max(J, OBJECTIVE_SCALE):
            raise _FoundError
        return J, problem.tracking.losses(accelerations)

    @property
    def is_near(self) -> bool:
        """Whether worst and mean of the best answer are as near as a certificate needs them, with room to spare."""
        J = 0.0 if self.best is None else self.best.certificate.objective
        return self._least <= 10 * ENOUGH * max(J, OBJECTIVE_SCALE)


def _raise(search: _Search, start: FloatArray, scale: float) -> None:
    """Raise g over the shares, from `start` on; `scale` of g is one for the method."""

    def below(shares: FloatArray) -> tuple[float, FloatArray]:
        value, gradient = search.at(shares)
        return -value / scale, -gradient / scale

    scipy.optimize.minimize(
        below,
        start,
        jac=True,
        method="SLSQP",
        bounds=scipy.optimize.Bounds(0.0, 1.0),
        constraints=scipy.optimize.LinearConstraint(np.ones((1, start.size)), 1.0, 1.0),
        options={"ftol": 1e-14, "maxiter": MOST_STEPS},
    )


class _UnprovenError(Exception):
    """Carries an entry without a proven optimum."""

    def __init__(self, designed: Designed) -> None:
        super().__init__()
        self.designed = designed


class _FoundError(Exception):
    """The worst device loses no more than the mean by the shares."""


def least_worst(problem: TransientProblem, options: SolverOptions) -> Designed:
    """Solve one entry for the worst of its devices.

    Parameters
    ----------
    problem : with `worst`; its shares, if it has any, are where the search begins.

    Returns
    -------
    With the shares that were found in its problem. Where no optimum is proven, the entry that has none.
    """
    if problem.reference_is_zero:
        return optimum(problem, options)
    search, start = _Search(problem, options), problem.shared
    try:
        # Scaled by the differences of the losses the first step is a long one, and a third of the solves do. Scaled
        # by J it is so short, where the devices lose nearly alike, that its gain is lost in the rounding of J.
        J, losses = search.at(start)
        for scale in (max(float(np.ptp(losses)), np.finfo(float).tiny), max(J, OBJECTIVE_SCALE)):
            _raise(search, start, scale)
            if search.is_near:
                break
    except _UnprovenError as found:
        return replace(found.designed, problem=replace(found.designed.problem, worst=True))
    except _FoundError:
        pass
    designed = search.best
    assert designed is not None
    worst, answer = replace(designed.problem, worst=True), replace(designed.solution, solve_time_s=search.spent_s)
    effect = designed.effect.of(worst)
    return replace(
        designed,
        problem=worst,
        solution=answer,
        certificate=prove(worst, answer.command, answer.multipliers, options, effect=effect),
        effect=effect,
    )
