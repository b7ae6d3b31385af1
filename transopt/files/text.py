"""Recordings as text: remarks, names, units and rows of numbers, as scopes, loggers and spreadsheets write them."""

import math
import re
from array import array
from collections.abc import Mapping, Sequence
from contextlib import suppress

import numpy as np
import scipy

from transopt.base.errors import InputError
from transopt.base.signals import FloatArray
from transopt.files.meanings import meanings, one_clock
from transopt.files.names import SKIPPED, Layout, Vocabulary, apart, labelled, quote, spared, with_axes
from transopt.files.raw_table import MIN_SAMPLES, RawTable
from transopt.files.statements import Rate, rate_of
from transopt.files.text_rows import cells_of, delimiter_of, filled, parted_text, with_points
from transopt.files.unclear import UnclearError, guesses
from transopt.files.units import likely_units

_TIME_OF_DAY = re.compile(r"(?:(?P<hours>\d{1,2}):)?(?P<minutes>\d{1,2}):(?P<s>\d{1,2}(?:[.,:]\d+)?)(?!\d)")
HALF_A_DAY_S = 43200.0
_DATE = re.compile(r"\d:\d|\d-\d+-\d|\d/\d+/\d|\d\.\d+\.\d")


def text_columns(data: bytes, words: Vocabulary) -> dict[str, FloatArray]:
    """The numeric columns of a text, by their names or numbers."""
    text = parted_text(data, words)
    width = len(cells_of(text.rows[0])) if text.rows else 0
    return _seen(text.rows, text.names or [f"column {at + 1}" for at in range(width)])


def read_text(data: bytes, layout: Layout, words: Vocabulary) -> tuple[RawTable, Rate | None]:
    """Read remarks, at most one row of names and one of units, and rows of numbers; rows count as in an editor.

    Returns
    -------
    The columns, and the sample rate that the file states in place of a column of times.
    """
    rows, numbers, found, header, head, told, footer = parted_text(data, words, len(layout.columns))
    if not rows and not (layout.columns or found):
        raise InputError(f"no rows of numbers, at least {MIN_SAMPLES} are needed; record or export it again")
    if not (layout.columns or found):
        raise _nameless(rows, numbers, words)
    units = layout.units or {}
    names = untimed(_chosen(layout.columns, found, words) if layout.columns else found, layout, words)
    for k, (name, cell) in enumerate(zip(names, cells_of(rows[0]) if rows else [], strict=False)):
        if not cell and words.quantity_of(name) == "time":
            names[k] = SKIPPED  # a column of times without cells, as in LabVIEW's text
    words = words.labelled(names)
    at, clock = _clock_of(rows, names, layout, words)
    if clock is not None:
        names[at] = "time_s"  # overrides what the user or the file states about a time of day
    rate = rate_of(head, told) if "time" in words.absent(names) else None
    if rate is not None:
        words = words.without_times()
    notes = list[str]()
    if empty := len(data) - len(filled(data)):
        notes.append(f"{empty} bytes at the end, zeros that a logger has not written over, are left out")
    if footer:
        notes.append(f"what stands below the numbers from {quote(footer[0])} on is left out")
    if not layout.columns:
        names = one_clock(names, words, units, lambda k: _column(rows, k), notes)
        names = spared(names, words, notes)
    known = meanings(names, words, units, seen=lambda: _seen(rows, names))
    if clock is not None and names[at] == SKIPPED:
        clock = None
    columns, blanks = _parse(
        rows, numbers, [SKIPPED if clock is not None and k == at else n for k, n in enumerate(names)]
    )
    if clock is not None:
        columns = {"time_s": clock, **columns}
    for name, stride in _fill(columns, blanks, numbers).items():
        notes.append(f"{name} stands in one row of {stride} only, and is interpolated between them")
    return RawTable(columns, known, header, lambda k: f"row {numbers[k]}", tuple(notes)), rate


def _nameless(rows: Sequence[str], numbers: Sequence[int], words: Vocabulary) -> UnclearError:
    """The question about the meaning of columns without names."""
    places = [str(at) for at in range(len(cells_of(rows[0])))]
    problem = f"row {numbers[0]}: {quote(rows[0])} has no row of names above it"
    seen = _seen(rows, places) if "acceleration" in words.quantities else {}
    answers = guesses(seen, likely_units("acceleration"), is_named=False)
    return UnclearError(problem, answers or [{"columns": ["time_s", "acceleration_g"]}])


def _seen(rows: Sequence[str], names: Sequence[str]) -> dict[str, FloatArray]:
    """The columns as numbers, to propose answers; NaN where a column is not numeric."""
    wanted = {at: name for at, name in enumerate(names) if name != SKIPPED}
    with suppress(InputError):  # all columns at once, if all are numbers
        table, _ = _parse(rows, range(len(rows)), [str(at) for at in range(len(names))])
        return {name: table[str(at)] for at, name in wanted.items()}
    return {name: _column(rows, at) for at, name in wanted.items()}


def _column(rows: Sequence[str], at: int) -> FloatArray:
    """One column (n,) of numbers, or of the seconds of its times of day; NaN if it holds neither."""
    if (times := _clocked(rows, at)) is not None:
        return times
    parted = [cells for row in rows if len(cells := with_points(cells_of(row))) > at]
    with suppress(ValueError):
        return np.array([float(cells[at]) for cells in parted])
    return np.full(len(parted), np.nan)


