"""The minimax design over a spread of devices: the command that minimises the largest loss.

The largest loss over the devices s, max_s T_s(c), equals the maximum of sum_s p_s T_s(c) over all shares p >= 0 with
sum one. Each T_s is convex in the command c, so minimum and maximum may be exchanged (Sion, Pacific J. Math. 8,
1958):

    min_c max_s T_s(c) = max_p g(p),   g(p) = min_c sum_s p_s T_s(c).

Evaluating g(p) is an entry's ordinary problem with the shares p in place of equal weights. g is concave with gradient
T(c(p)), since the minimiser c(p) is unique. Only a handful of devices have a positive share at the maximum. For
whatever shares the search ends with, g(p) less its own gap is a dual bound of the minimax loss, so that the answer's
certificate does not depend on the search (`proof.certify`).
"""

from dataclasses import replace

import numpy as np
import scipy

from transopt.base.signals import FloatArray
from transopt.design.optimum import optimum
from transopt.problem.answer import OBJECTIVE_SCALE
from transopt.problem.problem import TransientProblem
from transopt.proof.designed import Designed
from transopt.proof.effect import free_optima
from transopt.solvers.choose import prove
from transopt.solvers.options import SolverOptions

MOST_STEPS = 200  # iterations of the search; most take 5, a nearly flat g takes 70
ENOUGH = 1e-8  # difference of worst and weighted mean, relative to J: a hundredth of a certificate's tolerance
LEAST_SHARE = 1e-12  # what is smaller changes J by less than rounding


class _Search:
    """Evaluation of g, and the best answer so far: that whose largest loss is nearest to its weighted mean."""

    def __init__(self, problem: TransientProblem, options: SolverOptions) -> None:
        self._problem, self._options = problem, options
        self.spent_s, self._least = 0.0, np.inf
        self.best: Designed | None = None

    def at(self, shares: FloatArray) -> tuple[float, FloatArray]:
        """g and its gradient at some shares.

        Raises
        ------
        _UnprovenError : the optimum for these shares is not proven.
        _FoundError : these shares are optimal to within `ENOUGH`; the exception ends the search.
        """
        shares = np.where(shares < LEAST_SHARE, 0.0, shares)
        mean = replace(self._problem, worst=False, shares=shares / shares.sum())
        designed = optimum(_of_those_that_count(mean), self._options)
        whole = mean.within(designed.problem.parts)
        designed = replace(designed, problem=whole, effect=designed.effect.of(whole))
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
        """Whether the best answer's largest loss and weighted mean agree well within a certificate's tolerance."""
        J = 0.0 if self.best is None else self.best.certificate.objective
        return self._least <= 10 * ENOUGH * max(J, OBJECTIVE_SCALE)


def _of_those_that_count(problem: TransientProblem) -> TransientProblem:
    """The problem without devices of the spread that have no share in J, if no limit refers to their motion."""
    shares = problem.shared
    if any(row.device for _, row in problem.rows()) or shares[1:].all():
        return problem
    spread = tuple(device for device, share in zip(problem.spread, shares[1:], strict=True) if share > 0)
    return replace(problem, spread=spread, shares=np.append(shares[0], shares[1:][shares[1:] > 0]))


def _raise(search: _Search, start: FloatArray, scale: float) -> None:
    """Maximise g over the shares, starting from `start`; g is divided by `scale` for the method."""

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
    """Ends the search with an answer that is not proven optimal, which it carries."""

    def __init__(self, designed: Designed) -> None:
        super().__init__()
        self.designed = designed


class _FoundError(Exception):
    """Ends the search: the largest loss is no larger than the mean weighted by the shares."""


def least_worst(problem: TransientProblem, options: SolverOptions) -> Designed:
    """Solve one entry for the worst of its devices.

    Parameters
    ----------
    problem : a problem with `worst` set; the search starts from its shares, if it has any.

    Returns
    -------
    The minimax answer; its problem has the shares that were found. If an optimum on the way is not proven, that
    unproven answer.
    """
    if problem.reference_is_zero:
        return optimum(problem, options)
    search, start = _Search(problem, options), problem.shared
    try:
        # Scaling g by the differences of the losses makes the first step long and takes a third of the solves.
        # Scaling by J would make it so short, where all losses are nearly equal, that its gain is lost in the
        # rounding of J.
        J, losses = search.at(start)
        for scale in (max(float(np.ptp(losses)), np.finfo(float).tiny), max(J, OBJECTIVE_SCALE)):
            _raise(search, start, scale)
            if search.is_near:
                break
    except _UnprovenError as found:
        return _of_the_worst(found.designed)
    except _FoundError:
        pass
    assert search.best is not None
    designed = _of_the_worst(search.best)
    answer, effect = replace(designed.solution, solve_time_s=search.spent_s), designed.effect.of(designed.problem)
    proof = prove(designed.problem, answer.command, answer.multipliers, options, effect=effect)
    return replace(designed, solution=answer, certificate=proof, effect=effect)


def _of_the_worst(designed: Designed) -> Designed:
    """An answer to the weighted mean, in the problem of the worst device; its certificate stays that of the mean."""
    worst = replace(designed.problem, worst=True)
    ((_, free),) = free_optima([(worst, designed.unlimited_command)])
    return replace(designed, problem=worst, unlimited_objective=free.objective)
