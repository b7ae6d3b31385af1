"""A library's entries solved again for corrected references, under the limits that they had."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from typing import Any

import numpy as np

from transopt.base.errors import InputError
from transopt.base.signals import FloatArray
from transopt.design.context import Posed
from transopt.design.design import design
from transopt.design.entry import Entry
from transopt.library.library import MULTIPLIERS, Library, further_arrays, multiplier_arrays
from transopt.library.meta import entry_left_out, shared_left_out, temperature_is_in
from transopt.solvers.options import SolverOptions


def resolve(
    library: Library,
    corrections_m_s2: Mapping[tuple[int, int], FloatArray],
    refinement: dict[str, Any],
    options: SolverOptions | None = None,
) -> tuple[Library, dict[tuple[int, int], str]]:
    """Solve some entries for r + correction; all others stay as they are.

    The problems are those of the file (`Library.problem`): plants, amplifier, limits, weights, hand-over. An answer
    takes its place only if it is optimal, certified and replayed clean, as when a library is built.

    Parameters
    ----------
    corrections_m_s2 : (iv, ig) -> (N,), in place of the entry's present correction.
    refinement : what `meta` says about it.

    Returns
    -------
    The library, and (iv, ig) -> why an entry has kept what it had.

    Raises
    ------
    InputError : a library with a wall, whose feedback is no part of what is corrected, or of a nonlinear plant.
    """
    library.check_linear("refine")
    if library.meta["feedback"] is not None:
        raise InputError("refine: a library with a wall is not refined: its feedback answers the hand's own motion")
    options = SolverOptions() if options is None else options
    scene = library.scene()
    has_energy = scene.weights.objective == "intensity"
    further = further_arrays(library.meta, library.spread_A.shape[1])
    arrays = {name: np.array(library.array(name)) for name in (*_CHANGED, *further)}
    nv, ng, _ = library.command.shape
    left_out = [[entry_left_out(library.meta, iv, ig) for ig in range(ng)] for iv in range(nv)]
    kept: dict[tuple[int, int], str] = {}
    for ig in sorted({ig for _, ig in corrections_m_s2}):
        stage, speeds = library.stage(ig), [iv for iv, g in sorted(corrections_m_s2) if g == ig]
        posed = []
        for iv in speeds:
            wanted = library.reference_m_s2[iv] + corrections_m_s2[iv, ig]
            problem = library.problem(iv, ig, stage).towards(wanted)
            told = library.target(np.eye(nv)[iv])
            grip, steady = float(library.grips_N[ig]), library.steady_input
            posed.append(Posed(problem, grip_N=grip, coil=library.coil(), steady_input=steady, told=told))
        for iv, entry in zip(speeds, design(posed, options=options), strict=True):
            if not entry.admitted:
                kept[iv, ig] = entry.shortfalls[0]
                continue
            proof, played = entry.certificate, entry.played
            _put(
                arrays,
                (iv, ig),
                _multipliers(entry, further)
                | {
                    "command": entry.solution.command,
                    "transient_command": entry.transient_command,
                    "plant_input": entry.plant_input,
                    "acceleration_m_s2": entry.predicted_m_s2,
                    "nrmse": entry.nrmse,
                    "nrmse_after": played.nrmse_after,
                    "peak_after_m_s2": played.error_peak_after_m_s2,
                    "energy_dB": entry.energy_dB if has_energy else 0.0,
                    "floor": entry.floor,
                    "peak_input": played.peak_input,
                    "peak_temperature_C": played.winding_C,
                    "objective": proof.objective,
                    "primal_violation": proof.primal_violation,
                    "dual_residual": proof.dual_residual,
                    "duality_gap": proof.duality_gap,
                    "lower_bound": proof.lower_bound,
                    "solve_time_s": entry.solution.solve_time_s,
                    "binding": entry.binding,
                    "correction_m_s2": corrections_m_s2[iv, ig],
                },
            )
            left_out[iv][ig] = entry.left_out
    thermal = library.problem(0, 0).thermal
    warm = any(temperature_is_in(entry) for row in left_out for entry in row)
    meta = {
        **library.meta,
        "limits": {**library.meta["limits"], "temperature_C": thermal.limit_C if warm and thermal else None},
        "left_out": shared_left_out(left_out),
        "solver": asdict(options),
        "refinement": refinement,
    }
    multipliers = {name: arrays.pop(name) for name in (*MULTIPLIERS, *further)}
    return replace(library, **arrays, multipliers_of=multipliers, meta=meta), kept


_CHANGED = (
    "command",
    "transient_command",
    "plant_input",
    "acceleration_m_s2",
    "nrmse",
    "nrmse_after",
    "peak_after_m_s2",
    "energy_dB",
    "floor",
    "peak_input",
    "peak_temperature_C",
    "objective",
    "primal_violation",
    "dual_residual",
    "duality_gap",
    "lower_bound",
    "solve_time_s",
    "binding",
    "correction_m_s2",
    *MULTIPLIERS,
    "current_sign",
    "mu_end",
)


def _multipliers(entry: Entry, further: Sequence[str]) -> dict[str, Any]:
    found = entry.solution.multipliers
    arrays = {name: array[0, 0] for name, array in multiplier_arrays([[found]], further).items()}
    return {**arrays, "current_sign": found.slope, "mu_end": found.hand_over}


def _put(arrays: dict[str, Any], place: tuple[int, int], values: dict[str, Any]) -> None:
    for name, array in arrays.items():
        value = values[name]
        if isinstance(value, str) and len(value) > array.dtype.itemsize // 4:
            # An array of text has the width of its longest.
            arrays[name] = array.astype(f"U{len(value)}")
        arrays[name][place] = value
