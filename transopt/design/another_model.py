"""A library solved again for another model of its device or hand: the taps, limits and grid stay what they were."""

from dataclasses import replace
from pathlib import Path

from transopt.base.errors import InputError
from transopt.design.build import Build, build_library
from transopt.library.library import Library
from transopt.library.recorded import references_of_library
from transopt.scene.file import with_model
from transopt.scene.scene import Scene
from transopt.solvers.options import SolverOptions

OF_RECORDINGS = "grid_speed_m_s"  # a key of every source that is a recording


def scene_with(library: Library, model: Path) -> Scene:
    """The scene of a library on a model file; what its spread of hands was is what the model file leaves open.

    Raises
    ------
    InputError : a library that is not of taps in a hand, or a model file that does not go with its scene.
    """
    library.check_linear("another model")
    scene = library.scene()
    if scene.targets:
        raise InputError(f"{scene.name}: has named targets, for a device that nobody holds: give a library of taps")
    robust = scene.robust
    if robust is not None and robust.population is not None:
        robust = robust.model_copy(update={"population": None, "model_uncertainty": True})
    return with_model(scene.model_copy(update={"robust": robust}), model)


def built_on(library: Library, model: Path, options: SolverOptions | None = None) -> Build:
    """A library's entries designed for a model file in place of its own device, from the references that it has.

    Corrections of a refinement are not taken over: they are of the device that it was refined on.

    Raises
    ------
    InputError : see `scene_with`.
    """
    build = build_library(scene_with(library, model), references_of_library(library), options=options)
    if build.library is None:
        return build
    recorded = [source for source in library.meta["sources"] if OF_RECORDINGS in source]
    sources = [*recorded, *build.library.meta["sources"]]
    return replace(build, library=replace(build.library, meta={**build.library.meta, "sources": sources}))
