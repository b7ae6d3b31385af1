"""The problem without its limits: one Riccati pass.

The hand-over stays, because a waveform that does not end is no transient. Where the answer lies inside all
limits it is the answer to the limited problem too, with every multiplier zero.
"""

import time
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from transopt.base import apart
from transopt.problem.answer import OBJECTIVE_SCALE, Certificate, Multipliers, Solution, Status
from transopt.problem.problem import TransientProblem
from transopt.problem.stage import layout
from transopt.proof.certify import Effect, certify, movement_bound, reduced_gradient
from transopt.solvers import several, stage_data
from transopt.solvers.native import extension
from transopt.solvers.options import most_time_s

GAP = 1e-8  # of max(J, 1e-3): a hundredth of what a certificate may have, a hundred times what rounding leaves


def solve(problems: Sequence[TransientProblem]) -> list[Solution]:
    """Minimise J subject to dynamics and hand-over only, of each problem; see `Solution`.

    `command` is not clipped: it is what the limits would have to allow. The compiled pass takes all problems side by
    side. Where there is none, or it leaves a gap above `GAP` by both bounds of the certificate, the sparse KKT system
    is solved; the pass's answer serves where that system gives none, if a certificate would accept its gap.
    """
    with np.errstate(over="ignore", invalid="ignore"):
        found = _by_compiled_pass(problems)
    return [_accepted(problem, own) for problem, own in zip(problems, found, strict=True)]


def _accepted(problem: TransientProblem, own: Solution | None) -> Solution:
    """The compiled pass's answer, or that of the other method where the pass has no optimum."""
    if own is not None and own.status is Status.OPTIMAL:
        return own
    other = _beside(problem)
    return other if own is None or other.status is Status.OPTIMAL else replace(own, status=Status.OPTIMAL)


def _beside(problem: TransientProblem) -> Solution:
    """Answer to a problem that the compiled pass of one motor does not take, or not far enough."""
    if problem.stage.motors == 1:
        return solve_apart(problem)
    return several.unlimited(problem) or _by_sparse_system(problem)


def _by_sparse_system(problem: TransientProblem) -> Solution:
    # Only a problem that the compiled pass does not solve needs CasADi.
    from transopt.solvers import sparse_kkt

    return sparse_kkt.solve(problem)


def _by_compiled_pass(problems: Sequence[TransientProblem]) -> list[Solution | None]:
    """Answers of the extension's pass: OPTIMAL with a gap up to `GAP` by either bound of the certificate.

    A larger gap, up to what a certificate accepts, is marked `ITERATION_LIMIT`. There is no answer without the
    extension, with a still larger gap, and where the pass breaks down.
    """
    start = time.perf_counter()
    if not extension.available:
        return [None] * len(problems)
    found: list[Solution | None] = [None] * len(problems)
    layouts = [layout(problem) for problem in problems]
    taken = [i for i, each in enumerate(layouts) if each.motors == 1 and each.states <= extension.MOST_STATES]
    given = [stage_data.without_limits(problems[i]) for i in taken]
    answers = extension.linear_passes(given, GAP)
    spent = (time.perf_counter() - start) / max(len(taken), 1)
    for i, stages, answer in zip(taken, given, answers, strict=True):
        if answer.code not in (extension.SOLVED, extension.ACCURACY):
            continue
        problem, command = problems[i], stages.free_command(answer.command)
        multipliers = replace(Multipliers.zero(problem), hand_over=stages.hand_over(answer.gradient))
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
    """`solve_sparse` in a process of its own: the factorisation of a broken system prints, or takes long."""
    within_s = most_time_s(problem.grid.stages)
    try:
        return apart.call(solve_sparse, problem, within_s=within_s)
    except apart.UnansweredError as why:
        nothing, none = np.zeros(problem.grid.stages), Multipliers.zero(problem)
        return Solution(Status.NUMERICAL_FAILURE, nothing, none, "unlimited", str(why), 0, within_s)


def solve_sparse(problem: TransientProblem) -> Solution:
    """Solve without the extension; what overflows is no answer, as the certificate says."""
    # If nothing is asked of the command, none is as good as any, and no matrix of it can be factorised.
    rest = problem.rest
    with np.errstate(over="ignore", invalid="ignore"):
        if problem.wall is None and certify(problem, rest, Multipliers.zero(problem)).is_stationary:
            return Solution(Status.OPTIMAL, rest, Multipliers.zero(problem), "unlimited", "rest", 0, 0.0)
        return _by_sparse_system(problem)
