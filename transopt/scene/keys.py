"""Keys of a scene by dotted path, with unit, bounds, default and value; and scenes with some of them changed.

Everything is derived from the tables of `Scene`, so a key that is added there appears here without further code.
"""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Literal, get_args, get_origin

from annotated_types import Ge, Gt, Le, Lt
from pydantic import ValidationError
from pydantic.fields import FieldInfo
from pydantic_core import PydanticUndefined

from transopt.base.errors import InputError, nearest
from transopt.base.section import Section, meanings
from transopt.base.toml import in_words
from transopt.base.units import largest, unit_of
from transopt.plant.hand import LinearParameter
from transopt.scene.file import validated
from transopt.scene.scene import Scene

Value = float | int | str | None
Changes = Mapping[str, Any]  # dotted path -> value; a whole table for "motor" and "transmission"

# Two keys that state the same quantity: setting one removes the other.
IN_PLACE_OF = {"limits.current_A": "limits.beta", "limits.beta": "limits.current_A"}
WHOLE_TABLES = ("motor", "transmission")
COUPLED = "the values of a motor belong together as one row of a datasheet: swap whole files with motor=A,B"


@dataclass(frozen=True)
class Key:
    """One number or choice of a scene.

    Attributes
    ----------
    path : dotted path.
    unit : unit by the ending of the name; empty without one.
    default : value where the scene does not state it; None for none.
    required : whether every scene has to state it.
    value : value in this scene, None if not stated.
    bounds : bounds in words.
    choices : permitted words.
    number : whether it accepts numbers.
    integer : whether it accepts only integers.
    optional : whether it may be left out.
    description : meaning in a sentence.
    interval : the bounds as two numbers; a strict bound ("> 0") is itself not permitted.
    """

    path: str
    unit: str
    default: Value
    required: bool
    value: Value
    bounds: str
    choices: tuple[str, ...]
    number: bool
    integer: bool
    optional: bool
    description: str
    interval: tuple[float, float] = (-math.inf, math.inf)


def flat(annotation: Any) -> Iterator[Any]:
    """The members of a union and the content of Annotated, metadata included."""
    yield annotation
    if get_origin(annotation) is not Literal:
        for member in get_args(annotation):
            yield from flat(member)
    yield from getattr(annotation, "metadata", ())


def bounds_of(parts: list[Any], unit: str) -> str:
    """Bounds in words, those of FieldInfo objects inside Annotated and the largest value of the unit included."""
    words, most = [], largest(unit)
    for part in parts:
        match part:
            case Gt(gt=bound):
                words.append(f"> {bound:g}")
            case Ge(ge=bound):
                words.append(f">= {bound:g}")
            case Lt(lt=bound):
                words.append(f"< {bound:g}")
            case Le(le=bound):
                words.append(f"<= {bound:g}")
    if unit and not any(isinstance(part, Lt | Le) for part in parts):
        words.append(f"<= {most:g}" if any(isinstance(part, Gt | Ge) for part in parts) else f"|.| <= {most:g}")
    return ", ".join(dict.fromkeys(words))


def _interval(parts: list[Any], unit: str) -> tuple[float, float]:
    """The bounds as two numbers: those of pydantic and the largest value of the unit."""
    low, high = -largest(unit), largest(unit)
    for part in parts:
        match part:
            case Gt(gt=float() | int() as bound) | Ge(ge=float() | int() as bound):
                low = max(low, float(bound))
            case Lt(lt=float() | int() as bound) | Le(le=float() | int() as bound):
                high = min(high, float(bound))
    return low, high


def _walk(table: type[Section], value: Section | None, prefix: str) -> Iterator[Key]:
    """The keys of a table and of the tables in it; `value` is the table as stated in the scene, None if it is not."""
    descriptions = meanings(table)
    for name, field in table.model_fields.items():
        path, stated = f"{prefix}{name}", getattr(value, name, None)
        parts = [*flat(field.annotation), *field.metadata]
        parts += [bound for part in parts if isinstance(part, FieldInfo) for bound in part.metadata]
        # A study varies the device, not the striker of simulated taps; the other two are read from separate files.
        if path in ("striker", "limits.own") or (path == "robust.population" and stated is None):
            continue
        inner = [part for part in parts if isinstance(part, type) and issubclass(part, Section)]
        if path == "motor":
            yield Key(
                path, "", None, False, getattr(stated, "name", None), "", ("FILE",), False, False, False, COUPLED
            )
            continue
        if path == "transmission":
            yield Key(path, "", None, False, None, "", ("FILE",), False, False, False, "a file in place of the table")
        if isinstance(stated, Section):
            yield from _walk(type(stated), stated, f"{path}.")
        elif inner and not (inner == [LinearParameter] and isinstance(stated, int | float)):
            yield from _walk(inner[0], None, f"{path}.")
        elif (leaf := _leaf(path, field, parts, stated, descriptions.get(name, ""))) is not None:
            yield leaf


