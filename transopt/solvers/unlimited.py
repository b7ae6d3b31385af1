"""The problem without its limits: one Riccati pass (DESIGN 2, the floor; DESIGN 4, leaving out).

The hand-over stays, because a waveform that does not end is no transient. Where the answer lies inside all
limits it is the answer to the limited problem too, with every multiplier zero.
"""

import time
from dataclasses import dataclass, replace

import numpy as np

from transopt import transcribe
from transopt.problem import OBJECTIVE_SCALE, Multipliers, Solution, Status, TransientProblem
from transopt.signals import FloatArray
from transopt.solvers import sparse_kkt
from transopt.solvers.riccati_lq import Pass, Point, Tracking

GAP = 1e-8  # of max(J, 1e-3): a hundredth of what a certificate may have, a hundred times what rounding leaves
REFINEMENTS = 2


def tracking(problem: TransientProblem) -> Tracking:
    """The problem's data without the limits; command in units of the limit current, states in SI.

    J is in units of 1: outputs and reference by |r|.
    """
    unit = problem.limits.current_A
    scale = transcribe.Scaling(np.ones(problem.stage.A.shape[0]), unit)
    A, B, C = transcribe.stage_matrices(problem, scale)
    h, r = problem.hand_over_samples, problem.reference_m_s2
    rule = np.zeros((h, B.size))
    rule[:, -1] = -1.0  # c_k = 0, so dc_k = -c_(k-1)
    return Tracking(
        A=A,
        B=B,
        C=C,
        # What the held command does to an output, the command issued now does too.
        D=C[:, -1].copy(),
        reference=(r / np.linalg.norm(r))[:, None],
        weights=problem.tracking_weights[:, None],
        movement_weights=np.full(r.size, problem.movement_weight * unit**2),
        rule_gains=rule,
        rule_offsets=np.zeros(h),
    )


@dataclass(frozen=True)
class _Candidate:
    """A point, its command (N,) and its distance from the optimum, bounded as in the certificate.

    The gap is relative to max(J, 1e-3), and inf if any number is not finite.
    """

    point: Point
    command_A: FloatArray
    gap: float
    method: str


def _judged(problem: TransientProblem, run: Pass, point: Point, method: str) -> _Candidate:
    unit, free, data = problem.limits.current_A, problem.free_stages, run.problem
    command = np.cumsum(point.movement) * unit
    command[free:] = 0.0
    by_command = 2 * np.diff(run.gradient(point), append=0.0) / unit
    gap = float(np.abs(by_command) @ (problem.limits.command_bound_A + np.abs(command[:free])))
    objective = float(np.sum(data.weights * point.error**2) + data.movement_weights @ point.movement**2)
    relative = gap / max(objective, OBJECTIVE_SCALE)
    return _Candidate(point, command, relative if np.isfinite(relative) else np.inf, method)


def _by_riccati_pass(problem: TransientProblem, run: Pass) -> _Candidate:
    """The pass, repeated as iterative refinement while its gap is too large and falls."""
    gains, point = run.factored(), run.at_rest()
    best = _judged(problem, run, run.improved(point, gains), "Riccati pass")
    for _ in range(REFINEMENTS):
        if best.gap <= GAP or best.gap == np.inf:
            break
        again = _judged(problem, run, run.improved(best.point, gains), "Riccati pass, refined")
        if again.gap >= best.gap:
            break
        best = again
    return best


def _by_sparse_kkt(problem: TransientProblem, run: Pass) -> _Candidate:
    """The pivoting method, its movement judged by the same recursions."""
    movement = sparse_kkt.movement(problem)[: problem.free_stages]
    return _judged(problem, run, run.at(movement), "sparse KKT system")


def _solution(problem: TransientProblem, run: Pass, found: _Candidate, start_s: float) -> Solution:
    hand_over = -2 * run.gradient_under_rule(found.point) / problem.limits.current_A
    return Solution(
        status=Status.OPTIMAL if np.isfinite(found.gap) else Status.NUMERICAL_FAILURE,
        command_A=found.command_A,
        multipliers=replace(Multipliers.zero(problem), hand_over=hand_over),
        solver="unlimited",
        message=found.method,
        iterations=1,
        solve_time_s=time.perf_counter() - start_s,
    )


def solve(problem: TransientProblem) -> Solution:
    """Minimise J subject to dynamics and hand-over only; see `Solution`.

    `command_A` is not clipped: it is what the limits would have to allow. Where rounding leaves the Riccati pass a
    gap above `GAP`, the sparse KKT system is solved too, and the better answer is returned.
    """
    start = time.perf_counter()
    with np.errstate(over="ignore", invalid="ignore"):  # a breakdown shows in the gap
        run = Pass(tracking(problem))
        found = _by_riccati_pass(problem, run)
        if not found.gap <= GAP:
            found = min(found, _by_sparse_kkt(problem, run), key=lambda candidate: candidate.gap)
        return _solution(problem, run, found, start)


def solve_sparse_kkt(problem: TransientProblem) -> Solution:
    """The same problem by the second method alone, for comparison."""
    start = time.perf_counter()
    with np.errstate(over="ignore", invalid="ignore"):
        run = Pass(tracking(problem))
        return _solution(problem, run, _by_sparse_kkt(problem, run), start)