def _clock_of(
    rows: Sequence[str], names: Sequence[str], layout: Layout, words: Vocabulary
) -> tuple[int, FloatArray | None]:
    """Index and seconds of a column of dates or times of day: one that means the time, or has no known meaning."""
    if layout.rate_Hz or "time" not in words.required:
        return 0, None
    timed = [at for at, name in enumerate(names) if name != SKIPPED and words.quantity_of(name) == "time"]
    for at in timed or [at for at, name in enumerate(names) if name != SKIPPED and words.quantity_of(name) is None]:
        if (times := _clocked(rows, at)) is not None:
            return at, times
    return 0, None


def _clocked(rows: Sequence[str], at: int) -> FloatArray | None:
    """Seconds since the first row (n,) of a column of dates or times of day; None if it holds none.

    Times are unwrapped by half a day: a clock of twelve hours restarts after it, and no two rows are further apart.
    """
    times = list[float]()
    for row in rows:
        cell = row.split(delimiter_of(row))[at : at + 1]
        clock = _TIME_OF_DAY.search(cell[0]) if cell and _DATE.search(cell[0]) else None
        if clock is None:
            return None
        minutes = 60.0 * float(clock["hours"] or 0) + float(clock["minutes"])
        times.append(60.0 * minutes + float(re.sub("[,:]", ".", clock["s"])))
    if not times:
        return None
    return np.asarray(np.unwrap(np.array(times) - times[0], period=HALF_A_DAY_S))


def _chosen(columns: Sequence[str], found: Sequence[str], words: Vocabulary) -> list[str]:
    """The column names that the user states, each with the file's unit where the user states none."""
    columns = with_axes(columns)
    if len(columns) != len(found):
        return list(columns)
    units = [apart(name)[1] for name in found]
    return [
        labelled(name, unit) if words.quantity_of(name) is not None and not apart(name)[1] else name
        for name, unit in zip(columns, units, strict=True)
    ]


def untimed(names: Sequence[str], layout: Layout, words: Vocabulary) -> list[str]:
    """The names, with columns of times skipped if the user states the rate: they may be dates, or repeat."""
    return [SKIPPED if layout.rate_Hz and words.quantity_of(name) == "time" else name for name in names]


def _parse(
    rows: Sequence[str], numbers: Sequence[int], names: Sequence[str]
) -> tuple[dict[str, FloatArray], dict[str, list[int]]]:
    """Columns (n,) of the rows' numbers, and for each column its blank rows; skipped columns may hold anything.

    Parameters
    ----------
    numbers : row numbers in the file, for messages.
    """
    used = {name: at for at, name in enumerate(names) if name != SKIPPED}
    delimiter = delimiter_of(rows[0]) if rows else None
    if rows and len(used) == len(names) and delimiter != ";":
        # Fast path for purely numeric rows; the loop below handles others and says what is wrong where.
        with suppress(ValueError):
            table = np.loadtxt(rows, delimiter=delimiter, comments=None, ndmin=2)
            if table.shape[1] == len(names):
                return {name: table[:, at].copy() for name, at in used.items()}, {}
    columns, blanks = {name: array("d") for name in used}, dict[str, list[int]]()
    for row, (number, line) in enumerate(zip(numbers, rows, strict=True)):
        # Between semicolons or tabs, a comma can only be a decimal comma.
        cells = line.split(delimiter, len(names) + 1)
        if delimiter in (";", "\t") and "," in line:
            cells = with_points(cells, f"row {number}")
        if not "".join(cells[len(names) :]).strip(" ;,\t"):
            del cells[len(names) :]  # spreadsheets end every row with delimiters if one row needs them
        if len(cells) < len(names) and set(names[len(cells) :]) == {SKIPPED}:
            cells += [""] * (len(names) - len(cells))  # a column without cells, such as comments
        if len(cells) != len(names):
            listed = quote(", ".join(names))
            remedy = "correct the row or the columns' names (decimal commas? write points)"
            count = len(cells) if len(cells) < len(names) + 2 else f"{len(cells)} or more"
            raise InputError(f"row {number}: {count} cells, {len(names)} columns ({listed}); {remedy}")
        for name, at in used.items():
            if not cells[at].strip():
                blanks.setdefault(name, []).append(row)
                columns[name].append(math.nan)
                continue
            try:
                columns[name].append(float(cells[at]))
            except ValueError:
                remedy = "write decimal points" if "," in cells[at] else "correct it, or put # before a remark"
                problem = f"{quote(cells[at])} is no number"
                raise InputError(f"row {number}, column {name}: {problem}; {remedy}") from None
    return {name: np.array(values, dtype=float) for name, values in columns.items()}, blanks


def _fill(
    columns: dict[str, FloatArray], blanks: Mapping[str, Sequence[int]], numbers: "array[int]"
) -> dict[str, int]:
    """Interpolate channels recorded at a lower rate than the others, which leave regular blanks.

    Rows before the first and after the last value of such a channel are removed, because it is unknown there. Other
    blanks stay NaN, as samples that were lost.

    Parameters
    ----------
    columns, numbers : are modified.

    Returns
    -------
    Name of the channel -> number of rows from one of its values to the next.
    """
    strides, first, end = dict[str, int](), 0, len(numbers)
    for name, rows in blanks.items():
        have = np.setdiff1d(np.arange(len(numbers)), rows)
        steps = np.unique(np.diff(have))
        ends = max(have[0], len(numbers) - 1 - have[-1]) if have.size else 0
        if have.size < MIN_SAMPLES or steps.size != 1 or ends >= steps[0]:
            continue
        strides[name], first, end = int(steps[0]), max(first, int(have[0])), min(end, int(have[-1]) + 1)
        spline = scipy.interpolate.CubicSpline(have, columns[name][have])
        columns[name] = np.asarray(spline(np.arange(len(numbers))))
    if strides:
        columns.update({name: values[first:end] for name, values in columns.items()})
        del numbers[:first]
    return strides
