"""Reads scene files; errors name the file's table, key, value and limit."""

import re
import tomllib
from collections.abc import Sequence
from pathlib import Path
from typing import Any, get_args

from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

from transopt.base.errors import InputError
from transopt.base.files import check_depth, is_file, read_file
from transopt.base.nearest import did_you_mean
from transopt.base.section import Section
from transopt.base.shown import cut
from transopt.base.sizes import MOST_TEXT_BYTES
from transopt.plant.matrices import Matrices
from transopt.plant.state_space import StateSpace
from transopt.scene.model_file import identified_table, put_model, served_grips
from transopt.scene.own_file import own_tables
from transopt.scene.plant_file import with_plant_file
from transopt.scene.plausible import check_plausible
from transopt.scene.scene import Scene

# Keys of older scene files -> what to write instead.
REPLACED = {
    "recordings.highpass_Hz": (
        "the recorded tap is tracked without a high-pass: delete the line; [hand] states how the stylus moves "
        "without current, and weights.rapid_from_Hz the corner of the rapid error"
    ),
    "weights.error_filter": (
        'the error has a plain and a rapid term: write weights.rapid = "pacinian" or "highpass" with '
        "weights.rapid_from_Hz, and weights.plain for the unfiltered error"
    ),
    "weights.tracking": "write weights.plain, the weight of the unfiltered error over hand.intention_s",
}
# Pydantic's message where a table is expected, which names classes.
_A_TABLE = re.compile(r"Input should be a valid dictionary or (instance of \w+|object to extract fields from)")
_MODEL_LINE = re.compile(r"^\s*model\s*=", re.MULTILINE)
_MODEL_TABLE = re.compile(r"^\s*\[model[.\]]", re.MULTILINE)


def read_toml(path: Path) -> dict[str, Any]:
    """The tables of a TOML file, unchecked.

    Raises
    ------
    InputError : no such file, not a text file, or not TOML.
    """
    advice = "a scene is a TOML file; `transopt scene list` names the built-in scenes"
    try:
        # Files written on Windows end lines with \r\n.
        text = read_file(path, MOST_TEXT_BYTES, advice).decode("utf-8").replace("\r\n", "\n")
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: cannot be read as text ({error}); a scene is a TOML file") from None
    try:
        content = tomllib.loads(text)
        check_depth(content)
        return content
    except RecursionError:
        raise InputError(
            f"{path}: not valid TOML: nested too deep; a scene has tables in tables, no deeper"
        ) from None
    except ValueError as error:  # not only TOMLDecodeError: a number with too many digits raises a plain one
        if _MODEL_LINE.search(text) and _MODEL_TABLE.search(text):
            clash = "states a model file (model = ...) and [model] tables: write model_file = ... in that line"
            raise InputError(f"{path}: {clash}") from None
        raise InputError(f"{path}: not valid TOML: {error}{_line_of(text, str(error))}") from None


def _line_of(text: str, message: str) -> str:
    """The line that is not TOML, with a hint if it has a decimal comma."""
    at = re.search(r"at line (\d+)", message)
    if at is None:
        return ""
    line = text.split("\n")[int(at[1]) - 1].partition("#")[0].strip()
    comma = ": numbers have a decimal point" if re.search(r"=\s*-?\d+,\d", line) else ""
    return f": {cut(line)}{comma}"


def _keys_only(complaint: ErrorDetails, content: Any) -> tuple[str | int, ...]:
    """The keys of a complaint's location; pydantic also lists the names of union members among them."""
    keys: list[str | int] = []
    for step in complaint["loc"]:
        inside = step in content if isinstance(content, dict) else isinstance(step, int)
        if inside:
            content = content[step]
            keys.append(step)
    if complaint["type"] == "missing":
        keys.append(complaint["loc"][-1])
    return tuple(keys)


