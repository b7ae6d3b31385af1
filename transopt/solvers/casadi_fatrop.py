"""FATROP through CasADi: an interior-point method that eliminates stage by stage."""

import time
from functools import lru_cache

import casadi as ca
import numpy as np

from transopt.base.signals import FloatArray
from transopt.problem.problem import Solution, Status, TransientProblem
from transopt.solvers import program as transcribe
from transopt.solvers.options import SolverOptions
from transopt.solvers.statement import state

RELAXED = 1e-8  # by which the method widens every bound, times max(1, |bound|); CasADi does not let it be turned off
LEAST_NLP_TOLERANCE = 1e-8  # with the temperature, it asks for more digits than it has and does not end
SOLVED = "0"  # the plugin's return status is a number; it does not tell what else went wrong


def can_solve(problem: TransientProblem) -> bool:
    """Whether the problem is stage-wise: taps that repeat couple the last stage to the first."""
    return not transcribe.program_shape(problem).repeated


@lru_cache(maxsize=16)
def solver_object(shape: transcribe.Shape, options: SolverOptions) -> ca.Function:
    """One solver object for every problem of one shape."""
    program = transcribe.state_program(shape)
    N, order = shape.stages, program.stage_order
    # Stage k has the state after stage k - 1 and the movement dc_k; its limits are the rows that are no dynamics.
    limits = np.bincount(program.row_stages[program.stage_order], minlength=N + 1)
    limits[:N] -= shape.variables - shape.controls
    tolerance = max(options.tolerance, LEAST_NLP_TOLERANCE) if shape.nodes else options.tolerance
    equality = np.ones(program.g.numel(), dtype=bool)
    for kind in ("size_above", "size_below", "supply_before", "supply_after"):
        equality[program.rows.get(kind, slice(0, 0))] = False
    return ca.nlpsol(
        "fatrop",
        "fatrop",
        {"x": program.x, "p": program.p, "f": program.f, "g": program.g[order.tolist()]},
        {
            "print_time": False,
            "structure_detection": "manual",
            "N": N,
            "nx": [0, *[shape.variables - shape.controls] * N],
            "nu": [*[shape.controls] * N, 0],
            "ng": limits.tolist(),
            "equality": equality[order].tolist(),
            "fatrop": {"print_level": 0, "tolerance": tolerance, "max_iter": options.max_iterations},
        },
    )


def _narrowed(lower: FloatArray, upper: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Bounds that the method widens to the wanted ones; equalities stay as they are."""
    free = lower < upper

    def by(bound: FloatArray) -> FloatArray:
        return np.where(free & np.isfinite(bound), RELAXED * np.maximum(1.0, np.nan_to_num(np.abs(bound))), 0.0)

    return lower + by(lower), upper - by(upper)


def solve(problem: TransientProblem, options: SolverOptions) -> Solution:
    """Solve the program as an NLP with the structure of an optimal-control problem."""
    shape = transcribe.program_shape(problem)
    nlp, order = solver_object(shape, options), transcribe.state_program(shape).stage_order
    start = time.perf_counter()
    statement = state(problem)
    lower_x, upper_x = _narrowed(statement.lower_x, statement.upper_x)
    lower_g, upper_g = _narrowed(statement.lower_g[order], statement.upper_g[order])
    result = nlp(x0=0, p=statement.p, lbg=lower_g, ubg=upper_g, lbx=lower_x, ubx=upper_x)
    message = str(nlp.stats()["return_status"])
    on_rows = np.empty(order.size)
    on_rows[order] = np.asarray(result["lam_g"]).ravel()
    iterations = int(nlp.stats()["iter_count"])
    failed = Status.ITERATION_LIMIT if iterations >= options.max_iterations else Status.NUMERICAL_FAILURE
    return Solution(
        status=Status.OPTIMAL if message == SOLVED else failed,
        command_A=statement.command(np.asarray(result["x"]).ravel()),
        multipliers=statement.multipliers(np.asarray(result["lam_x"]).ravel(), on_rows),
        solver="casadi-fatrop",
        message=f"return status {message}",
        iterations=iterations,
        solve_time_s=time.perf_counter() - start,
    )
