"""The project's own method: an interior point over the stages, in C (`riccati.c`), on the statement's stage data.

The extension is optional. Where it could not be built, `available` is False and the CasADi methods take over.
"""

import time
from typing import Any

import numpy as np

from transopt.problem import stage_data as stagewise
from transopt.problem.problem import Solution, Status, TransientProblem
from transopt.problem.stage import LinearStage, layout, linear_stage
from transopt.problem.stage_data import Derivatives, Stages
from transopt.proof.farkas import is_infeasible
from transopt.solvers.native.extension import MOST_STATES, Buffers, available, interior_point
from transopt.solvers.options import SolverOptions
from transopt.solvers.program import nonzeros, program_shape, stage_data, stage_shape, supply_mask

__all__ = ["available", "can_solve", "solve", "stages"]

# Gap and residuals are both asked for this much more loosely than `SolverOptions.tolerance`: at the default that
# leaves three digits to the certificate's tolerance, and more digits only cost iterations.
LOOSER = 10.0

# What `tr_solve` returns.
STATUS = (
    (Status.OPTIMAL, "solved"),
    (Status.OPTIMAL, "solved to what rounding leaves"),
    (Status.ITERATION_LIMIT, "iteration limit"),
    (Status.NUMERICAL_FAILURE, "no step left"),
    (Status.NUMERICAL_FAILURE, "a factorisation broke down"),
    (Status.NUMERICAL_FAILURE, "too many states"),
)


def derivatives(problem: TransientProblem, stage: LinearStage) -> Derivatives:
    """What one stage is, as the CasADi statement says it."""
    where = layout(problem)
    values: dict[str, Any] = {
        "A": nonzeros(stage.A, where.dynamics_mask()),
        "B": stage.A[:, -1],
        "C": nonzeros(stage.C, where.output_mask()),
        "E": stage.E,
    }
    if problem.supply is not None:
        volts = problem.supply.limit_V
        values["S"] = nonzeros(stage.supply[None] / volts, supply_mask(where))
        values["S_direct"] = problem.supply.by_command * stage.current_A / volts
    if problem.thermal is not None:
        heating = problem.thermal.model.heating
        values |= {"share": heating.share, "decay": heating.decay}
    function = stage_data(stage_shape(program_shape(problem)))
    found = function.call([values[name] for name in function.name_in()])
    A, C, E, V, v = (np.asarray(each) for each in found)
    return Derivatives(A, C, E.ravel(), V, v.ravel())


def stages(problem: TransientProblem) -> Stages:
    """Stage data of a problem, from the CasADi statement."""
    stage = linear_stage(problem)
    return stagewise.stages(problem, stage, derivatives(problem, stage))


def can_solve(problem: TransientProblem) -> bool:
    """Whether the extension is there and the problem small enough: many devices in a spread are too many states."""
    shape = program_shape(problem)
    return available and shape.layout.states + shape.nodes <= MOST_STATES


def solve(problem: TransientProblem, options: SolverOptions) -> Solution:
    """Solve the QP or the NLP stage by stage; infeasibility is claimed only with its proof (`farkas`)."""
    start = time.perf_counter()
    given = stages(problem)
    found = Buffers(given.sizes)
    answer = interior_point(given, found, tolerance=LOOSER * options.tolerance, max_iterations=options.max_iterations)
    status, message = STATUS[answer.code]
    command = given.command(found.command)
    multipliers = given.multipliers(found.upper - found.lower, found.gradient)
    if status is not Status.OPTIMAL and is_infeasible(problem, command, multipliers):
        status, message = Status.INFEASIBLE, f"{message}: a ray proves that no command meets all limits"
    return Solution(
        status=status,
        command_A=command,
        multipliers=multipliers,
        solver="riccati",
        message=message,
        iterations=answer.iterations,
        solve_time_s=time.perf_counter() - start,
    )
