"""The problem without its limits: one sparse KKT solve (DESIGN 2, the floor; DESIGN 4, leaving out).

The hand-over stays, because a waveform that does not end is no transient. Where the answer lies inside all
limits it is the answer to the limited problem too, with every multiplier zero.
"""

import time
from dataclasses import replace
from functools import lru_cache

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import splu

from transopt import transcribe
from transopt.problem import Multipliers, Solution, Status, TransientProblem

REFINEMENTS = 2


@lru_cache(maxsize=16)
def _pattern(shape: transcribe.Shape, name: str) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Row indices and column starts of a matrix of the program; reading them off takes longer than the solve."""
    sparsity = transcribe.state_program(shape).qp_data.sparsity_out(name)
    return np.asarray(sparsity.row(), dtype=np.int32), np.asarray(sparsity.colind(), dtype=np.int32)


def _scipy(matrix: ca.DM, pattern: tuple[NDArray[np.int32], NDArray[np.int32]]) -> sparse.csc_array:
    return sparse.csc_array((np.asarray(matrix.nonzeros()), *pattern), shape=matrix.shape)


def solve(problem: TransientProblem) -> Solution:
    """Minimise J subject to dynamics and hand-over only; see `Solution`.

    `command_A` is not clipped: it is what the limits would have to allow.
    """
    problem = replace(problem, supply=None, thermal=None)
    shape = transcribe.program_shape(problem)
    program = transcribe.state_program(shape)
    start = time.perf_counter()
    statement = transcribe.state(problem)
    data = program.qp_data(p=statement.p)
    H, A = (_scipy(data[name], _pattern(shape, name)) for name in ("H", "A"))
    kkt = sparse.block_array([[H, A.T], [A, None]], format="csc")
    right = np.concatenate([-np.asarray(data["q"]).ravel(), statement.lower_g])
    try:
        factors = splu(kkt)
        point = factors.solve(right)
        for _ in range(REFINEMENTS):
            point += factors.solve(right - kkt @ point)
        status, message = Status.OPTIMAL, "KKT system solved"
    except RuntimeError as singular:
        point, status, message = np.full(right.size, np.nan), Status.NUMERICAL_FAILURE, str(singular)
    n = shape.stages * shape.variables
    command = point[:n].reshape(-1, shape.variables)[:, shape.command] * statement.stage.current_A
    if problem.wall is None:
        command[problem.free_stages :] = 0.0
    free = transcribe.multipliers(statement, np.zeros(n), point[n:])
    return Solution(
        status=status,
        command_A=command,
        multipliers=replace(Multipliers.zero(problem), hand_over=free.hand_over),
        solver="unlimited",
        message=message,
        iterations=1,
        solve_time_s=time.perf_counter() - start,
    )
