"""The problems of a library whose plant is nonlinear.

The file holds the plant at rest, like every library, and the scene with the formulas of `[model.nonlinear]`. The
nonlinear plant is made from that scene; `transopt.library.proven` refuses a file whose formulas or whose plant at
rest differ from it. Limits, weights and references are those of the linear problem; only the map of the device over
one period differs.
"""

import numpy as np

from transopt.base.errors import InputError
from transopt.library.posed import Posed
from transopt.plant.nonlinear import NonlinearCoil
from transopt.plant.nonlinear_stage import MOST_SUBSTEPS, NonlinearStage
from transopt.problem.nonlinear import NonlinearProblem


def nonlinear_problem(library: Posed, iv: int, ig: int, plant: NonlinearCoil | None = None) -> NonlinearProblem:
    """The problem of which an entry claims to be a stationary point.

    Parameters
    ----------
    plant : the nonlinear plant of the library's scene, if the caller has it.

    Raises
    ------
    InputError : the scene has no nonlinear plant, or the number of substeps is none that a design takes.
    """
    steps = float(library.substeps[iv, ig])
    if not (1 <= steps <= MOST_SUBSTEPS and steps == np.rint(steps)):
        raise InputError(f"substeps = {steps:g}: must be a whole number from 1 to {MOST_SUBSTEPS}")
    plant = library.scene().nonlinear_plant() if plant is None else plant
    linear = library.problem(iv, ig)
    outputs = tuple(linear.stage.outputs)
    return NonlinearProblem(
        linear, NonlinearStage(plant, linear.stage.amplifier, linear.grid.dt_s, int(steps), outputs)
    )
