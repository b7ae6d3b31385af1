"""IPOPT through CasADi: the independent second method, from the same statement."""

import time
from functools import lru_cache

import casadi as ca
import numpy as np

from transopt import transcribe
from transopt.problem import Solution, Status, TransientProblem
from transopt.solvers.options import SolverOptions

STATUS = {
    "Solve_Succeeded": Status.OPTIMAL,
    "Maximum_Iterations_Exceeded": Status.ITERATION_LIMIT,
    "Infeasible_Problem_Detected": Status.INFEASIBLE,
}


@lru_cache(maxsize=16)
def solver_object(shape: transcribe.Shape, options: SolverOptions) -> ca.Function:
    """One solver object for every problem of one shape."""
    program = transcribe.state_program(shape)
    return ca.nlpsol(
        "ipopt",
        "ipopt",
        {"x": program.x, "p": program.p, "f": program.f, "g": program.g},
        {
            "print_time": False,
            "ipopt": {
                "print_level": 0,
                "sb": "yes",
                "tol": options.tolerance,
                "max_iter": options.max_iterations,
                # Otherwise the answer leaves the box by 6e-8 A.
                "bound_relax_factor": 0.0,
                "hessian_constant": "yes",
                "jac_c_constant": "yes",
                "mehrotra_algorithm": "yes",
            },
        },
    )


def solve(problem: TransientProblem, options: SolverOptions) -> Solution:
    """Solve the same program as an NLP that happens to be quadratic."""
    shape = transcribe.program_shape(problem)
    nlp = solver_object(shape, options)
    start = time.perf_counter()
    scale = transcribe.scaling(problem)
    upper = transcribe.box(problem, scale)
    p = transcribe.parameters(problem, scale)
    result = nlp(x0=0, p=p, lbg=0, ubg=0, lbx=-upper, ubx=upper)
    message = str(nlp.stats()["return_status"])
    return Solution(
        status=STATUS.get(message, Status.NUMERICAL_FAILURE),
        command_A=transcribe.command(problem, scale, np.asarray(result["x"]).ravel()),
        multipliers=transcribe.multipliers(
            problem, scale, np.asarray(result["lam_x"]).ravel(), np.asarray(result["lam_g"]).ravel()
        ),
        solver="casadi-ipopt",
        message=message,
        iterations=int(nlp.stats()["iter_count"]),
        solve_time_s=time.perf_counter() - start,
    )
