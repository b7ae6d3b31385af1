"""The problem without its limits: one Riccati pass.

The hand-over stays, because a waveform that does not end is no transient. Where the answer lies inside all
limits it is the answer to the limited problem too, with every multiplier zero.
"""

import time
from dataclasses import dataclass, replace

import numpy as np

from transopt.base import apart
from transopt.base.signals import FloatArray
from transopt.problem.answer import OBJECTIVE_SCALE, Multipliers, Solution, Status
from transopt.problem.limits import hand_over
from transopt.problem.problem import TransientProblem
from transopt.problem.stage import layout, linear_stage
from transopt.proof.certify import Effect, movement_bound, reduced_gradient
from transopt.solvers import several, sparse_kkt, stage_data
from transopt.solvers.lq_pass import Pass, Point, Tracking, prepare
from transopt.solvers.native import extension
from transopt.solvers.options import most_time_s

GAP = 1e-8  # of max(J, 1e-3): a hundredth of what a certificate may have, a hundred times what rounding leaves
REFINEMENTS = 4
DAMPINGS = (1e-12, 1e-9, 1e-6, 1e-3, 1.0)
DAMPED_PASSES = 30


def tracking(problem: TransientProblem) -> Tracking:
    """The problem's data without the limits; command in units of `input_scale`, states in SI.

    J is in units of 1: outputs and reference by sqrt(E).
    """
    stage = linear_stage(problem, physical_scale=False)
    rows, constants = hand_over.rows(problem, stage)
    rows[:, -1] -= 1.0  # c_k = rows x_k + constant, so dc_k = that less c_(k-1)
    values = stage_data.tracking_values(problem, stage)
    weights = values["w"]
    return Tracking(
        A=stage.A,
        B=stage.A[:, -1].copy(),
        C=stage.C,
        D=stage.E[:, 0],
        reference=values["r"],
        weights=weights,
        movement_weights=np.full(weights.shape[0], values["rho"][0]),
        rule_gains=rows,
        rule_offsets=constants,
        end_gain=values["end_gain"],
        end_target=values["end_target"],
    )


@dataclass(frozen=True)
class _Candidate:
    """A point, its command (N,) and its distance from the optimum, bounded as in the certificate.

    The gap is relative to max(J, 1e-3), and inf if any number is not finite.
    """

    point: Point
    command: FloatArray
    gap: float
    method: str


def _judged(problem: TransientProblem, run: Pass, point: Point, method: str) -> _Candidate:
    unit, free, data = problem.input_scale, problem.free_stages, run.problem
    command = np.cumsum(point.movement) * unit
    if problem.wall is None:
        command[free:] = 0.0
    by_command = 2 * np.diff(run.gradient(point), append=0.0) / unit
    gap = float(np.abs(by_command) @ (problem.command_bound + np.abs(command[:free])))
    objective = float(np.sum(data.weights * point.error**2) + data.movement_weights @ point.movement**2)
    objective += float(point.end_error @ point.end_error)
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


def _by_damped_passes(problem: TransientProblem, run: Pass, best: _Candidate) -> _Candidate:
    """The proximal point method: where weights of zero leave commands open, and where rounding eats the curvature.

    Damping is stated relative to what the first movement alone can do to the objective and, where that is so little
    that nothing finite comes of it, relative to the objective of rest, which is of order one.
    """
    data = run.problem
    impulse = run.at(np.eye(1, max(problem.free_stages, 1))[0, : problem.free_stages])
    rest = run.at_rest()
    effect = float(np.sum(data.weights * (impulse.error - rest.error) ** 2) + data.movement_weights.sum())
    effect += float(np.sum((impulse.end_error - rest.end_error) ** 2))
    for scale in (effect if 0 < effect < np.inf else 1.0, 1.0):
        for damping in DAMPINGS:
            best = min(best, _damped(problem, run, damping * scale), key=lambda candidate: candidate.gap)
            if best.gap <= GAP:
                break
        if best.gap < np.inf:
            break
    return best


def _damped(problem: TransientProblem, run: Pass, damping: float) -> _Candidate:
    """Passes of one damping from rest, until the gap is small enough or falls no more."""
    gains = run.factored(damping)
    found = _judged(problem, run, run.improved(run.at_rest(), gains), "damped Riccati passes")
    for _ in range(DAMPED_PASSES):
        again = _judged(problem, run, run.improved(found.point, gains), "damped Riccati passes")
        if found.gap <= GAP or not again.gap < found.gap:
            break
        found = again
    return found


