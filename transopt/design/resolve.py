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
from transopt.library.derived import derived
from transopt.library.library import ARRAYS, MULTIPLIERS, Library, further_arrays, multiplier_arrays
from transopt.library.meta import entry_left_out, heat_is_in, shared_left_out
from transopt.solvers.options import SolverOptions

# What an entry that is solved again brings along.
OF_ENTRIES = {name: array.made for name, array in ARRAYS.items() if array.made is not None}


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
    if library.wall() is not None:
        raise InputError("refine: a library with a wall is not refined: its feedback answers the hand's own motion")
    options = SolverOptions() if options is None else options
    scene = library.scene()
    further = further_arrays(library.posing(), library.spread_A.shape[1])
    arrays = {
        name: np.array(library.array(name)) for name in (*OF_ENTRIES, *MULTIPLIERS, *further, "correction_m_s2")
    }
    nv, ng, _ = library.command.shape
    left_out = [[entry_left_out(library.meta, iv, ig) for ig in range(ng)] for iv in range(nv)]
    kept: dict[tuple[int, int], str] = {}
    for ig in sorted({ig for _, ig in corrections_m_s2}):
        stage, speeds = library.stage(ig), [iv for iv, g in sorted(corrections_m_s2) if g == ig]
        posed = []
        for iv in speeds:
            told = library.told(iv, ig)
            problem = replace(library.problem(iv, ig, stage), target=told.moved(corrections_m_s2[iv, ig]))
            grip, steady = float(library.grips_N[ig]), library.steady_input
            posed.append(Posed(problem, grip_N=grip, coil=library.coil(), steady_input=steady, told=told))
        for iv, entry in zip(speeds, design(posed, options=options), strict=True):
            if not entry.admitted:
                kept[iv, ig] = entry.shortfalls[0]
                continue
            of_scene = entry.stating(objective=scene.weights.objective)
            found = {name: made(of_scene) for name, made in OF_ENTRIES.items()}
            found |= _multipliers(entry, further) | {"correction_m_s2": corrections_m_s2[iv, ig]}
            _put(arrays, (iv, ig), found)
            left_out[iv][ig] = entry.left_out
    shared = shared_left_out(left_out)
    problems = [library.problem(iv, 0) for iv in range(nv)]
    meta = {
        **library.meta,
        "derived": derived(library.posing(), problems, warm=heat_is_in(shared)),
        "left_out": shared,
        "solver": asdict(options),
        "refinement": refinement,
    }
    multipliers = {name: arrays.pop(name) for name in (*MULTIPLIERS, *further)}
    return replace(library, **arrays, multipliers_of=multipliers, meta=meta), kept


def _multipliers(entry: Entry, further: Sequence[str]) -> dict[str, Any]:
    found = entry.solution.multipliers
    return {name: array[0, 0] for name, array in multiplier_arrays([[found]], further).items()}


def _put(arrays: dict[str, Any], place: tuple[int, int], values: dict[str, Any]) -> None:
    for name, array in arrays.items():
        value = values[name]
        if isinstance(value, str) and len(value) > array.dtype.itemsize // 4:
            # An array of text has the width of its longest.
            arrays[name] = array.astype(f"U{len(value)}")
        arrays[name][place] = value
