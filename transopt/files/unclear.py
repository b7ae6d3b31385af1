"""Facts that a file does not state, and the answers to try.

An answer holds what a user would state: settings of `[recordings]` by their keys. A command tries the answers on the
file and asks, or proposes those with which the file can be read (`transopt.cli.questions`); none is applied unasked.
"""

import itertools
import shlex
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from transopt.base.errors import InputError
from transopt.base.signals import FloatArray
from transopt.base.toml import toml_value
from transopt.files.names import MOST_CHOICES, quote
from transopt.files.units import UNITS, likely_units

Answer = Mapping[str, Any]
# Key of an answer -> command-line option, if its name differs from the key.
OPTIONS = {
    "speed_m_s": "speed",
    "grip_N": "grip",
    "full_scale_m_s2": "full-scale",
    "taps_by_file": "tap",
    "implausible": "accept",
}
RATES_HZ = (10_000.0, 1000.0, 3200.0, 44_100.0, 48_000.0, 25_600.0, 51_200.0, 100_000.0, 1e6)
STEPS_S = (1e-7, 0.02)  # time steps of a column that may hold the times of a tap
STEADY = 0.5  # mean deviation of such a column's steps from the median step, relative
LEAST_COUNTS = 50  # least span of a tap in converter counts; a few whole numbers may be anything
MOST_COLUMNS = 3  # columns offered as the acceleration, that with the highest crest first


class UnclearError(InputError):
    """A file does not state a fact that is needed.

    Attributes
    ----------
    problem : what is unknown, one sentence.
    answers : possible values of the fact, at least one; the likeliest first.
    file : the file; None until the reader's caller adds its name.
    """

    def __init__(self, problem: str, answers: Sequence[Answer], file: Path | None = None) -> None:
        super().__init__(printable(f"{shown_path(file)}{problem}; state it, for example {proposal(answers[0])}"))
        self.problem, self.answers, self.file = problem, tuple(answers), file

    def __reduce__(self) -> tuple[type["UnclearError"], tuple[object, ...]]:
        return UnclearError, (self.problem, self.answers, self.file)


def printable(text: str) -> str:
    """One line, with escapes for unprintable characters, which column names may contain and a terminal might obey."""
    return "".join(c if c.isprintable() else ascii(c)[1:-1] for c in text)


def shown_path(file: Path | None) -> str:
    """Prefix of a message with the file's name, escaped if it does not fit on one line."""
    if file is None:
        return ""
    return f"{file if str(file).isprintable() else repr(str(file))}: "


@contextmanager
def in_file(file: Path) -> Iterator[None]:
    """Put the file's name in front of every error of the block."""
    try:
        yield
    except UnclearError as error:
        raise UnclearError(error.problem, error.answers, file) from error
    except InputError as error:
        raise InputError(f"{shown_path(file)}{error}") from error


def joined(stated: Answer, more: Answer) -> dict[str, Any]:
    """The stated settings merged with an answer, which has precedence; units are merged column by column."""
    units = {**(stated.get("units") or {}), **more.get("units", {})}
    return {**stated, **more, **({"units": units} if units else {})}


def option_of(key: str) -> str:
    """The command-line option of a setting."""
    return f"--{OPTIONS.get(key, key).replace('_', '-')}"


def options(answer: Answer) -> str:
    """The command-line options that state an answer."""
    return " ".join(_options(answer))


def _options(answer: Answer) -> Iterator[str]:
    for key, value in answer.items():
        match key:
            case "implausible":
                yield option_of(key)
            case "units":
                stated = ",".join(f"{name}={unit}" for name, unit in value.items())
                yield f"{option_of(key)} {shlex.quote(stated)}"
            case "columns":
                yield f"{option_of(key)} {shlex.quote(','.join(value))}"
            case _:
                yield f"{option_of(key)} {value:.12g}" if isinstance(value, float) else f"{option_of(key)} {value}"


def proposal(answer: Answer) -> str:
    """An answer as command-line options and as keys of a scene."""
    return f"{options(answer)} (in a scene {keys(answer)})"


def keys(answer: Answer) -> str:
    """The keys of a scene that state an answer."""
    return ", ".join(f"recordings.{key} = {toml_value(value)}" for key, value in answer.items())


def chosen_channel(channel: int | None, labels: Sequence[str], what: str) -> int:
    """Index of the channel that the user states, or of the only one.

    Parameters
    ----------
    channel : counted from 1; None if the user states none.
    labels : what the file says of each channel, empty for nothing.
    what : name of the channels in messages, in the plural.

    Raises
    ------
    InputError : the file does not have this channel.
    UnclearError : it has several, and none is stated.
    """
    count = len(labels)
    if channel is None and count > 1:
        listed = ", ".join(f"{k} {quote(label)}" for k, label in enumerate(labels[:MOST_CHOICES], 1) if label)
        raise UnclearError(
            f"{count} {what}, and which is the acceleration's is not stated{listed and f': {listed}'}",
            [{"channel": k + 1} for k in range(min(count, MOST_CHOICES))],
        )
    if channel is not None and not 1 <= channel <= count:
        raise InputError(f"--channel {channel}: the file has {count} {what}; choose 1 to {count}")
    return (channel or 1) - 1


def guesses(
    table: Mapping[str, FloatArray], units: Sequence[str], *, is_named: bool, needs_time: bool = True
) -> list[Answer]:
    """Possible choices of the times and the acceleration of a tap among columns of numbers, with their units.

    Parameters
    ----------
    table : name or number of a column -> (n,) numbers, NaN where a cell is no number.
    units : possible units of the acceleration; empty if it is known already.
    is_named : whether units can be stated by the columns' names; if not, names and units are stated for all columns.
    needs_time : whether no column is known to hold the times.
    """
    steady = [name for name, values in table.items() if _rises(values)] if needs_time else []
    loud = {name: _crest(values) for name, values in table.items() if name not in steady and _crest(values) > 0}
    loudest = sorted(loud, key=lambda name: -loud[name])[:MOST_COLUMNS]
    found: list[Answer] = []
    # A row counter also rises steadily: a column that rises by one is the time only if no other rises.
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
                    heads = {time: f"time [{unit}]", name: f"acc [{of}]"}
                    found.append({"columns": [heads.get(each, "-") for each in table]})
    return found


def usual_first(units: Sequence[str], values: FloatArray) -> list[str]:
    """The units, with converter counts first if the column (n,) holds whole numbers over a wide span."""
    is_whole = bool(values.size and np.ptp(values) > LEAST_COUNTS and np.all(values == np.rint(values)))
    return sorted(units, key=lambda unit: is_whole and "LSB" not in unit)


def times_in(values: FloatArray) -> list[str]:
    """Units in which a column (n,) could be the times of a tap."""
    step = float(np.median(np.diff(values))) if values.size > 1 else 0.0
    return [unit for unit in likely_units("time") if STEPS_S[0] <= UNITS["time"][unit] * step <= STEPS_S[1]]


def _rises(values: FloatArray) -> bool:
    steps = np.diff(values)
    return bool(values.size > 1 and np.all(steps > 0) and np.mean(np.abs(steps / np.median(steps) - 1)) < STEADY)


def _crest(values: FloatArray) -> float:
    """Deviation of the highest peak over the standard deviation; 0 for a constant or non-finite column."""
    if values.size == 0 or not np.isfinite(values).all() or np.ptp(values) == 0:
        return 0.0
    away = values - np.median(values)
    return float(np.abs(away).max() / np.std(values))