def _leaf(path: str, field: FieldInfo, parts: list[Any], stated: Any, description: str) -> Key | None:
    """A key whose value is a number or one of several words; None for names, lists and fixed values."""
    choices = tuple(word for p in parts if get_origin(p) is Literal for word in get_args(p) if isinstance(word, str))
    numbers = [n for p in parts if get_origin(p) is Literal for n in get_args(p) if isinstance(n, int)]
    grid = path in ("grid.speeds_m_s", "grid.grips_N")
    numeric = float in parts or int in parts or bool(numbers)
    if not numeric and len(choices) < 2:
        return None
    if any(get_origin(part) in (list, dict) for part in parts) and not grid and not isinstance(stated, int | float):
        return None
    default = None if field.default is PydanticUndefined else field.default
    return Key(
        path=path,
        unit=unit_of(path),
        default=default if isinstance(default, float | int | str) else None,
        required=field.is_required(),
        value=", ".join(f"{v:g}" for v in stated) if grid and stated else stated,
        bounds=f"one of {', '.join(map(str, numbers))}" if numbers else bounds_of(parts, unit_of(path)),
        choices=choices,
        number=numeric,
        integer=float not in parts and (int in parts or bool(numbers)),
        optional=type(None) in parts,
        description=description,
        interval=(min(numbers), max(numbers)) if numbers else _interval(parts, unit_of(path)),
    )


def keys(scene: Scene) -> list[Key]:
    """All keys of a scene that a study can vary, in the order of its tables.

    Names, files and lists are left out, except for the nodes of the grid; a motor is one key (see `COUPLED`).
    """
    return list(_walk(Scene, scene, ""))


def find_key(scene: Scene, path: str) -> Key:
    """The key of a dotted path.

    Raises
    ------
    InputError : no such key, or a single value of a motor.
    """
    if path.startswith("motor."):
        raise InputError(f"{path}: {COUPLED}")
    known = {key.path: key for key in keys(scene)}
    if path not in known:
        # The given table may be wrong or missing, so suggestions are also searched by the last part of the path.
        close = nearest(path, known, 0.5) or nearest(path.rsplit(".", 1)[-1], known, 0.4)
        hint = f" (did you mean {' or '.join(close)}?)" if close else ""
        raise InputError(
            f"{path}: no key of the scene {scene.name} that can be varied{hint}; `transopt scene keys` shows all"
        )
    return known[path]


def parse_value(key: Key, text: str) -> Value:
    """Parse a value of the command line: a number, one of the key's words, or `none` for an optional key.

    Raises
    ------
    InputError : the text is none of these.
    """
    text = text.strip()
    if text in key.choices:
        return text
    if text == "none" and key.optional:
        return None
    try:
        number = float(text)
    except ValueError:
        number = math.nan
    if not key.number or not math.isfinite(number):
        allowed = [*(["a finite number"] if key.number else []), *key.choices, *(["none"] if key.optional else [])]
        raise InputError(f"{key.path} = {text}: must be {' or '.join(allowed)}")
    return int(number) if key.integer and number == int(number) else number


def _content(scene: Scene, changes: Changes) -> dict[str, Any]:
    """The scene with the changes; the tables that they change are not checked yet, all others are as they were."""
    changed = {path.split(".", 1)[0] for path in (*changes, *(IN_PLACE_OF.get(path, path) for path in changes))}
    content = dict(scene) | scene.model_dump(include=changed)
    # Whole tables first: a changed key belongs to the new table.
    for path, value in sorted(changes.items(), key=lambda change: change[0] not in WHOLE_TABLES):
        *tables, name = path.split(".")
        table = content
        for part in tables:
            if not isinstance(table.get(part), dict):
                table[part] = {}
            table = table[part]
        table[name] = value
        other = IN_PLACE_OF.get(path)
        if other is not None and value is not None and other not in changes:
            section, rival = other.split(".")
            content[section][rival] = None
    return content


def with_values(scene: Scene, changes: Changes) -> Scene:
    """The scene with some keys changed, checked as a whole.

    `limits.current_A` replaces `limits.beta` and vice versa; other keys stay unchanged.

    Raises
    ------
    InputError : one line: key, value, limit.
    """
    return validated(scene.name, _content(scene, changes))


def check_value(scene: Scene, path: str, value: Any) -> None:
    """Refuse a value that its key cannot have, regardless of the rest of the scene."""
    content = _content(scene, {path: value})
    try:
        Scene.model_validate(content)
    except ValidationError as error:
        own = path.split(".")
        for complaint in error.errors():
            named = [part for part in complaint["loc"] if part in own or isinstance(part, int)]
            about = [part for part in named if not isinstance(part, int)]
            if about[: len(own)] == own and complaint["type"] != "missing":
                raise InputError(f"{path} = {value}: {in_words(complaint['msg'])}") from None
