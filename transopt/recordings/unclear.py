"""What a file leaves open: a fact that it does not state, and the answers that may be tried on it.

An answer holds what a user would have stated: settings of `[recordings]` by their keys. A command tries the answers
on the file and asks, or proposes those that read it (`transopt.cli.questions`); nothing here is taken by itself.
"""

import itertools
import json
import shlex
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from transopt.base.errors import InputError
from transopt.base.signals import FloatArray
from transopt.recordings.units import UNITS, likely_units

Answer = Mapping[str, Any]
# Key of an answer -> option of a command line, where its name is not the key's.
OPTIONS = {
    "speed_m_s": "speed",
    "grip_N": "grip",
    "full_scale_m_s2": "full-scale",
    "taps_by_file": "tap",
    "implausible": "accept",
}
RATES_HZ = (10_000.0, 1000.0, 3200.0, 44_100.0, 48_000.0, 25_600.0, 51_200.0, 100_000.0, 1e6)
STEPS_S = (1e-7, 0.02)  # of a column that may hold the times of a tap
STEADY = 0.5  # of the median step: the most that a step of such a column differs in the mean
LEAST_COUNTS = 50  # that a tap makes in a converter; a few whole numbers may be anything
MOST_COLUMNS = 3  # that may be the acceleration, the one with the highest peak first


class UnclearError(InputError):
    """A file leaves a fact open.

    Attributes
    ----------
    problem : what is not known, one sentence.
    answers : what the fact may be, at least one; the likeliest first.
    file : where it is not known; None as long as the reader does not know its name.
    """

    def __init__(self, problem: str, answers: Sequence[Answer], file: Path | None = None) -> None:
        super().__init__(printable(f"{shown_path(file)}{problem}; state it, for example {proposal(answers[0])}"))
        self.problem, self.answers, self.file = problem, tuple(answers), file

    def __reduce__(self) -> tuple[type["UnclearError"], tuple[object, ...]]:
        return UnclearError, (self.problem, self.answers, self.file)


def printable(text: str) -> str:
    """One line, with an escape in place of what a terminal might obey: names of columns may be anything."""
    return "".join(c if c.isprintable() else ascii(c)[1:-1] for c in text)


def shown_path(file: Path | None) -> str:
    """The beginning of a message about a file: a message is one line, a file's name need not be."""
    if file is None:
        return ""
    return f"{file if str(file).isprintable() else repr(str(file))}: "


def located(error: InputError, file: Path) -> InputError:
    """The error with the file's name in front."""
    if isinstance(error, UnclearError):
        return UnclearError(error.problem, error.answers, file)
    return InputError(f"{shown_path(file)}{error}")


def joined(stated: Answer, more: Answer) -> dict[str, Any]:
    """What is stated with an answer, which goes before it; units are stated column by column."""
    units = {**(stated.get("units") or {}), **more.get("units", {})}
    return {**stated, **more, **({"units": units} if units else {})}


def option_of(key: str) -> str:
    """The option by which a command line states a setting."""
    return f"--{OPTIONS.get(key, key).replace('_', '-')}"


def options(answer: Answer) -> str:
    """The options of a command line that state an answer."""
    return " ".join(_options(answer))


def _options(answer: Answer) -> Iterator[str]:
    for key, value in answer.items():
        match key:
            case "implausible":
                yield option_of(key)
            case "units":
                said = ",".join(f"{name}={unit}" for name, unit in value.items())
                yield f"{option_of(key)} {shlex.quote(said)}"
            case "columns":
                yield f"{option_of(key)} {shlex.quote(','.join(value))}"
            case _:
                yield f"{option_of(key)} {value:.12g}" if isinstance(value, float) else f"{option_of(key)} {value}"


def proposal(answer: Answer) -> str:
    """An answer as a command line and as a scene states it."""
    return f"{options(answer)} (in a scene {keys(answer)})"


def keys(answer: Answer) -> str:
    """The keys of a scene that state an answer."""
    return ", ".join(f"recordings.{key} = {toml(value)}" for key, value in answer.items())


def toml(value: object) -> str:
    """A value as TOML spells it: as JSON, but for the pairs of a table."""
    if isinstance(value, Mapping):
        # A key of letters, figures and the like needs no quotes.
        pairs = (
            (key if key.replace("_", "").isalnum() and key.isascii() else json.dumps(key), one)
            for key, one in value.items()
        )
        return f"{{ {', '.join(f'{key} = {toml(one)}' for key, one in pairs)} }}"
    return json.dumps(value)


def guesses(
    table: Mapping[str, FloatArray], units: Sequence[str], *, is_named: bool, needs_time: bool = True
) -> list[Answer]:
    """Which columns of numbers may be the times and the acceleration of a tap, with their units.

    Parameters
    ----------
    table : name of a column, or its place -> (n,) numbers, NaN for what is none.
    units : that the acceleration may be in; none where it is known already.
    is_named : whether units may be stated by the columns' names; if not, names and units are stated for all.
    needs_time : whether no column is known to hold the times.
    """
    steady = [name for name, values in table.items() if _rises(values)] if needs_time else []
    loud = {name: _crest(values) for name, values in table.items() if name not in steady and _crest(values) > 0}
    loudest = sorted(loud, key=lambda name: -loud[name])[:MOST_COLUMNS]
    found: list[Answer] = []
    # Rows are counted as well as timed: what rises by one is the time only where nothing else is.
    timed = [name for name in steady if np.ptp(np.diff(table[name])) > 0 or np.diff(table[name])[0] != 1]
    for time in timed or steady or [""]:
        of_time = times_in(table[time]) if time else [""]
        if time and not units:
            found += [{"units": {time: unit}} for unit in of_time]
        for name, unit in itertools.product(loudest, of_time):
            for of in usual_first(units, table[name]):
                if is_named:
                    found.append({"units": {**({time: unit} if time else {}), name: of}})
                else:
                    said = {time: f"time [{unit}]", name: f"acc [{of}]"}
                    found.append({"columns": [said.get(each, "-") for each in table]})
    return found


def usual_first(units: Sequence[str], values: FloatArray) -> list[str]:
    """Units that a column (n,) may be in: whole numbers are counts of a converter sooner than accelerations."""
    is_whole = bool(values.size and np.ptp(values) > LEAST_COUNTS and np.all(values == np.rint(values)))
    return sorted(units, key=lambda unit: is_whole and "LSB" not in unit)


def times_in(values: FloatArray) -> list[str]:
    """Units in which a column (n,) may hold the times of a tap."""
    step = float(np.median(np.diff(values))) if values.size > 1 else 0.0
    return [unit for unit in likely_units("time") if STEPS_S[0] <= UNITS["time"][unit] * step <= STEPS_S[1]]


def _rises(values: FloatArray) -> bool:
    steps = np.diff(values)
    return bool(values.size > 1 and np.all(steps > 0) and np.mean(np.abs(steps / np.median(steps) - 1)) < STEADY)


def _crest(values: FloatArray) -> float:
    """How far the highest peak stands out of a column; 0 of one that is constant, or holds what is no number."""
    if values.size == 0 or not np.isfinite(values).all() or np.ptp(values) == 0:
        return 0.0
    away = values - np.median(values)
    return float(np.abs(away).max() / np.std(values))