def _by_sparse_kkt(problem: TransientProblem, run: Pass) -> _Candidate:
    """The pivoting method, its movement judged by the same recursions."""
    movement = sparse_kkt.movement(problem)[: problem.free_stages]
    return _judged(problem, run, run.at(movement), "sparse KKT system")


def _solution(problem: TransientProblem, run: Pass, found: _Candidate, start_s: float) -> Solution:
    hand_over = -2 * run.gradient_under_rule(found.point) / problem.input_scale
    return Solution(
        status=Status.OPTIMAL if np.isfinite(found.gap) else Status.NUMERICAL_FAILURE,
        command=found.command,
        multipliers=replace(Multipliers.zero(problem), hand_over=hand_over),
        solver="unlimited",
        message=found.method,
        iterations=1,
        solve_time_s=time.perf_counter() - start_s,
    )


def _by_compiled_pass(problem: TransientProblem, start_s: float) -> Solution | None:
    """The pass of the extension, if it is there and its gap is small by either bound."""
    if not extension.available or layout(problem).states > extension.MOST_STATES:
        return None
    given = stage_data.without_limits(problem)
    run = extension.LinearPass(given, extension.buffers_of(given.sizes))
    answer = run.solve(GAP)
    if answer.code not in (extension.SOLVED, extension.ACCURACY):
        return None
    command = run.command()
    multipliers = replace(Multipliers.zero(problem), hand_over=run.hand_over())
    if not answer.relative_gap <= GAP:
        left = movement_bound(problem, reduced_gradient(Effect(problem, command), multipliers))
        if not left <= GAP * OBJECTIVE_SCALE:
            return None
    return Solution(
        status=Status.OPTIMAL,
        command=command,
        multipliers=multipliers,
        solver="unlimited",
        message="Riccati pass",
        iterations=answer.iterations,
        solve_time_s=time.perf_counter() - start_s,
    )


def solve(problem: TransientProblem) -> Solution:
    """Minimise J subject to dynamics and hand-over only; see `Solution`.

    `command` is not clipped: it is what the limits would have to allow. The compiled pass comes first. Where there
    is none, or it leaves a gap above `GAP` by both bounds of the certificate, the pass runs in CasADi's virtual
    machine; where that leaves one too, the sparse KKT system is solved as well, and the better answer is returned.
    """
    if problem.stage.motors > 1:
        return several.unlimited(problem)
    with np.errstate(over="ignore", invalid="ignore"):
        found = _by_compiled_pass(problem, time.perf_counter())
    return solve_apart(problem) if found is None else found


def solve_apart(problem: TransientProblem) -> Solution:
    """`solve_in_casadi` in a process of its own: the factorisation of a broken system prints, or takes long."""
    within_s = most_time_s(problem.grid.stages)
    try:
        return apart.call(solve_in_casadi, problem, within_s=within_s)
    except apart.UnansweredError as why:
        nothing, none = np.zeros(problem.grid.stages), Multipliers.zero(problem)
        return Solution(Status.NUMERICAL_FAILURE, nothing, none, "unlimited", str(why), 0, within_s)


def solve_in_casadi(problem: TransientProblem) -> Solution:
    """Solve without the extension."""
    prepare(layout(problem).states, layout(problem).outputs, problem.free_stages)
    start = time.perf_counter()
    with np.errstate(over="ignore", invalid="ignore"):  # a breakdown shows in the gap
        run = Pass(tracking(problem))
        # If nothing is asked of the command, none is as good as any, and no matrix of it can be factorised.
        found = _judged(problem, run, run.at_rest(), "rest")
        if not found.gap <= GAP:
            found = _by_riccati_pass(problem, run)
        if not found.gap <= GAP:
            found = min(found, _by_sparse_kkt(problem, run), key=lambda candidate: candidate.gap)
        if not found.gap <= GAP:
            found = _by_damped_passes(problem, run, found)
        return _solution(problem, run, found, start)


def solve_sparse_kkt(problem: TransientProblem) -> Solution:
    """Solve by the second method alone, for comparison."""
    start = time.perf_counter()
    with np.errstate(over="ignore", invalid="ignore"):
        run = Pass(tracking(problem))
        return _solution(problem, run, _by_sparse_kkt(problem, run), start)
