"""Reads and writes scene files; errors name the file's table, key, value and limit.

The user's own limits are in Python files with a list `LIMITS` of results of `transopt.own_limit`. Such a file is a
program of the user and is executed when a scene that names it is read; each limit describes itself as a table.
"""

import re
import runpy
import traceback
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from transopt.base import toml
from transopt.base.errors import InputError, did_you_mean
from transopt.base.files import is_file
from transopt.base.shown import cut
from transopt.base.toml import toml_key, toml_value
from transopt.plant.matrices import Matrices
from transopt.plant.state_space import StateSpace
from transopt.scene.model_file import identified_table, put_model, served_grips
from transopt.scene.plant_file import with_plant_file
from transopt.scene.plausible import check_plausible
from transopt.scene.scene import Scene

# Keys of older files, and keys that are looked for under another name -> what to write instead.
REPLACED = {
    "recordings.highpass_Hz": (
        "the recorded tap is tracked without a high-pass: delete the line; [hand] states how the stylus moves "
        "without current, and weights.rapid_from_Hz the corner of the rapid error"
    ),
    "weights.error_filter": (
        'the error has a plain and a rapid term: write weights.rapid = "pacinian" or "highpass" with '
        "weights.rapid_from_Hz, and weights.plain for the unfiltered error"
    ),
    "wall": "a virtual wall is the table [feedback], with stiffness_N_m and damping_N_s_m",
    "limits.winding_limit_C": "the winding's highest temperature is motor.winding_max_C",
    "weights.tracking": "write weights.plain, the weight of the unfiltered error over hand.intention_s",
}
_MODEL_LINE = re.compile(r"^\s*model\s*=", re.MULTILINE)
_MODEL_TABLE = re.compile(r"^\s*\[model[.\]]", re.MULTILINE)
ADVICE = "a scene is a TOML file; `transopt scene list` names the built-in scenes"
LIST = "LIMITS"


def explain(source: Path | str, error: ValidationError, content: dict[str, Any]) -> str:
    """One line with pydantic's first complaint about a scene's content."""
    return toml.explain(source, error, content, Scene, whole="scene", replaced=REPLACED)


def validated(source: Path | str, content: dict[str, Any]) -> Scene:
    """The scene with these tables, checked as a whole.

    Raises
    ------
    InputError : one line: source, key, value, what is wrong.
    """
    try:
        return Scene.model_validate(content)
    except ValidationError as error:
        raise InputError(explain(source, error, content)) from None


def _tables(path: Path) -> dict[str, Any]:
    """The tables of a scene file, unchecked."""
    text = toml.read_text(path, ADVICE)
    try:
        return toml.parse_toml(text, path, ADVICE)
    except InputError:
        if _MODEL_LINE.search(text) and _MODEL_TABLE.search(text):
            clash = "states a model file (model = ...) and [model] tables: write model_file = ... in that line"
            raise InputError(f"{path}: {clash}") from None
        raise


def _identified(scene: Path, line: str, named: str) -> dict[str, Any]:
    """The table of a model file's content, so that a library does not need the file."""
    try:
        return identified_table(scene.parent / named, named)
    except InputError as error:
        raise InputError(f"{scene}: {line} = {named!r}: {error}") from None


def _take_model_file(scene: Path, content: dict[str, Any]) -> None:
    """Replace the scene's own device by the file that `model_file` names; the device becomes the striker."""
    named = content.pop("model_file")
    if not isinstance(named, str):
        raise InputError(f'{scene}: model_file = {cut(repr(named))}: must be the path of a file, "MODEL.json"')
    if isinstance(content.get("model"), str):
        raise InputError(f"{scene}: model and model_file both name a model file: delete one of the lines")
    put_model(content, _identified(scene, "model_file", named))


def with_model(scene: Scene, file: str | Path) -> Scene:
    """The scene with its device replaced by an identified model, checked as a whole.

    The model replaces `[model]` and, if the file has these parts, the tip and the amplifier's pole and delay; the
    command's range stays. The scene's own device still makes the simulated taps.

    Raises
    ------
    InputError : one line: file, key, value, what is wrong.
    """
    content = scene.model_dump()
    put_model(content, identified_table(Path(file), str(file)))
    return validated(scene.name, content)


def with_plant(scene: Scene, plant: StateSpace) -> Scene:
    """The scene of a complete actuator with its plant replaced by one stated by matrices, checked as a whole.

    Raises
    ------
    InputError : a plant that contradicts the scene, for example by its input and the scene's limits.
    """
    content = {**scene.model_dump(), "model": Matrices.of(plant).model_dump()}
    return validated(scene.name, content)


def _resolved(scene: Path, folder: str) -> str:
    """The absolute path of the recordings' folder."""
    try:
        return str((scene.parent / folder).resolve())
    except (OSError, RuntimeError, ValueError) as error:
        raise InputError(f"{scene}: recordings.folder = {cut(repr(folder))}: no folder ({error})") from None


