"""IPOPT through CasADi: the independent second method for the QP, the first choice for the NLP."""

import time
from functools import lru_cache

import casadi as ca
import numpy as np

from transopt.problem.answer import Solution, Status
from transopt.problem.problem import TransientProblem
from transopt.solvers.options import SolverOptions, most_time_s
from transopt.solvers.program import state_program
from transopt.solvers.shape import Shape, program_shape
from transopt.solvers.statement import state

STATUS = {
    "Solve_Succeeded": Status.OPTIMAL,
    # Rounding prevents the last digits; the certificate judges whether they matter.
    "Solved_To_Acceptable_Level": Status.OPTIMAL,
    "Maximum_Iterations_Exceeded": Status.ITERATION_LIMIT,
    "Maximum_WallTime_Exceeded": Status.ITERATION_LIMIT,
    "Infeasible_Problem_Detected": Status.INFEASIBLE,
}


@lru_cache(maxsize=16)
def solver_object(shape: Shape, options: SolverOptions) -> ca.Function:
    """The solver object shared by all problems of one shape."""
    program = state_program(shape)
    # IPOPT evaluates a QP's Hessian and Jacobian once, and solves it with Mehrotra's predictor-corrector.
    quadratic = {
        "hessian_constant": "yes",
        "jac_c_constant": "yes",
        "jac_d_constant": "yes",
        "mehrotra_algorithm": "yes",
    }
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
                # Far from any feasible point a single iteration may take minutes.
                "max_cpu_time": most_time_s(shape.stages),
                # IPOPT relaxes bounds by default; the answer would violate the box by 6e-8 A.
                "bound_relax_factor": 0.0,
                # The program is scaled already.
                "nlp_scaling_method": "none",
                **(quadratic if shape.nodes == 0 and not shape.laws else {}),
            },
        },
    )


def solve(problem: TransientProblem, options: SolverOptions) -> Solution:
    """Solve the program as an NLP, quadratic or not."""
    shape = program_shape(problem)
    nlp = solver_object(shape, options)
    start = time.perf_counter()
    statement = state(problem)
    result = nlp(
        x0=0,
        p=statement.p,
        lbg=statement.lower_g,
        ubg=statement.upper_g,
        lbx=statement.lower_x,
        ubx=statement.upper_x,
    )
    message = str(nlp.stats()["return_status"])
    return Solution(
        status=STATUS.get(message, Status.NUMERICAL_FAILURE),
        command=statement.command(np.asarray(result["x"]).ravel()),
        multipliers=statement.multipliers(np.asarray(result["lam_x"]).ravel(), np.asarray(result["lam_g"]).ravel()),
        solver="casadi-ipopt",
        message=message,
        iterations=int(nlp.stats()["iter_count"]),
        solve_time_s=time.perf_counter() - start,
    )
