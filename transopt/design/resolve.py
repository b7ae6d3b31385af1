"""A library's entries solved again for corrected references, under the limits that they had."""

from collections.abc import Mapping
from dataclasses import asdict, replace
from typing import Any

import numpy as np

from transopt.base.errors import InputError
from transopt.base.signals import FloatArray
from transopt.design.context import Posed
from transopt.design.design import design
from transopt.design.entry import Entry
from transopt.library.derived import derived
from transopt.library.library import Library
from transopt.library.meta import entry_left_out, heat_is_in, most_parts, shared_left_out
from transopt.library.multipliers import ARRAYS, MULTIPLIERS, of_sides
from transopt.solvers.options import SolverOptions

# Arrays of a library that are computed from an entry, by name.
OF_ENTRIES = {name: array.made for name, array in ARRAYS.items() if array.made is not None}


def resolve(
    library: Library,
    corrections_m_s2: Mapping[tuple[int, int], FloatArray],
    refinement: dict[str, Any],
    options: SolverOptions | None = None,
) -> tuple[Library, dict[tuple[int, int], str]]:
    """Solve some entries again for the target r + correction; all others stay unchanged.

    The problems are those of the file (`Library.problem`): plants, amplifier, limits, weights, hand-over. A new
    answer replaces the old one only if it is optimal, certified and replayed without a violation, as when a library
    is built.

    Parameters
    ----------
    corrections_m_s2 : (iv, ig) -> (N,) correction that replaces the entry's present one.
    refinement : record of the refinement, stored in the library's `meta`.

    Returns
    -------
    The library, and (iv, ig) -> the reason why an entry was kept unchanged.

    Raises
    ------
    InputError : a library with a wall, whose feedback the correction does not include, or of a nonlinear plant.
    """
    library.check_linear("refine")
    if library.wall() is not None:
        raise InputError("refine: a library with a wall is not refined: its feedback answers the hand's own motion")
    options = SolverOptions() if options is None else options
    both = [library] if library.cool is None else [library, library.cool]
    entries = [_again(each, corrections_m_s2, options) for each in both]
    kept = {}
    for place in corrections_m_s2:
        reasons = [of_place.shortfalls[0] for of_all in entries if not (of_place := of_all[place]).admitted]
        if reasons:
            kept[place] = reasons[0]
    taken = {place: course for place, course in corrections_m_s2.items() if place not in kept}
    stated = [parts for of_all in entries for place in taken for parts in of_all[place].problem.parts.values()]
    if (parts := max(stated, default=1)) > most_parts(library.meta):
        both = [replace(each, meta={**each.meta, "instants_within": parts - 1}) for each in both]
    found = [_with(each, of_all, taken) for each, of_all in zip(both, entries, strict=True)]
    meta = {**found[0].meta, "solver": asdict(options), "refinement": refinement}
    if library.cool is None:
        return replace(found[0], meta=meta), kept
    meta["cool"] = {"left_out": found[1].meta["left_out"]}
    return replace(found[0], meta=meta).with_cool(
        {name: found[1].array(name) for name in _of_entries(found[0])}
    ), kept


def _of_entries(library: Library) -> list[str]:
    """Names of all arrays that are computed from entries."""
    return [*OF_ENTRIES, *MULTIPLIERS, *library.further]


def _again(
    library: Library, corrections_m_s2: Mapping[tuple[int, int], FloatArray], options: SolverOptions
) -> dict[tuple[int, int], Entry]:
    """Solve the entries for their corrected targets, with unchanged limits and prices."""
    found = {}
    for ig in sorted({ig for _, ig in corrections_m_s2}):
        speeds, posed = [iv for iv, g in sorted(corrections_m_s2) if g == ig], []
        for iv, before in zip(speeds, library.problems(ig, speeds), strict=True):
            uncorrected = library.uncorrected(iv, ig)
            problem = before.aiming_at(uncorrected.moved(corrections_m_s2[iv, ig]))
            grip, steady = float(library.grips_N[ig]), library.steady_input
            posed.append(
                Posed(problem, grip_N=grip, coil=library.coil(), steady_input=steady, uncorrected=uncorrected)
            )
        for iv, entry in zip(speeds, design(posed, options=options), strict=True):
            found[iv, ig] = entry.stating(objective=library.posing().objective)
    return found


def _with(
    library: Library, entries: Mapping[tuple[int, int], Entry], taken: Mapping[tuple[int, int], FloatArray]
) -> Library:
    """Put entries into the library, together with the corrections (`taken`) for which they were solved."""
    further = library.further
    arrays = {name: np.array(library.array(name)) for name in (*_of_entries(library), "correction_m_s2")}
    nv, ng = library.command.shape[:2]
    left_out = [[entry_left_out(library.meta, iv, ig) for ig in range(ng)] for iv in range(nv)]
    for (iv, ig), course in taken.items():
        entry = entries[iv, ig]
        found = {name: made(entry) for name, made in OF_ENTRIES.items()}
        sides = dict.fromkeys((*MULTIPLIERS, *further), 0.0) | of_sides(entry.solution.multipliers)
        _put(arrays, (iv, ig), found | sides | {"correction_m_s2": course})
        left_out[iv][ig] = entry.left_out
    shared = shared_left_out(left_out)
    problems = library.problems(0, range(nv))
    own = derived(library.posing(), problems, warm=heat_is_in(shared))
    multipliers = {name: arrays.pop(name) for name in (*MULTIPLIERS, *further)}
    meta = {**library.meta, "derived": own, "left_out": shared}
    return replace(library, **arrays, multipliers_of=multipliers, meta=meta, cool=None)


def _put(arrays: dict[str, Any], place: tuple[int, int], values: dict[str, Any]) -> None:
    for name, array in arrays.items():
        value = values[name]
        if isinstance(value, str) and len(value) > array.dtype.itemsize // 4:
            # A NumPy text array has a fixed width, which has to grow for a longer text.
            arrays[name] = array.astype(f"U{len(value)}")
        arrays[name][place] = value