def read_scene(
    path: Path,
    *,
    search: Sequence[Path] = (),
    model: Path | None = None,
    model_grips: bool = False,
    accept: bool = False,
) -> Scene:
    """Read and check a scene file.

    Relative paths in it are relative to the scene's folder. Where motor, transmission and population are file names
    and not tables, they are also searched in the `search` folders. If `model` is a file name, it names a model file
    in place of the [model] table; `model_file` names one in addition to that table. The matrices of a plant may be in
    a file, `model.file`. The Python files below `limits.own` are executed.

    Parameters
    ----------
    model : a model file in place of any that the scene names; its path is relative to the working folder.
    model_grips : whether to use the grips at which `model` was identified, if it does not cover the scene's.
    accept : whether to accept implausible numbers (`transopt.scene.plausible`), as a scene itself may.

    Raises
    ------
    InputError : one line: file, key, value, what is wrong.
    """
    content = _tables(path)
    for table in (content, content.get("recordings")) if accept else ():
        if isinstance(table, dict):
            table["implausible"] = "accept"
    content.setdefault("name", "".join(c if c.isprintable() else "_" for c in path.stem))
    for table in ("motor", "transmission", "robust.population"):
        *inside, key = table.split(".")
        tables = content.get(inside[0]) if inside else content
        named = tables.get(key) if isinstance(tables, dict) else None
        if not isinstance(tables, dict) or not isinstance(named, str):
            continue
        places = [folder / named for folder in (path.parent, *search)]
        found = next((place for place in places if is_file(place)), None)
        if found is None:
            folders = ", ".join(str(place.parent) for place in places)
            known = sorted(
                str(file.relative_to(folder)) for folder in search for file in folder.glob(f"{key}s/*.toml")
            )
            built_in = f"; built-in: {', '.join(known)}" if known else ""
            raise InputError(
                f"{path}: {table} = {named!r}: no such file in {folders}{did_you_mean(named, known)}{built_in}"
            )
        tables[key] = toml.read_toml(found, ADVICE)
    if content.get("implausible") != "accept":
        check_plausible(path, content)
    if model is not None:
        content.pop("model_file", None)
        identified = identified_table(model, model.as_posix())
        put_model(content, identified)
        if model_grips:
            content["grid"]["grips_N"] = served_grips(identified, content["grid"]["grips_N"])
    elif "model_file" in content:
        _take_model_file(path, content)
    elif isinstance(content.get("model"), str):
        content["model"] = _identified(path, "model", content["model"])
    if isinstance(content.get("model"), dict):
        content["model"] = with_plant_file(path, content["model"])
        if content.get("implausible") != "accept" and content["model"].get("kind") == "state_space":
            check_plausible(path, {"model": content["model"]})
    recordings = content.setdefault("recordings", {}) if content.get("targets") else content.get("recordings")
    if isinstance(recordings, dict) and isinstance(recordings.get("folder", "."), str):
        recordings["folder"] = _resolved(path, recordings.get("folder", "."))
    limits = content.get("limits")
    if isinstance(limits, dict) and "own" in limits:
        # The user's own limits are written out over the stages, whose number follows from the rest of the scene.
        own = limits.pop("own")
        limits["own"] = own_tables(path, own, validated(path, content).stages)
    return validated(path, content)


def own_tables(scene: Path, named: Any, stages: int) -> list[dict[str, Any]]:
    """The tables of all limits in the named files, whose paths are relative to the scene's folder.

    Parameters
    ----------
    named : the scene's value of `limits.own`; tables in it are kept.
    stages : number of stages of the scene's horizon, over which stage-dependent numbers are written out.

    Raises
    ------
    InputError : no such file, a file that raises an error, or one without limits.
    """
    if not isinstance(named, list):
        raise InputError(f'{scene}: limits.own = {named!r}: must be a list of files, as in own = ["my_limits.py"]')
    found: list[dict[str, Any]] = []
    for each in named:
        found += [each] if isinstance(each, dict) else _read(scene, each, stages)
    names = [table.get("name") for table in found]
    if len(set(names)) < len(names):
        raise InputError(f"{scene}: limits.own: two limits have the name {max(names, key=names.count)}: rename one")
    return found


def _read(scene: Path, named: Any, stages: int) -> list[dict[str, Any]]:
    if not isinstance(named, str):
        raise InputError(f"{scene}: limits.own: {named!r} is not the name of a file")
    path = scene.parent / named
    if not is_file(path):
        raise InputError(f"{scene}: limits.own = {named!r}: no such file in {scene.parent}")
    try:
        stated = runpy.run_path(str(path)).get(LIST)
        if not isinstance(stated, list) or not stated:
            raise InputError(f"it has no list {LIST} of limits: LIMITS = [transopt.own_limit(...)]")
        return [limit.table(stages) for limit in stated]
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    except Exception as error:  # a user's program may raise anything
        line = next(
            (f.lineno for f in reversed(traceback.extract_tb(error.__traceback__)) if f.filename == str(path)), 0
        )
        words = str(error).strip().splitlines() or [""]
        raise InputError(f"{path}, line {line}: {type(error).__name__}: {words[-1]}") from None


def scene_text(scene: Scene) -> str:
    """The TOML text of a scene, one table after the other; keys without a value are left out.

    Motor, transmission and model are written as tables, even if they were read from files, so that the scene needs no
    other files than the recordings.
    """
    content = scene.model_dump(mode="json", exclude_none=True)
    if isinstance(scene.model, Matrices):
        del content["model"]["file"]  # the matrices are written out, and may be stated only once
    plain = {key: value for key, value in content.items() if not isinstance(value, dict)}
    # Keys of the scene come first: after a table's header they would belong to that table.
    blocks = ["\n".join(f"{key} = {toml_value(value)}" for key, value in plain.items() if value != [])]
    for key, value in content.items():
        if isinstance(value, dict) and value:
            blocks.append(
                "\n".join([f"[{key}]", *(f"{toml_key(name)} = {toml_value(each)}" for name, each in value.items())])
            )
    return "\n\n".join(block for block in blocks if block) + "\n"
