"""Solve a library again for another hand on its device; limits and grid stay as they were.

The new commands track the tap that the object would give this hand (`transopt.design.another_hand`), or the tap
as it was recorded.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np

from transopt.base.errors import InputError
from transopt.design.another_hand import in_another_hand
from transopt.design.build import Build, build_library
from transopt.library.library import Library
from transopt.library.recorded import references_of_library
from transopt.references.reference import Reference
from transopt.scene.file import with_model
from transopt.scene.scene import Scene

OF_RECORDINGS = "grid_speed_m_s"  # a key that only sources which are recordings have
CARRIED_OVER = "carried over to another hand: what the object would do to the stylus in it"


def _scene_with(library: Library, model: Path) -> Scene:
    """The scene of a library with a model file in place of its model.

    A spread over a population of hands is replaced by the spread of the model file's own uncertainty.
    """
    library.check_linear("another hand")
    scene = library.scene()
    if scene.targets:
        raise InputError(f"{scene.name}: has named targets, for a device that nobody holds: give a library of taps")
    robust = scene.robust
    if robust is not None and robust.population is not None:
        robust = robust.model_copy(update={"population": None, "model_uncertainty": True})
    return with_model(scene.model_copy(update={"robust": robust}), model)


def built_on(library: Library, model: Path, *, as_recorded: bool = False) -> Build:
    """Design a library's entries for a model file in place of its own device, from the library's references.

    Corrections of a refinement are not taken over: they belong to the device on which it was made.

    Parameters
    ----------
    as_recorded : track the taps as they were recorded, in the hand that recorded them.

    Raises
    ------
    InputError : a library of named targets or of a nonlinear plant, or a model file that does not fit its scene.
    """
    scene, references = _scene_with(library, model), references_of_library(library)
    recorder = library.scene().striking()
    if not as_recorded:
        # The hand that plays is from now on also the one that strikes.
        scene = scene.model_copy(update={"striker": None})
        cells = tuple(_carried_over(cell, recorder, scene) for cell in references)
        references = replace(references, cells=cells)
    build = build_library(scene, references)
    if build.library is None:
        return build
    recorded = [source for source in library.meta["sources"] if OF_RECORDINGS in source]
    if not as_recorded:
        recorded = [{**source, "in_hand": CARRIED_OVER} for source in recorded]
    sources = [*recorded, *build.library.meta["sources"]]
    return replace(build, library=replace(build.library, meta={**build.library.meta, "sources": sources}))


def _carried_over(cell: Reference, recorder: Scene, player: Scene) -> Reference:
    """Carry a reference over from the recording hand to that of another scene; the intended motion stays the same."""
    free = np.concatenate([cell.free_before_m_s2, cell.free_m_s2, cell.free_after_m_s2])
    parts = (cell.recorded_before_m_s2, cell.recorded_m_s2, cell.recorded_after_m_s2)
    recorded, ends = np.concatenate(parts), np.cumsum([part.size for part in parts])[:-1]
    old, new = (scene.plant(cell.grip_N, struck=True) for scene in (recorder, player))
    tap = free + in_another_hand(recorded - free, cell.speed_m_s, old, new, player.time.dt_s)
    before, window, after = np.split(tap, ends)
    return replace(cell, recorded_before_m_s2=before, recorded_m_s2=window, recorded_after_m_s2=after)
