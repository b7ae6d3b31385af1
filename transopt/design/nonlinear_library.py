"""The library of a design on a nonlinear plant: the nonlinear program's commands, the linear design beside them."""

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from transopt.design.build import assemble
from transopt.design.entry import Baselines, Entry, left_out_by_scene, rivals_of
from transopt.library.library import Library
from transopt.recordings.reference import Reference
from transopt.scene.scene import Scene
from transopt.solvers.options import SolverOptions

if TYPE_CHECKING:  # which makes a library of its entries
    from transopt.design.nonlinear import NonlinearEntry


def nonlinear_library(
    scene: Scene, references: Sequence[Reference], entries: Sequence["NonlinearEntry"], options: SolverOptions
) -> Library:
    """The library of proven entries, one for each reference.

    Everything that the file states of the problem is of the plant as it is at rest; what the commands do, and the
    errors of the other methods, are of the nonlinear plant.

    Parameters
    ----------
    scene : with its table `model.nonlinear`.
    """
    linear = scene.at_rest()
    rows = [[_entry(linear, *each)] for each in zip(references, entries, strict=True)]
    library = assemble(linear, list(references), rows, options)

    def column(values: list[float]) -> np.ndarray:
        return np.array(values)[:, None]

    return replace(
        library,
        linear_command=np.stack([entry.linear_command for entry in entries])[:, None],
        nrmse_promised=column([entry.linear_promised for entry in entries]),
        nrmse_linear=column([_finite_or_nan(entry.linear_nrmse) for entry in entries]),
        substeps=column([float(entry.problem.stage.substeps) for entry in entries]),
        meta={
            **library.meta,
            "nonlinear": scene.formulas,
            "scene": scene.model_dump(mode="json"),
            "solver": {**library.meta["solver"], "nonlinear": entries[0].solution.solver},
        },
    )


def _finite_or_nan(value: float) -> float:
    return value if np.isfinite(value) else float("nan")


def _entry(linear: Scene, reference: Reference, entry: "NonlinearEntry") -> Entry:
    """One entry in the form in which a library takes it."""
    problem, command = entry.problem.linear, entry.solution.command
    others = rivals_of(linear.limits.steady_input, [entry.designed])
    return Entry(
        speed_m_s=reference.speed_m_s,
        grip_N=linear.grid.grips_N[0],
        target=entry.target,
        problem=problem,
        solution=entry.solution,
        # J is a sum of squares: 0 is a bound from below, and all that is known of one here.
        certificate=replace(entry.certificate, lower_bound=0.0),
        played=entry.played,
        predicted_m_s2=entry.predicted_m_s2,
        plant_input=entry.plant_input,
        transient_command=command,
        floor=entry.designed.floor,
        free_peak=entry.designed.free_peak,
        baselines=Baselines(*(entry.problem.nrmse(each) for each in others)),
        repeatability=reference.repeatability,
        status=entry.status,
        shortfalls=[],
        binding=entry.binding,
        prices=[],
        left_out=left_out_by_scene(linear, problem),
        solved=None,
        spread=None,
    )
