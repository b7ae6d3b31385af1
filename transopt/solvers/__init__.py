"""Solvers behind one function: `solve(problem, options) -> Solution`. One file per solver."""

import numpy as np

from transopt.errors import InputError
from transopt.problem import Multipliers, Solution, Status, TransientProblem
from transopt.solvers import casadi_ipopt, casadi_piqp
from transopt.solvers.options import SolverOptions

__all__ = ["SOLVERS", "SolverOptions", "check_name", "solve"]

SOLVERS = {"casadi-piqp": casadi_piqp.solve, "casadi-ipopt": casadi_ipopt.solve}


def check_name(solver: str) -> None:
    """Refuse an unknown solver before any work is done.

    Raises
    ------
    InputError : unknown solver name.
    """
    if solver not in SOLVERS:
        raise InputError(f"--solver {solver}: unknown; choose one of {', '.join(SOLVERS)}")


def solve(problem: TransientProblem, options: SolverOptions | None = None) -> Solution:
    """Solve one entry's problem; the answer's worth is judged by `certify` and `replay`, not here.

    A zero reference has the zero waveform as its answer and is not handed to a solver.

    Raises
    ------
    InputError : unknown solver name.
    """
    options = SolverOptions() if options is None else options
    check_name(options.solver)
    if problem.reference_is_zero:
        command = np.zeros(problem.grid.stages)
        return Solution(
            Status.OPTIMAL, command, Multipliers.zero(problem), "none", "zero reference: zero waveform", 0, 0.0
        )
    return SOLVERS[options.solver](problem, options)
