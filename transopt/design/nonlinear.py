"""The answer on a nonlinear plant, beside that of the linear design."""

from dataclasses import replace

import numpy as np

from transopt.base.errors import InputError
from transopt.design.context import Posed
from transopt.design.optimum import optimum
from transopt.design.within import why_no_more_instants
from transopt.plant.nonlinear_stage import NonlinearStage
from transopt.problem.nonlinear import NonlinearProblem
from transopt.proof.designed import Designed
from transopt.proof.nonlinear import NonlinearEffect, certify_nonlinear
from transopt.solvers.nonlinear import solve
from transopt.solvers.options import SolverOptions


def nonlinear_optimum(posed: Posed, options: SolverOptions) -> Designed:
    """Find a stationary point on the nonlinear plant, and the optimum for the plant linearised at rest.

    The linear optimum is found first. Its command, rolled out on the nonlinear plant, is IPOPT's starting point.

    Parameters
    ----------
    posed : the problem of the plant linearised at rest, and the nonlinear plant.
    options : tolerance and largest number of iterations of IPOPT; its `solver` is that of the linear design.

    Raises
    ------
    InputError : a target that is zero.
    """
    problem, plant = posed.problem, posed.plant
    assert plant is not None
    if problem.reference_is_zero:
        raise InputError(f"targets.{posed.target}: is zero throughout: there is nothing to design; take it out")
    linear = optimum(problem, options)
    at_rest = np.nan_to_num(linear.solution.command)
    stage = NonlinearStage(plant, problem.stage.amplifier, problem.grid.dt_s, 1, tuple(problem.stage.outputs))
    on_plant, found = solve(NonlinearProblem(problem, stage), at_rest, options)
    effect = NonlinearEffect(on_plant, np.nan_to_num(found.command))
    proof = certify_nonlinear(on_plant, found.command, found.multipliers, effect=effect)
    if proof.finite:
        # J is a sum of squares, so 0 is a lower bound; no better one is known for a nonconvex program.
        proof = replace(proof, lower_bound=0.0)
    designed = Designed(
        problem=problem,
        solution=found,
        certificate=proof,
        effect=effect,
        unlimited_command=linear.unlimited_command,
        floor=linear.floor,
        free_peak=linear.free_peak,
        unlimited_objective=linear.unlimited_objective,
        left_out={},
        solved=None,
        remarks=[],
        nonlinear=on_plant,
        linear=linear,
    )
    return replace(designed, left_out=why_no_more_instants(designed)) if designed.is_proven else designed
