"""Reading scene files, with errors in the words of the file: table, key, value, limit."""

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
from transopt.scene.model_place import identified_table, put_model, served_grips
from transopt.scene.own_file import own_tables
from transopt.scene.plant_file import with_plant_file
from transopt.scene.plausible import check_plausible
from transopt.scene.scene import Scene

# Keys that older scene files have -> what is written instead.
REPLACED = {
    "recordings.highpass_Hz": (
        "the recorded tap is followed as it is, and no high-pass takes a share of it away: delete the line; how the "
        "stylus moves without current is said by [hand], and weights.rapid_from_Hz says from where on an error is "
        "rapid"
    ),
    "weights.error_filter": (
        'the error has a plain and a rapid term: write weights.rapid = "pacinian" or "highpass" with '
        "weights.rapid_from_Hz, and weights.plain for the error as it is"
    ),
    "weights.tracking": "write weights.plain, the weight of the error as it is over hand.intention_s",
}
# How pydantic asks for a table: by the names of classes.
_A_TABLE = re.compile(r"Input should be a valid dictionary or (instance of \w+|object to extract fields from)")
_MODEL_LINE = re.compile(r"^\s*model\s*=", re.MULTILINE)
_MODEL_TABLE = re.compile(r"^\s*\[model[.\]]", re.MULTILINE)


def read_toml(path: Path) -> dict[str, Any]:
    """The tables of a TOML file, unchecked.

    Raises
    ------
    InputError : no such file, no text, or no TOML.
    """
    advice = "a scene is a TOML file; `transopt scene list` names the built-in scenes"
    try:
        # Line ends as a text file has them.
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
    except ValueError as error:  # a number of a million digits is one as well
        if _MODEL_LINE.search(text) and _MODEL_TABLE.search(text):
            clash = "states a model file (model = ...) and [model] tables: write model_file = ... in that line"
            raise InputError(f"{path}: {clash}") from None
        raise InputError(f"{path}: not valid TOML: {error}{_line_of(text, str(error))}") from None


def _line_of(text: str, said: str) -> str:
    """The line that is no TOML, and what is wrong with it where that is a decimal comma."""
    at = re.search(r"at line (\d+)", said)
    if at is None:
        return ""
    line = text.split("\n")[int(at[1]) - 1].partition("#")[0].strip()
    comma = ": numbers have a decimal point" if re.search(r"=\s*-?\d+,\d", line) else ""
    return f": {cut(line)}{comma}"


def _keys_only(complaint: ErrorDetails, content: Any) -> tuple[str | int, ...]:
    """The location as the file spells it: pydantic also lists the names of union members on the way."""
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
    """The keys that the table around the last of `keys` takes."""
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
    """The first complaint about a scene's content in one line, and how many more keys there are complaints about.

    Parameters
    ----------
    source : the file or the scene's name, first in the line.
    error : what pydantic found.
    content : the tables that it was given.
    kind : what they shall be, where that is not a scene but a file of its own.
    """
    # A misspelt key comes before the one that is missing for it.
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
                f"{where}: {keys[-1]} is no key of this table but of the scene: put its line above the first [table]"
            )
    elif first["type"] == "missing":
        text = f"{where}: missing; add it to the {'scene' if kind is Scene else 'file'}"
    else:
        message = _A_TABLE.sub("must be a table", first["msg"]).removeprefix("Value error, ")
        message = message.replace("Input should be", "must be")
        if first["type"] == "float_parsing":
            message = "must be a number alone, without quotes and unit: the key's name states the unit"
        shown = "" if isinstance(first["input"], dict | BaseModel) else f" = {cut(repr(first['input']))}"
        text = f"{where}{shown}: {message}" if where else message
    others = {_keys_only(complaint, content) for complaint in error.errors()}
    # Complaints about a table around this key are the other members of a union, not faults of their own.
    elsewhere = [other for other in others if other != keys[: len(other)]]
    more = f" (and {len(elsewhere)} more)" if elsewhere else ""
    return f"{source}: {text}{more}"


def _identified(scene: Path, line: str, named: str) -> dict[str, Any]:
    """The table that stands for a model file: all that it holds, so that a library does not need the file."""
    try:
        return identified_table(scene.parent / named, named)
    except InputError as error:
        raise InputError(f"{scene}: {line} = {named!r}: {error}") from None


def _take_model_file(scene: Path, content: dict[str, Any]) -> None:
    """Put the file that `model_file` names in the place of the scene's own device, which stays as the striker."""
    named = content.pop("model_file")
    if not isinstance(named, str):
        raise InputError(f'{scene}: model_file = {cut(repr(named))}: must be the path of a file, "MODEL.json"')
    if isinstance(content.get("model"), str):
        raise InputError(f"{scene}: model and model_file both name a model file: delete one of the lines")
    put_model(content, _identified(scene, "model_file", named))


def with_model(scene: Scene, file: str | Path) -> Scene:
    """The scene with what has been identified in place of what it states of the device, checked as a whole.

    The model takes the place of `[model]` and, as far as the file has these parts, of the tip and of the amplifier's
    pole and delay; the command's range stays. Simulated taps are struck by the scene's own device.

    Parameters
    ----------
    file : model file, as `transopt identify` writes it.

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
    """The scene of a whole actuator with a plant by its matrices in place of its own, checked as a whole.

    Raises
    ------
    InputError : a plant that does not go with what the scene states, as its input with the limits.
    """
    content = {**scene.model_dump(), "model": Matrices.of(plant).model_dump()}
    try:
        return Scene.model_validate(content)
    except ValidationError as error:
        raise InputError(explain(scene.name, error, content)) from None


def _resolved(scene: Path, folder: str) -> str:
    """The recordings' folder from anywhere."""
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

    Relative paths in it count from the scene's folder; motor, transmission and population, where they are file names
    and not tables, are also looked for in the `search` folders. A model that is a file name is a model file, which
    takes the place of the [model] table; `model_file` names one beside that table. A plant by its matrices may have
    them in a file, `model.file`. The files below `limits.own` are run.

    Parameters
    ----------
    model : a model file in place of any that the scene names; its path counts from the working folder.
    model_grips : whether the grid takes the grips that `model` was identified at, if it does not know the scene's.
    accept : numbers that no device and no tap has (`transopt.scene.plausible`), as if the scene accepted them.

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
        # The stages over which limits of a user's own are written out follow from the rest of the scene.
        own = limits.pop("own")
        limits["own"] = own_tables(path, own, _validated(path, content).stages)
    return _validated(path, content)


def _validated(path: Path, content: dict[str, Any]) -> Scene:
    try:
        return Scene.model_validate(content)
    except ValidationError as error:
        raise InputError(explain(path, error, content)) from None