def _known_keys(keys: tuple[str | int, ...], content: Any, kind: type[Section]) -> list[str]:
    """The keys that the table which contains the last of `keys` may have."""
    tables: list[Any] = [kind]
    for key in keys[:-1]:
        content = content[key]
        annotations = [t.model_fields[key].annotation for t in tables if key in t.model_fields]
        members = [member for a in annotations for member in (a, *get_args(a))]
        tables = [member for member in members if isinstance(member, type) and issubclass(member, Section)]
        of_kind = [
            t
            for t in tables
            if "kind" in t.model_fields and content.get("kind") in get_args(t.model_fields["kind"].annotation)
        ]
        tables = of_kind or tables
    return list(dict.fromkeys(name for table in tables for name in table.model_fields))


def explain(source: Path | str, error: ValidationError, content: dict[str, Any], kind: type[Section] = Scene) -> str:
    """One line with pydantic's first complaint about a scene's content, and the number of further keys concerned.

    Parameters
    ----------
    source : the file or the scene's name, with which the line begins.
    error : pydantic's error.
    content : the tables that were validated.
    kind : their class, if they are not a scene but another file.
    """
    # A misspelt key is named before the key that is missing because of it.
    first = min(error.errors(), key=lambda complaint: complaint["type"] != "extra_forbidden")
    keys = _keys_only(first, content)
    where = ".".join(str(key) for key in keys)
    if first["type"] == "extra_forbidden":
        known = _known_keys(keys, content, kind)
        if where in REPLACED:
            return f"{source}: {where}: {REPLACED[where]}"
        text = f"{where}: unknown key{did_you_mean(str(keys[-1]), known)}; known here: {', '.join(known)}"
        if kind is Scene and len(keys) > 1 and keys[-1] in Scene.model_fields:
            text = (
                f"{where}: {keys[-1]} is a key of the scene, not of this table: put its line above the first [table]"
            )
    elif first["type"] == "missing":
        text = f"{where}: missing; add it to the {'scene' if kind is Scene else 'file'}"
    else:
        message = _A_TABLE.sub("must be a table", first["msg"]).removeprefix("Value error, ")
        message = message.replace("Input should be", "must be")
        if first["type"] == "float_parsing":
            message = "must be a number without quotes and unit: the key's name states the unit"
        shown = "" if isinstance(first["input"], dict | BaseModel) else f" = {cut(repr(first['input']))}"
        text = f"{where}{shown}: {message}" if where else message
    others = {_keys_only(complaint, content) for complaint in error.errors()}
    # Complaints about a table that contains this key come from the other members of a union; they are not counted.
    elsewhere = [other for other in others if other != keys[: len(other)]]
    more = f" (and {len(elsewhere)} more)" if elsewhere else ""
    return f"{source}: {text}{more}"


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

    Parameters
    ----------
    file : model file written by `transopt identify`.

    Raises
    ------
    InputError : one line: file, key, value, what is wrong.
    """
    content = scene.model_dump()
    put_model(content, identified_table(Path(file), str(file)))
    try:
        return Scene.model_validate(content)
    except ValidationError as error:
        raise InputError(explain(scene.name, error, content)) from None


def with_plant(scene: Scene, plant: StateSpace) -> Scene:
    """The scene of a complete actuator with its plant replaced by one stated by matrices, checked as a whole.

    Raises
    ------
    InputError : a plant that contradicts the scene, for example by its input and the scene's limits.
    """
    content = {**scene.model_dump(), "model": Matrices.of(plant).model_dump()}
    try:
        return Scene.model_validate(content)
    except ValidationError as error:
        raise InputError(explain(scene.name, error, content)) from None


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
    content = read_toml(path)
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
        tables[key] = read_toml(found)
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
        limits["own"] = own_tables(path, own, _validated(path, content).stages)
    return _validated(path, content)


def _validated(path: Path, content: dict[str, Any]) -> Scene:
    try:
        return Scene.model_validate(content)
    except ValidationError as error:
        raise InputError(explain(path, error, content)) from None
