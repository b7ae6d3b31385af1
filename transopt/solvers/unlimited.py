"""The problem without its limits: one Riccati pass, or one sparse system.

The hand-over stays, because a waveform that does not end is no transient. If the answer lies inside all limits, it
is the answer to the limited problem too, with every multiplier zero.
"""

import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy
from numpy.typing import NDArray

from transopt.base import apart
from transopt.base.signals import FloatArray
from transopt.problem.answer import OBJECTIVE_SCALE, Multipliers, Solution, Status
from transopt.problem.problem import TransientProblem
from transopt.problem.stage import layout, linear_stage
from transopt.proof.certify import Effect, hand_over_multipliers, movement_bound, reduced_gradient
from transopt.solvers import stage_data
from transopt.solvers.native import extension
from transopt.solvers.options import most_time_s
from transopt.solvers.program import pattern, state_program
from transopt.solvers.statement import state

GAP = 1e-8  # of max(J, 1e-3): a hundredth of what a certificate may have, a hundred times what rounding leaves
REFINEMENTS = 10
# Relative to the largest curvature. Zero comes first: the others only serve a system that is singular to rounding.
DAMPINGS = (0.0, 1e-15, 1e-12, 1e-9, 1e-6)


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


@dataclass(frozen=True)
class _Candidate:
    """A command (N,) with the hand-over's multipliers, and its gap relative to max(J, 1e-3), inf if not finite."""

    command: FloatArray
    multipliers: Multipliers
    gap: float
    method: str


def _judged(problem: TransientProblem, command: FloatArray, method: str) -> _Candidate:
    """Judge a command by the smaller of the certificate's two bounds on what the reduced gradient leaves."""
    if problem.target.is_zero:
        return _Candidate(command, Multipliers.zero(problem), np.inf if command.any() else 0.0, method)
    effect = Effect(problem, command)
    multipliers = hand_over_multipliers(effect)
    left = reduced_gradient(effect, multipliers)
    gap = float(np.abs(left) @ (problem.command_bound + np.abs(command)))
    if gap > GAP * OBJECTIVE_SCALE:
        gap = float(np.fmin(gap, movement_bound(problem, left)))
    relative = gap / max(problem.objective(command, effect.accelerations_m_s2), OBJECTIVE_SCALE)
    return _Candidate(command, multipliers, relative if np.isfinite(relative) else np.inf, method)


class _SparseSystem:
    """The optimality conditions as one sparse KKT system, which is factorised with pivoting."""

    def __init__(self, problem: TransientProblem) -> None:
        # A row that is no box on one variable would stand among the equations.
        sums = {row.name for row in stage_data.stated_rows(problem, linear_stage(problem)) if not row.single}
        no_boxes = [limit.name for limit in problem.limits if sums & set(limit.row_names)]
        statement = state(problem.without(*no_boxes))
        self.problem, self.shape = problem, statement.shape
        data = state_program(self.shape).qp_data(p=statement.p)
        H, A = (
            scipy.sparse.csc_array(
                (np.asarray(data[name].nonzeros()), *pattern(self.shape, name)), shape=data[name].shape
            )
            for name in ("H", "A")
        )
        self.matrix = scipy.sparse.block_array([[H, A.T], [A, None]], format="csc")
        self.right = np.concatenate([-np.asarray(data["q"]).ravel(), statement.lower_g])
        self.curvature = float(np.abs(H.data).max(initial=0.0))

    @cached_property
    def movements(self) -> NDArray[np.intp]:
        """(N,) positions of the command's movements among the unknowns."""
        return np.arange(self.shape.stages) * self.shape.variables

    def commands(self, damping: float) -> Iterator[FloatArray]:
        """Commands (N,), each refined from the one before; none if the damped system is singular.

        Damping is added to every movement's curvature, but the residual stays that of the undamped system. A
        refinement is then one step of the proximal point method, whose fixed point is an undamped optimum.
        """
        diagonal = np.zeros(self.right.size)
        diagonal[self.movements] = damping * self.curvature
        try:
            factors = scipy.sparse.linalg.splu(self.matrix + scipy.sparse.diags_array(diagonal, format="csc"))
        except RuntimeError:
            return
        point = factors.solve(self.right)
        for _ in range(1 + REFINEMENTS):
            command = np.cumsum(point[self.movements]) * self.problem.input_scale
            if self.problem.wall is None:
                command[self.problem.free_stages :] = 0.0
            yield command
            point = point + factors.solve(self.right - self.matrix @ point)


def _by_sparse_kkt(problem: TransientProblem) -> _Candidate:
    """The best command of the sparse system, damped only where its gap is too large without damping."""
    nothing = np.full(problem.grid.stages, np.nan)
    best = _Candidate(nothing, Multipliers.zero(problem), np.inf, "sparse KKT system")
    system = _SparseSystem(problem)
    for damping in DAMPINGS:
        last = np.inf
        for command in system.commands(damping):
            found = _judged(problem, command, "sparse KKT system, damped" if damping else "sparse KKT system")
            if not found.gap < last:
                break
            last, best = found.gap, min(best, found, key=lambda candidate: candidate.gap)
            if best.gap <= GAP:
                return best
    return best


def solve(problem: TransientProblem) -> Solution:
    """Minimise J subject to dynamics and hand-over only; see `Solution`.

    `command` is not clipped: it is what the limits would have to allow. The compiled pass comes first. The sparse KKT
    system is solved where there is none, or where it leaves a gap above `GAP` by both bounds of the certificate.
    """
    with np.errstate(over="ignore", invalid="ignore"):
        found = _by_compiled_pass(problem, time.perf_counter())
    return solve_apart(problem) if found is None else found


def solve_apart(problem: TransientProblem) -> Solution:
    """`solve_sparse_kkt` in a process of its own: the factorisation of a broken system prints, or takes long."""
    within_s = most_time_s(problem.grid.stages)
    try:
        return apart.call(solve_sparse_kkt, problem, within_s=within_s)
    except apart.UnansweredError as why:
        nothing, none = np.zeros(problem.grid.stages), Multipliers.zero(problem)
        return Solution(Status.NUMERICAL_FAILURE, nothing, none, "unlimited", str(why), 0, within_s)


def solve_sparse_kkt(problem: TransientProblem) -> Solution:
    """Solve without the extension."""
    start, linear = time.perf_counter(), problem.without(*problem.nonlinear)
    with np.errstate(over="ignore", invalid="ignore"):  # a breakdown shows in the gap
        # If nothing is asked of the command, none is as good as any, and the system is singular.
        found = _judged(linear, np.zeros(problem.grid.stages), "rest")
        if not found.gap <= GAP:
            found = _by_sparse_kkt(linear)
    return Solution(
        status=Status.OPTIMAL if np.isfinite(found.gap) else Status.NUMERICAL_FAILURE,
        command=found.command,
        multipliers=found.multipliers,
        solver="unlimited",
        message=found.method,
        iterations=1,
        solve_time_s=time.perf_counter() - start,
    )
