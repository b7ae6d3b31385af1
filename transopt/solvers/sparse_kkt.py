"""The problem without its limits as one sparse KKT system: slower than the Riccati pass, but solved with pivoting."""

import time
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from transopt.base.signals import FloatArray
from transopt.problem.answer import Certificate, Multipliers, Solution, Status
from transopt.problem.problem import TransientProblem
from transopt.problem.stage import linear_stage
from transopt.proof.certify import certify
from transopt.solvers.program import state_program
from transopt.solvers.shape import Shape
from transopt.solvers.stated_rows import stated_rows
from transopt.solvers.statement import state

REFINEMENTS = 2
# Gap relative to max(J, 1e-3), a tenth of the tolerated one, below which an answer needs no (further) damping.
GAP = 1e-7
# Damping on each movement, relative to the largest weight. If the system is singular, some movements of the command
# do not change J, and damping selects one of the equivalent optima.
DAMPINGS = (0.0, 1e-12, 1e-9, 1e-6, 1e-3)
DAMPED_STEPS = 30


@lru_cache(maxsize=16)
def pattern(shape: Shape, name: str) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Row indices and column starts of a matrix of the program; cached, since CasADi takes longer than the solve."""
    sparsity = state_program(shape).qp_data.sparsity_out(name)
    return np.asarray(sparsity.row(), dtype=np.int32), np.asarray(sparsity.colind(), dtype=np.int32)


def _solved(kkt: Any, right: FloatArray, damped: FloatArray, steps: int) -> FloatArray:
    """Solve the system: factorise it with damping added to its diagonal, then refine by proximal-point steps.

    NaN if the factorisation fails.
    """
    point = np.zeros(right.size)
    try:
        with np.errstate(over="ignore", invalid="ignore"):  # a breakdown yields non-finite values
            factors = scipy.sparse.linalg.splu(scipy.sparse.csc_array(kkt + scipy.sparse.diags_array(damped)))
            for _ in range(1 + steps):
                point += factors.solve(right - kkt @ point)
    except RuntimeError:
        return np.full(right.size, np.nan)
    return point


def solve(problem: TransientProblem) -> Solution:
    """Solve without the limits; NUMERICAL_FAILURE if no answer's gap is small enough for a certificate."""
    start = time.perf_counter()
    # Rows that are not boxes are inequalities; they are removed from the equality system.
    sums = {row.name for row in stated_rows(problem, linear_stage(problem)) if not row.single}
    no_boxes = {limit.name for limit, row in problem.rows() if row.name in sums}
    statement = state(problem.without(*problem.nonlinear, *no_boxes))
    shape = statement.shape
    data = state_program(shape).qp_data(p=statement.p)
    H, A = (
        scipy.sparse.csc_array((np.asarray(data[name].nonzeros()), *pattern(shape, name)), shape=data[name].shape)
        for name in ("H", "A")
    )
    kkt = scipy.sparse.block_array([[H, A.T], [A, None]], format="csc")
    right = np.concatenate([-np.asarray(data["q"]).ravel(), statement.lower_g])
    best, least, multipliers = np.full(problem.rest.shape, np.nan), np.inf, Multipliers.zero(problem)
    for damping in DAMPINGS:
        damped = np.zeros(right.size)
        movements = damped[shape.first : H.shape[0]].reshape(-1, shape.variables)[:, : shape.layout.motors]
        movements[:] = damping * np.abs(H.data).max(initial=1.0)
        x, by_row = np.split(_solved(kkt, right, damped, DAMPED_STEPS if damping else REFINEMENTS), [H.shape[0]])
        if not (np.isfinite(x).all() and np.isfinite(by_row).all()):
            continue
        command = statement.unclipped(x)
        stated = replace(
            Multipliers.zero(problem), hand_over=statement.multipliers(np.zeros(x.size), by_row).hand_over
        )
        gap = certify(problem, command, stated).relative_gap
        if gap < least or np.isnan(best).any():
            best, least, multipliers = command, gap, stated
        if least <= GAP:
            break
    return Solution(
        status=Status.OPTIMAL if least <= Certificate.GAP_TOLERANCE else Status.NUMERICAL_FAILURE,
        command=best,
        multipliers=multipliers,
        solver="unlimited",
        message="sparse KKT system",
        iterations=1,
        solve_time_s=time.perf_counter() - start,
    )
