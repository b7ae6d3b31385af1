"""TOML files whose content is a section: reading, values as text, errors of one line with table, key and value."""

import json
import math
import re
import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any, TypeVar, get_args

from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

from transopt.base.errors import InputError, did_you_mean
from transopt.base.files import check_depth, read_file
from transopt.base.section import Section
from transopt.base.shown import cut
from transopt.base.sizes import MOST_TEXT_BYTES
from transopt.base.units import unit_of

Read = TypeVar("Read", bound=Section)
NOTHING_REPLACED: Mapping[str, str] = MappingProxyType({})
MOST_OTHERS = 3  # further keys that a message names
SMALLER_TOO = ("m", "s", "A", "V", "H", "N")  # units of which thousandths and millionths are stated as well
# Pydantic's message where a table is expected, which names classes.
_A_TABLE = re.compile(r"Input should be a valid dictionary or (instance of \w+|object to extract fields from)")


def read_text(path: Path, advice: str) -> str:
    """The text of a file, with line ends as on Unix and no byte order mark; `advice` is the next step in an error.

    Raises
    ------
    InputError : no such file, or not a text file.
    """
    try:
        return read_file(path, MOST_TEXT_BYTES, advice).decode("utf-8-sig").replace("\r\n", "\n")
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: cannot be read as text ({error}); save it as UTF-8; {advice}") from None


def parse_toml(text: str, path: Path, advice: str) -> dict[str, Any]:
    """The tables of a file's text, unchecked.

    Raises
    ------
    InputError : not TOML.
    """
    try:
        content = tomllib.loads(text)
        check_depth(content)
        return content
    except RecursionError:
        raise InputError(f"{path}: not valid TOML: nested too deep; {advice}") from None
    except ValueError as error:  # not only TOMLDecodeError: a number with too many digits raises a plain one
        raise InputError(f"{path}: not valid TOML: {error}{_line_of(text, str(error))}") from None


def read_toml(path: Path, advice: str) -> dict[str, Any]:
    """The tables of a TOML file, unchecked.

    Raises
    ------
    InputError : no such file, not a text file, or not TOML.
    """
    return parse_toml(read_text(path, advice), path, advice)


def read_section(path: Path, kind: type[Read], advice: str) -> tuple[Read, dict[str, Any]]:
    """A TOML file validated as a section of kind `kind`, and its tables as read.

    Raises
    ------
    InputError : the file cannot be read, or its content is not valid.
    """
    content = read_toml(path, advice)
    return section_of(path, content, kind), content


def section_of(path: Path, content: dict[str, Any], kind: type[Read]) -> Read:
    """A file's tables validated as a section of kind `kind`.

    Raises
    ------
    InputError : they are not valid.
    """
    try:
        return kind.model_validate(content)
    except ValidationError as error:
        raise InputError(explain(path, error, content, kind)) from None


def _line_of(text: str, message: str) -> str:
    """The line that is not TOML, with a hint if it has a decimal comma."""
    at = re.search(r"at line (\d+)", message)
    if at is None:
        return ""
    line = text.split("\n")[int(at[1]) - 1].partition("#")[0].strip()
    comma = ": numbers have a decimal point" if re.search(r"=\s*-?\d+,\d", line) else ""
    return f": {cut(line)}{comma}"


def in_words(message: str) -> str:
    """Pydantic's message without its own words."""
    return message.removeprefix("Value error, ").replace("Input should be", "must be")


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
        if isinstance(key, int):
            continue  # the tables of a list are of the kind that its key states
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


def explain(
    source: Path | str,
    error: ValidationError,
    content: dict[str, Any],
    kind: type[Section],
    *,
    whole: str = "file",
    replaced: Mapping[str, str] = NOTHING_REPLACED,
) -> str:
    """One line with pydantic's first complaint about a section's content, and the number of further keys concerned.

    Parameters
    ----------
    source : the file or the section's name, with which the line begins.
    error : pydantic's error.
    content : the tables that were validated. kind : their class.
    whole : the section in a word.
    replaced : keys of older files -> what to write instead.
    """
    # A misspelt key is named before the key that is missing because of it.
    first = min(error.errors(), key=lambda complaint: complaint["type"] != "extra_forbidden")
    keys = _keys_only(first, content)
    where = _path(keys)
    if first["type"] == "extra_forbidden":
        known = _known_keys(keys, content, kind)
        if where in replaced:
            return f"{source}: {where}: {replaced[where]}"
        text = f"{where}: unknown key{did_you_mean(str(keys[-1]), known)}; known here: {', '.join(known)}"
        if len(keys) > 1 and keys[-1] in kind.model_fields:
            above = f"{keys[-1]} is a key of the {whole}, not of this table"
            text = f"{where}: {above}: put its line above the first [table]"
    elif first["type"] == "missing":
        text = f"{where}: missing; add it to the {whole}"
    else:
        message = in_words(_A_TABLE.sub("must be a table", first["msg"]))
        if first["type"] == "float_parsing":
            message = "must be a number without quotes and unit: the key's name states the unit"
        bounds = [value for name, value in first.get("ctx", {}).items() if name in ("gt", "ge", "lt", "le")]
        if bounds:
            message += _unit_and_hint(where, first["input"], bounds[0], above=first["type"].startswith("less_than"))
        shown = "" if isinstance(first["input"], dict | BaseModel) else f" = {cut(repr(first['input']))}"
        text = f"{where}{shown}: {message}" if where else message
    others = {_keys_only(complaint, content) for complaint in error.errors()}
    # Complaints about a table that contains this key come from the other members of a union; they are not counted.
    elsewhere = [other for other in others if other != keys[: len(other)]]
    names = sorted(map(_path, elsewhere))
    more = f" (and {len(names)} more: {', '.join(names[:MOST_OTHERS])})" if names else ""
    return f"{source}: {text}{more}"


def _path(keys: Sequence[str | int]) -> str:
    """Dotted path of a key; an item of a list is counted from 1: `targets#2.frequency_Hz`."""
    return "".join(f"#{key + 1}" if isinstance(key, int) else f".{key}" for key in keys).removeprefix(".")


def _unit_and_hint(where: str, value: Any, bound: float, *, above: bool) -> str:
    """The unit of a bound, and the smaller unit that a value above the bound was probably meant in."""
    unit, meant = unit_of(where), ""
    if above and unit in SMALLER_TOO and isinstance(value, int | float):
        smaller = ((f"m{unit}", 1e-3), (f"u{unit}", 1e-6))
        meant = next((f" (did you mean {value:g} {name}?)" for name, by in smaller if value * by <= bound), "")
    return f" {unit}".rstrip() + meant


def toml_key(name: str) -> str:
    """A key as TOML; quoted if it contains more than letters, digits, underscores and dashes."""
    bare = name.isascii() and name.replace("_", "").replace("-", "").isalnum()
    return name if bare else _text(name)


def _text(text: str) -> str:
    """A TOML basic string: escaped as in JSON, and the delete character too."""
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")


def toml_value(value: Any) -> str:
    """A value as TOML on one line; nested tables become inline tables."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return _text(value)
    if isinstance(value, float):
        if not math.isfinite(value):
            return "nan" if math.isnan(value) else "inf" if value > 0 else "-inf"
        text = repr(value)
        return text if "." in text or "e" in text else f"{text}.0"
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{toml_key(name)} = {toml_value(each)}" for name, each in value.items()) + " }"
    if isinstance(value, list):
        return "[" + ", ".join(map(toml_value, value)) + "]"
    return str(value)
