"""The varied keys of a constraint study with their values, parsed from the command line."""

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from transopt.base.errors import InputError, did_you_mean
from transopt.base.section import Section
from transopt.base.toml import read_section
from transopt.plant.motor import Motor, Transmission
from transopt.scene.keys import check_value, find_key, parse_value, with_values
from transopt.scene.plausible import check_plausible
from transopt.scene.scene import Scene

# Tables that are varied as a whole, by files.
FILES: dict[str, type[Section]] = {"motor": Motor, "transmission": Transmission}
_SPAN = r"(\d+\.?\d*|\.\d+)\s*(?:\.\.+|-|–|to|…)\s*(\d+\.?\d*|\.\d+)"  # notations of a range in use elsewhere


@dataclass(frozen=True)
class Axis:
    """One key and its values.

    Attributes
    ----------
    key : dotted path of the scene; "motor" or "transmission" for a whole table.
    values : values as the scene takes them.
    labels : values as tables and CSV files show them.
    limits : ends of a range, between which samples are drawn; None for listed values.
    log : whether the range is spaced by equal factors.
    """

    key: str
    values: tuple[Any, ...]
    labels: tuple[str, ...]
    limits: tuple[float, float] | None = None
    log: bool = False

    @property
    def numeric(self) -> bool:
        return all(isinstance(value, int | float) for value in self.values)


def label(value: Any) -> str:
    """A value as text for a CSV file, with enough digits to read it back exactly."""
    return repr(value) if isinstance(value, float) else "none" if value is None else str(value)


def _numbers(option: str, text: str) -> list[float]:
    try:
        return [float(part) for part in text.split(":")]
    except ValueError:
        raise InputError(f"{option} {text}: a range is START:STOP:COUNT, three numbers") from None


def parse_range(option: str, text: str) -> tuple[tuple[float, float], list[float], bool]:
    """Ends and values of START:STOP:COUNT, evenly spaced, or with suffix :log by equal factors; whether it has :log.

    Raises
    ------
    InputError : the text is no such range.
    """
    log = text.endswith(":log")
    numbers = _numbers(option, text.removesuffix(":log"))
    if len(numbers) != 3 or not all(math.isfinite(number) for number in numbers):
        raise InputError(f"{option} {text}: a range is START:STOP:COUNT or START:STOP:COUNT:log")
    low, high, count = numbers
    if count != int(count) or not 2 <= count <= 1_000_000:
        raise InputError(f"{option} {text}: COUNT = {count:g}: must be a whole number, 2 or more")
    if not low < high or (log and low <= 0):
        raise InputError(f"{option} {text}: START must be below STOP{' and above 0' if log else ''}")
    space = np.geomspace if log else np.linspace
    # Twelve digits, which print 0.3 and not 0.30000000000000004.
    return (low, high), [float(f"{value:.12g}") for value in space(low, high, int(count))], log


def parse_numbers(option: str, text: str) -> list[float]:
    """Numbers separated by commas, or a range.

    Raises
    ------
    InputError : the text is neither.
    """
    if ":" in text:
        return parse_range(option, text)[1]
    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        numbers = [math.nan]
    if not all(math.isfinite(number) for number in numbers):
        raise InputError(f"{option} {text}: must be numbers separated by commas, or START:STOP:COUNT")
    return numbers


def _file(kind: str, name: str, search: Sequence[Path]) -> tuple[str, dict[str, Any]]:
    """Label and table of a motor's or transmission's file, given by path, by name or by the start of a name."""
    known = {path.stem: path for folder in search for path in sorted((folder / f"{kind}s").glob("*.toml"))}
    matches = [name] if name in known else [stem for stem in known if stem.startswith(name)]
    if Path(name).suffix == ".toml":
        path = Path(name)
    elif name and len(matches) == 1:
        path = known[matches[0]]
    else:
        others = f" or one of {', '.join(known)}" if known else ""
        why = "several files begin so" if matches else f"no such file{did_you_mean(name, known)}"
        raise InputError(f"{kind} = {name}: {why}; give the path of a .toml file{others}")
    return path.stem, read_section(path, FILES[kind], f"a {kind} is a TOML file")[0].model_dump()


def parse_axis(scene: Scene, option: str, text: str, search: Sequence[Path] = ()) -> Axis:
    """Parse KEY=V1,V2,... or KEY=START:STOP:COUNT, with each value checked against the bounds of its key.

    Parameters
    ----------
    option : name of the option in messages.
    search : folders whose `motors/` and `transmissions/` hold the files that can be given by name.

    Raises
    ------
    InputError : one line: key, value, limit.
    """
    path, equals, values_text = (part.strip() for part in text.partition("="))
    if not equals or not values_text:
        raise InputError(f"{option} {text}: give KEY=V1,V2,... or KEY=START:STOP:COUNT")
    if path in FILES:
        found = [_file(path, name.strip(), search) for name in values_text.split(",")]
        axis = Axis(path, tuple(table for _, table in found), tuple(stem for stem, _ in found))
    else:
        key = find_key(scene, path)
        if path.startswith("grid."):
            option_of = {"grid.speeds_m_s": "--speed", "grid.grips_N": "--grip"}.get(path)
            instead = f"; give them with {option_of}" if option_of else ""
            raise InputError(f"{path}: the grid is what every point is solved at, not a key that is varied{instead}")
        limits, log = None, False
        if ":" in values_text and key.number:
            limits, numbers, log = parse_range(f"{option} {path} =", values_text)
            values: tuple[Any, ...] = tuple(round(number) if key.integer else number for number in numbers)
        elif key.number and (ends := re.fullmatch(_SPAN, values_text)) is not None:
            raise InputError(
                f"{option} {path}={values_text}: a range is START:STOP:COUNT: write {path}={ends[1]}:{ends[2]}:5 "
                f"for five values, or the values themselves, as {path}={ends[1]},{ends[2]}"
            )
        else:
            values = tuple(parse_value(key, part) for part in values_text.split(","))
        axis = Axis(path, values, tuple(label(value) for value in values), limits, log)
    if len(set(axis.labels)) < len(axis.labels):
        raise InputError(f"{option} {text}: a value stands there twice")
    for value in axis.values:
        if scene.implausible == "refuse":
            check_plausible(option, {path: value})
        if not isinstance(value, dict):
            check_value(scene, path, value)
    return axis


def apply_settings(scene: Scene, settings: Sequence[str], search: Sequence[Path] = ()) -> Scene:
    """The scene with keys set for all points, KEY=VALUE each; `search` as in `parse_axis`.

    Raises
    ------
    InputError : one line: key, value, limit.
    """
    changes: dict[str, Any] = {}
    for text in settings:
        axis = parse_axis(scene, "--set", text, search)
        if len(axis.values) != 1:
            raise InputError(f"--set {text}: one value; --vary takes several")
        changes[axis.key] = axis.values[0]
    return with_values(scene, changes)
