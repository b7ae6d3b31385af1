"""PIQP through CasADi's conic interface: the stage-structured problem as a sparse QP."""

import time
from functools import lru_cache

import casadi as ca
import numpy as np

from transopt.problem.answer import Solution, Status
from transopt.problem.problem import TransientProblem
from transopt.solvers.options import SolverOptions
from transopt.solvers.program import state_program
from transopt.solvers.shape import Shape, program_shape
from transopt.solvers.statement import state

# Status strings of the plugin; any other string is a numerical failure.
STATUS = {
    "solved": Status.OPTIMAL,
    "max iterations reached": Status.ITERATION_LIMIT,
    "primal infeasible": Status.INFEASIBLE,
}


@lru_cache(maxsize=16)
def solver_object(shape: Shape, options: SolverOptions) -> ca.Function:
    """The solver object shared by all problems of one shape."""
    data = state_program(shape).qp_data
    settings = {
        "eps_abs": options.tolerance,
        "eps_rel": 0.0,
        "eps_duality_gap_abs": options.tolerance,
        "eps_duality_gap_rel": 0.0,
        "max_iter": options.max_iterations,
    }
    return ca.conic(
        "piqp",
        "piqp",
        {"h": data.sparsity_out("H"), "a": data.sparsity_out("A")},
        {"piqp": settings, "error_on_fail": False},
    )


def solve(problem: TransientProblem, options: SolverOptions) -> Solution:
    """Solve the QP; dynamics and hand-over are equality rows, limits are boxes or inequality rows."""
    shape = program_shape(problem)
    qp, program = solver_object(shape, options), state_program(shape)
    start = time.perf_counter()
    statement = state(problem)
    data = program.qp_data(p=statement.p)
    result = qp(
        h=data["H"],
        g=data["q"],
        a=data["A"],
        lba=statement.lower_g,
        uba=statement.upper_g,
        lbx=statement.lower_x,
        ubx=statement.upper_x,
    )
    message = str(qp.stats()["return_status"])
    return Solution(
        status=STATUS.get(message, Status.NUMERICAL_FAILURE),
        command=statement.command(np.asarray(result["x"]).ravel()),
        multipliers=statement.multipliers(np.asarray(result["lam_x"]).ravel(), np.asarray(result["lam_a"]).ravel()),
        solver="casadi-piqp",
        message=message,
        iterations=int(qp.stats()["iter_count"]),
        solve_time_s=time.perf_counter() - start,
    )
