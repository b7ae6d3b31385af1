"""The problem without its limits as one sparse KKT system: slower than the Riccati pass, but pivoting."""

import time
from dataclasses import replace
from functools import lru_cache

import numpy as np
import scipy
from numpy.typing import NDArray

from transopt.problem.answer import Multipliers, Solution, Status
from transopt.problem.problem import TransientProblem
from transopt.problem.stage import linear_stage
from transopt.solvers.program import Shape, state_program
from transopt.solvers.stage_data import stated_rows
from transopt.solvers.statement import state

REFINEMENTS = 2


@lru_cache(maxsize=16)
def pattern(shape: Shape, name: str) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Row indices and column starts of a matrix of the program; reading them off takes longer than the solve."""
    sparsity = state_program(shape).qp_data.sparsity_out(name)
    return np.asarray(sparsity.row(), dtype=np.int32), np.asarray(sparsity.colind(), dtype=np.int32)


def solve(problem: TransientProblem) -> Solution:
    """Solve without the limits; a numerical failure if the system is singular."""
    start = time.perf_counter()
    # What is no box would be an inequality among the rows.
    sums = {row.name for row in stated_rows(problem, linear_stage(problem)) if not row.single}
    no_boxes = [limit.name for limit in problem.limits if sums & set(limit.row_names)]
    statement = state(problem.without(*problem.nonlinear, *no_boxes))
    shape = statement.shape
    data = state_program(shape).qp_data(p=statement.p)
    H, A = (
        scipy.sparse.csc_array((np.asarray(data[name].nonzeros()), *pattern(shape, name)), shape=data[name].shape)
        for name in ("H", "A")
    )
    kkt = scipy.sparse.block_array([[H, A.T], [A, None]], format="csc")
    right = np.concatenate([-np.asarray(data["q"]).ravel(), statement.lower_g])
    point = np.full(right.size, np.nan)
    try:
        with np.errstate(over="ignore", invalid="ignore"):  # a breakdown shows in the answer
            factors = scipy.sparse.linalg.splu(kkt)
            point = factors.solve(right)
            for _ in range(REFINEMENTS):
                point += factors.solve(right - kkt @ point)
    except RuntimeError:
        pass
    x, by_row = np.split(point, [H.shape[0]])
    found = bool(np.isfinite(point).all())
    multipliers = Multipliers.zero(problem)
    if found:
        by_rule = statement.multipliers(np.zeros(x.size), by_row).hand_over
        multipliers = replace(multipliers, hand_over=by_rule)
    return Solution(
        status=Status.OPTIMAL if found else Status.NUMERICAL_FAILURE,
        command=statement.unclipped(x),
        multipliers=multipliers,
        solver="unlimited",
        message="sparse KKT system",
        iterations=1,
        solve_time_s=time.perf_counter() - start,
    )
