"""The problem without its limits: one Riccati pass.

The hand-over is kept, because a transient has to end. If the answer is inside all limits, it is also the optimum of
the limited problem, with all multipliers zero.
"""

import time
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from transopt.base import apart
from transopt.problem.answer import OBJECTIVE_SCALE, Certificate, Multipliers, Solution, Status
from transopt.problem.problem import TransientProblem
from transopt.problem.stage import layout
from transopt.proof.certify import certify, movement_bound, reduced_gradient
from transopt.proof.effect import Effect
from transopt.solvers import stage_data
from transopt.solvers.native import extension

MOST_S, MOST_PER_STAGE_S = 1.0, 1e-3  # processor time of the sparse system, which takes a fifth of it
GAP = 1e-8  # gap relative to max(J, 1e-3): a hundredth of a certificate's tolerance, a hundred times the rounding


def solve(problems: Sequence[TransientProblem], *, brief: bool = False) -> list[Solution]:
    """Minimise J of each problem subject to dynamics and hand-over only.

    `Solution.command` is not clipped: it shows what the limits would have to allow. The compiled pass solves all
    problems side by side. Where it is not available, or leaves a gap above `GAP` by both bounds of the certificate,
    the sparse KKT system is solved. If that fails too, the pass's answer is used, provided that a certificate would
    accept its gap.

    Parameters
    ----------
    brief : whether the sparse system, which takes a process of its own, is left out where there is the compiled pass.
    """
    with np.errstate(over="ignore", invalid="ignore"):
        found = _by_compiled_pass(problems)
    without = brief and extension.available
    return [_accepted(problem, own, without=without) for problem, own in zip(problems, found, strict=True)]


def _accepted(problem: TransientProblem, own: Solution | None, *, without: bool) -> Solution:
    """The compiled pass's answer if it is optimal; otherwise that of the other method, if that one is optimal.

    Parameters
    ----------
    without : whether there is to be no other method.
    """
    if own is not None and own.status is Status.OPTIMAL:
        return own
    other = _none(problem, "the compiled pass broke down", 0.0) if without else solve_apart(problem)
    return other if own is None or other.status is Status.OPTIMAL else replace(own, status=Status.OPTIMAL)


def _by_sparse_system(problem: TransientProblem) -> Solution:
    # Imported here: only problems that the compiled pass does not solve need CasADi.
    from transopt.solvers import sparse_kkt

    return sparse_kkt.solve(problem)


def _by_compiled_pass(problems: Sequence[TransientProblem]) -> list[Solution | None]:
    """Answers of the compiled pass: OPTIMAL if the gap is at most `GAP` by either bound of the certificate.

    A larger gap that a certificate still accepts is marked `ITERATION_LIMIT`. The answer is None without the
    extension, with a still larger gap, or where the pass breaks down.
    """
    start = time.perf_counter()
    if not extension.available:
        return [None] * len(problems)
    found: list[Solution | None] = [None] * len(problems)
    taken = [i for i, each in enumerate(map(layout, problems)) if extension.takes(each.states, each.motors, 0)]
    given = stage_data.without_limits_of([problems[i] for i in taken])
    answers = extension.linear_passes(given, GAP)
    spent = (time.perf_counter() - start) / max(len(taken), 1)
    for i, stages, answer in zip(taken, given, answers, strict=True):
        if answer.code not in (extension.SOLVED, extension.ACCURACY):
            continue
        problem, command = problems[i], stages.free_command(answer.command)
        multipliers = Multipliers.zero(problem, stages.hand_over(answer.gradient))
        gap = answer.relative_gap
        if not gap <= GAP:
            left = movement_bound(problem, reduced_gradient(Effect(problem, command), multipliers))
            gap = np.fmin(gap, left / OBJECTIVE_SCALE)
        if gap <= Certificate.GAP_TOLERANCE:
            status = Status.OPTIMAL if gap <= GAP else Status.ITERATION_LIMIT
            told = ("unlimited", "Riccati pass", answer.iterations, spent)
            found[i] = Solution(status, command, multipliers, *told)
    return found


def solve_apart(problem: TransientProblem) -> Solution:
    """Run `solve_sparse` in a process of its own: factorising an ill-posed system may print text or take long.

    A process that gives no answer within `MOST_S` and `MOST_PER_STAGE_S` of processor time is ended.
    """
    within_s = MOST_S + MOST_PER_STAGE_S * problem.grid.stages
    try:
        return apart.call(solve_sparse, problem, within_s=within_s)
    except apart.UnansweredError as why:
        return _none(problem, str(why), within_s)


def _none(problem: TransientProblem, why: str, spent_s: float) -> Solution:
    """No optimum: rest, and the reason."""
    none = Multipliers.zero(problem)
    return Solution(Status.NUMERICAL_FAILURE, problem.rest, none, "unlimited", why, 0, spent_s)


def solve_sparse(problem: TransientProblem) -> Solution:
    """Solve without the extension; an answer that overflows is rejected by the certificate."""
    # If J does not depend on the command at all, rest is optimal, and the KKT matrix would be singular.
    rest = problem.rest
    with np.errstate(over="ignore", invalid="ignore"):
        if problem.wall is None and certify(problem, rest, Multipliers.zero(problem)).is_stationary:
            return Solution(Status.OPTIMAL, rest, Multipliers.zero(problem), "unlimited", "rest", 0, 0.0)
        return _by_sparse_system(problem)
