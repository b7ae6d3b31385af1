"""The problems of a library whose plant is nonlinear.

The file holds the plant as it is at rest, as of every library, and the formulas of `[model.nonlinear]`, as the scene
in it has them. The nonlinear plant is made from that scene; `transopt.library.proven` refuses a file whose formulas,
or whose plant at rest, are others. Limits, weights and references are those of the linear problem: only the device
over a period is another one.
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
    plant : that of the library's scene, where it is known already.

    Raises
    ------
    InputError : a scene without a nonlinear plant; steps of the stage that no design takes.
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
