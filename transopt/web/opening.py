"""Opens a scene, a library or a user's own taps for the page, and describes it to the browser."""

import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from transopt.base.errors import InputError
from transopt.base.toml import read_text
from transopt.base.toml_edit import edited
from transopt.files.unclear import Answer, joined
from transopt.library.columns import COLUMNS, EntryTable
from transopt.library.library import Library
from transopt.library.proven import load_proven
from transopt.report.taps import grid_of
from transopt.report.tried import Taps, prepared, usable
from transopt.scene.builtin import load_scene, scene_names, scene_path
from transopt.scene.file import ADVICE
from transopt.scene.keys import IN_PLACE_OF, with_values
from transopt.scene.scene import Scene
from transopt.web.controls import input_key
from transopt.web.service import Service
from transopt.web.shown import FIGURES


def opened(source: Scene | Library | str | Path, recordings: Path | None = None, *, accept: bool = False) -> Service:
    """The service of a scene or a library, given as object, name or path.

    Parameters
    ----------
    recordings : folder of the scene's recordings, in place of the one that it names.
    accept : whether to accept implausible numbers, as in `transopt.scene.builtin.load_scene`.

    Raises
    ------
    InputError : a file that cannot be used.
    """
    if isinstance(source, str | Path) and str(source).lower().endswith(".npz"):
        source = load_proven(Path(source))
    if isinstance(source, Library):
        source.check_linear("page")
        return Service(source.scene(), library=source)
    text = ""
    if not isinstance(source, Scene):
        named, source = str(source), load_scene(source, accept=accept)
        if named.lower().endswith(".toml"):
            text = read_text(Path(named), ADVICE)
        else:
            text = scene_path(named).read_text(encoding="utf-8").replace('"../', '"')  # as `scene new` copies it
    if recordings is not None:
        source = with_values(source, {"recordings.folder": str(recordings.resolve())})
        text = edited(text, {"recordings.folder": str(recordings.resolve())}) or ""
    return Service(source, text=text)


def own_taps(of: Service, folder: Path, files: Sequence[str], reading: Mapping[str, Any]) -> Service:
    """The service of a scene with a user's own taps in place of its recordings.

    The grid has the speeds that `transopt taps` finds in the files.

    Parameters
    ----------
    of : service of the scene, as opened, that the taps are for.
    files : names of the files in the folder.
    reading : keys of `recordings` for reading them, such as `speed_m_s` for files that state none.

    Raises
    ------
    AskedError : a file that leaves a fact open, such as its units or the speed.
    InputError : a file that is not a tap.
    """
    scene = of.opened
    if scene.targets:
        raise InputError(
            f"{scene.name}: has named targets, which recorded taps cannot replace: choose a scene with speeds"
        )
    stated = scene.recordings.model_dump(include={"lowpass_Hz", "trusted_from_Hz", "speed_tolerance"})
    table = {**stated, **reading, "files": list(files)}
    taken = with_values(scene, {"recordings": {**table, "folder": str(folder)}})

    def read(answer: Answer) -> Taps:
        return prepared(with_values(taken, {"recordings": joined(taken.recordings.model_dump(), answer)}).recordings)

    taps, settings = usable(read)
    speeds = {"grid.speeds_m_s": grid_of(taps, settings).speeds_m_s}
    text = edited(of.source, {"recordings": {**table, "folder": "."}, **speeds}) or ""
    return Service(with_values(taken, speeds), text=text, dropped=True)


def gallery() -> list[dict[str, str]]:
    """Name and description of every built-in scene."""
    described = ((name, tomllib.loads(scene_path(name).read_text(encoding="utf-8"))) for name in scene_names())
    return [{"name": name, "description": content.get("description", "")} for name, content in described]


def described(service: Service) -> dict[str, Any]:
    """Description of a scene for the browser before the first solution: words, units, taps and controls."""
    scene, axes = service.scene, service.scene.axes
    driven = scene.driven_by
    return {
        "name": scene.name,
        "description": scene.description,
        "driven_by": {"name": driven.name, "unit": driven.unit},
        "input_key": input_key(scene),
        "rivals": IN_PLACE_OF,
        "window_end_s": service.grid.end_s,
        "heads": axes.columns,
        "columns": _columns(scene),
        "places": [vars(place) for place in service.places],
        "controls": [vars(control) for control in service.controls],
        "between": None
        if scene.targets
        else {
            "speed_m_s": [axes.speeds_m_s[0], axes.speeds_m_s[-1]],
            "grip_N": [axes.grips_N[0], axes.grips_N[-1]],
        },
        "windings_C": service.windings_C,
        "remarks": service.remarks,
    }


def _columns(scene: Scene) -> list[dict[str, str]]:
    """Name, head and meaning of the numeric columns of the page's table."""
    driven, named = scene.driven_by, bool(scene.targets)
    meanings = EntryTable((), FIGURES, (), driven.unit).meanings(driven.name, named=named)
    found = [(name, COLUMNS[name].head, meanings.get(COLUMNS[name].head, "")) for name in FIGURES]
    cut = f"error of the optimum without limits after its {driven.name} was cut at the limit"
    found.insert(2, ("clipped", "clipped %", cut))
    return [{"name": name, "head": head, "meaning": meaning} for name, head, meaning in found]
