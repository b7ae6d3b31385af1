"""The problem without its limits as one sparse KKT system: slower than the Riccati pass, but pivoting."""

from functools import lru_cache

import numpy as np
import scipy
from numpy.typing import NDArray

from transopt.base.signals import FloatArray
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


def movement(problem: TransientProblem) -> FloatArray:
    """(N,) optimal movement of the command in units of the limit current; NaN if the system is singular.

    Of several motors it is (m, N).
    """
    # What is no box would be an inequality among the rows.
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
    try:
        factors = scipy.sparse.linalg.splu(kkt)
    except RuntimeError:
        return np.full_like(problem.rest, np.nan)
    point = factors.solve(right)
    for _ in range(REFINEMENTS):
        point += factors.solve(right - kkt @ point)
    variables = point[: shape.stages * shape.variables].reshape(-1, shape.variables)
    return np.asarray(variables[:, : shape.layout.motors].T.reshape(problem.rest.shape))
