"""Recordings as text: remarks, names, units and rows of numbers as scopes, loggers and spreadsheets write them."""

import codecs
import io
import math
import re
from array import array
from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace

import numpy as np
import scipy

from transopt.base.errors import InputError
from transopt.base.signals import FloatArray
from transopt.base.sizes import MOST_COLUMNS, MOST_IN_A_ROW
from transopt.recordings.names import (
    SKIPPED,
    Layout,
    Vocabulary,
    apart,
    looks_known,
    meanings,
    means_time,
    quote,
    spared,
    split_names,
)
from transopt.recordings.raw_table import MIN_SAMPLES, RawTable, check_size, without_times
from transopt.recordings.units import is_unit, read_unit

_REMARKS = ("#", "*", "%", "//")
_HEADER_LINE = re.compile(r"(?:[#*%]|//)\s*([A-Za-z]\w*)\s*[:=]\s*(.*)")
_UNIT_CELL = re.compile(r"[\[(]([^\[\]()]+)[\])]")
_METADATA = re.compile(r"([A-Za-z]\w*)\s*[:=,;\t]\s*(.*)")
_QUOTED = re.compile(r'"([^"]*)"')
_LAST_ROWS = 20  # of a file, which show how its rows are divided
_DECIMAL_COMMA = re.compile(r"[-+]?\d*,\d+([eE][-+]?\d+)?")  # no other comma stands in a single number
_HEAD = 65536  # bytes in which a file's units stand, and which tell how it is stored
_ZERO_BYTES = 0.4  # of every second byte: more are zero in UTF-16, whose other bytes are hardly ever
_CODE_PAGES = ("cp1252", "cp850", "mac_roman")  # Windows, its console and DOS, Mac OS before X: western Europe
_CONTROLS = "".join(map(chr, [*range(9), *range(14, 26), *range(28, 32)]))  # which no text in a code page has
_BEYOND_ASCII = re.compile(r"[^\s,;:\"()\[\]{}]*[^\x00-\x7f\s][^\s,;:\"()\[\]{}]*")
_NUMBER = re.compile(r"[-+]?(\d+[.,]?\d*|[.,]\d+)([eE][-+]?\d+)?|")  # or an empty cell
_STAMP = re.compile(r"[-+]?(nan|inf)|[-+\d.,:/TZE ]+", re.IGNORECASE)  # a number, a date or a time of day
_DATE = re.compile(r"\d:\d|\d-\d+-\d|\d/\d+/\d|\d\.\d+\.\d")
# What a number in a file's head is preceded and followed by: a unit in brackets or none, a mark, and a unit or none.
_VALUE = (
    r"\s*(?:[\[(]\s*(?P<before>[a-zµ/]+)\s*[\])])?\s*[:=,;\t ]\s*(?P<number>\d+(?:[.,]\d+)?(?:e[-+]?\d+)?)"
    r"\s*(?P<behind>[a-zµ]+(?:/s)?)?(?![\w.])"
)
_RATE = re.compile(r"\b(?:sampl\w*[ _]*(?:rate|freq\w*)|rate|fs)" + _VALUE, re.IGNORECASE)
_STEP = re.compile(
    r"\b(?:delta[ _]?[xt]|(?:x[ _])?increment|sampl\w*[ _]*(?:interval|period))" + _VALUE, re.IGNORECASE
)
_START = re.compile(r"(?:start|x[ _]?0|t[ _]?0)\w*: *([-+]?\d+(?:\.\d*)?(?:e[-+]?\d+)?)", re.IGNORECASE)
_NUMBER_START = re.compile(r"[-+.]*\d|[-+]?(nan|inf)", re.IGNORECASE)


def read_text(data: bytes, layout: Layout, words: Vocabulary) -> RawTable:
    """Remarks, at most one row of names and one of units, rows of numbers; counted as an editor counts them."""
    header: dict[str, object] = {}
    rows, numbers, remark = _lines(data, header, words)
    if not rows:
        raise InputError(f"no rows of numbers, at least {MIN_SAMPLES} are needed; record or export it again")
    start = _first_of_numbers(rows)
    above, first = rows[:start], rows[min(start, len(rows) - 1)]
    if (
        max(len(layout.columns), *(len(row.split(mark)) for row in (first, *above[-2:]) for mark in ";,\t"))
        > MOST_COLUMNS
    ):
        raise InputError(f"row {numbers[0]}: more than {MOST_COLUMNS} columns; export the ones that are needed")
    told = list[str]()
    if above:
        found = _names_above(above, header, words, told)
    else:
        found = split_names(remark.lstrip("".join(_REMARKS) + " "))
        if len(found) != len(_cells(first)) or not any(looks_known(name, words) for name in found):
            found = []
    if not (layout.columns or found):
        need = 'name them: --columns time_s,acceleration_g (in a scene recordings.columns), "-" skips one'
        raise InputError(f"row {numbers[0]}: {quote(first)} has no row of names above it; {need}")
    names, idle = (_chosen(layout.columns, found, words), "") if layout.columns else (found, "")
    names = untimed(names, layout, words)
    if layout.rate_Hz is None and "time" in words.required and not any(means_time(name, words) for name in names):
        head = data[:_HEAD].decode(encoding_of(data), errors="ignore").splitlines()[: numbers[0] - 1 + start]
        if rate := _rate_of([*head, *told]):
            start_s = next((float(at[1]) for line in told if (at := _START.fullmatch(line))), 0.0)
            raw = read_text(data, replace(layout, rate_Hz=rate[0]), without_times(words))
            note = (
                f"no column of times; the sample rate of {rate[0]:g} Hz is that of the file's line {quote(rate[1])}"
            )
            return raw.timed(1 / rate[0], start_s, note)
    if not layout.columns:
        names, idle = spared(names, words)
    del rows[:start], numbers[:start]
    for name, cell in zip(names, _cells(first), strict=False):
        if rows and means_time(name, words) and _DATE.search(cell):
            raise InputError(
                f"row {numbers[0]}, column {name}: {quote(cell)} is a date or a time of day, no number; state the "
                "sample rate instead, --rate-Hz 10000 where it is 10 kHz (in a scene recordings.rate_Hz)"
            )
    known = meanings(names, words, layout.units or {})
    columns, blanks = _parse(rows, numbers, names)
    for name, stride in _fill(columns, blanks, numbers).items():
        note = f"{name} stands in one row of {stride} only, and is interpolated between them"
        known[name] = known[name]._replace(note="; ".join(filter(None, [known[name].note, note])))
    if idle:
        last = list(known)[-1]
        known[last] = known[last]._replace(note="; ".join(filter(None, [known[last].note, idle])))
    return RawTable(columns, known, header, lambda k: f"row {numbers[k]}")


def _chosen(columns: Sequence[str], found: Sequence[str], words: Vocabulary) -> list[str]:
    """The columns as a user names them; where that leaves the unit out, it is the one in the file."""
    if len(columns) != len(found):
        return list(columns)
    units = [apart(name)[1] for name in found]
    return [
        f"{name} [{unit}]" if unit and looks_known(name, words) and not apart(name)[1] else name
        for name, unit in zip(columns, units, strict=True)
    ]


def _rate_of(lines: Sequence[str]) -> tuple[float, str] | None:
    """Sample rate [Hz] that a file's head states, and the line; None where none or more than one is stated."""
    rates: list[tuple[float, str]] = []
    for line in lines:
        for pattern, quantity, default in ((_RATE, "frequency", "Hz"), (_STEP, "time", "s")):
            for found in pattern.finditer(line.replace('"', "")):
                unit = (found["before"] or found["behind"] or default).replace("S/s", "Hz")
                factor, number = read_unit(unit, quantity), float(found["number"].replace(",", "."))
                if factor is not None and number > 0:
                    value = factor.factor * number
                    rates.append((value if quantity == "frequency" else 1 / value, line.strip()))
    return rates[0] if rates and all(math.isclose(rate, rates[0][0], rel_tol=1e-6) for rate, _ in rates) else None


def untimed(names: Sequence[str], layout: Layout, words: Vocabulary) -> list[str]:
    """Names of columns, those of times skipped where a user states the rate: they may be dates, or repeat."""
    return [SKIPPED if layout.rate_Hz and means_time(name, words) else name for name in names]


def _lines(data: bytes, header: dict[str, object], words: Vocabulary) -> tuple[list[str], "array[int]", str]:
    """Lines that are neither empty nor remarks, their numbers in the file, and the last remark above them.

    Parameters
    ----------
    header : takes what remarks state.
    """
    remark = ""
    rows, numbers = list[str](), array("l")  # by the million: no object more than there must be
    check_size(max(data.count(b"\n"), data.count(b"\r")))
    for number, line in enumerate(io.TextIOWrapper(io.BytesIO(data), encoding_of(data), newline=None), 1):
        if len(line) > MOST_IN_A_ROW:
            remedy = "put one sample in a row, and only the columns that are needed; shorten a remark"
            raise InputError(f"row {number}: {len(line)} characters, at most {MOST_IN_A_ROW}; {remedy}")
        content = (_QUOTED.sub(_unquoted, line).replace('"', "") if '"' in line else line).strip()
        if number == 1 and content.lower().startswith("sep="):
            continue  # a spreadsheet's own note about its delimiter
        if content.startswith(_REMARKS):
            _read_header_line(number, content, header, words)
            remark = remark if rows else content
        elif content:
            rows.append(content)
            numbers.append(number)
    return rows, numbers, remark


def _unquoted(cell: re.Match[str]) -> str:
    """What a spreadsheet has put in quotes; a comma in a cell is a decimal one, or part of a name."""
    inside = cell[1].strip()
    if cell[0] == cell.string.strip():
        return inside  # a whole row
    return inside.replace(",", "." if _DECIMAL_COMMA.fullmatch(inside) else " ")


def _cells(row: str) -> list[str]:
    return [cell.strip() for cell in row.split(_delimiter(row), MOST_COLUMNS)]


def _first_of_numbers(rows: Sequence[str]) -> int:
    """Place of the first row of numbers: it begins with one, and is divided as the last rows are or has no words.

    Names, units and what an instrument notes about a record stand above it. Where no row is such a one, the first
    that has a number anywhere counts.
    """
    usual = Counter((_delimiter(row), len(_cells(row))) for row in rows[-_LAST_ROWS:]).most_common(1)[0][0]

    def is_first(row: str) -> bool:
        cells = _cells(row)
        wordless = len(cells) > 1 and all(map(_NUMBER.fullmatch, cells))
        return wordless or ((_delimiter(row), len(cells)) == usual and bool(_STAMP.fullmatch(cells[0])))

    has_number = (k for k, row in enumerate(rows) if any(map(_NUMBER_START.match, _cells(row))))
    begins = (k for k, row in enumerate(rows) if _NUMBER_START.match(row) and is_first(row))
    return next(begins, next(has_number, len(rows)))


def _names_above(above: list[str], header: dict[str, object], words: Vocabulary, told: list[str]) -> list[str]:
    """Names and units of the columns, which end what stands above the numbers.

    Parameters
    ----------
    header : takes what the other rows state, as `speed_m_s,0.21`; an instrument states much else there.
    told : takes what a row of units states as a number below a name, `Increment: 1e-4`; such a column has no rows.
    """
    names, rest = split_names(above[-1]), above[:-1]
    heads = split_names(rest[-1]) if rest else []
    if len(heads) == len(names) and any(cell and _NUMBER.fullmatch(cell) for cell in names):
        told += [f"{name}: {cell}" for name, cell in zip(heads, names, strict=True) if _NUMBER.fullmatch(cell)]
        units = [cell if is_unit(cell) else "" for cell in names]
        names = [SKIPPED if _NUMBER.fullmatch(cell) else name for name, cell in zip(heads, names, strict=True)]
        names = [f"{name} [{unit}]" if unit else name for name, unit in zip(names, units, strict=True)]
        rest.pop()
    elif rest and (units := _units_of(names, len(heads))):
        names = [f"{name} [{unit}]" if unit else name for name, unit in zip(heads, units, strict=True)]
        rest.pop()
    for row in rest:
        found = _METADATA.fullmatch(row)
        if found and found[1] in words.header:
            header[found[1]] = _scalar(found[2])
    return names


def _units_of(cells: Sequence[str], columns: int) -> list[str]:
    """The units of a row below the names, in brackets or bare; nothing if the row has none."""
    inside = [found[1] for cell in cells if (found := _UNIT_CELL.fullmatch(cell))]
    units = inside if len(inside) == len(cells) else [cell for cell in cells if is_unit(cell)]
    return units if len(units) == len(cells) == columns else []


def encoding_of(data: bytes) -> str:
    """How the text of a file is stored: by its mark, by its pattern of zero bytes, as UTF-8, or in a code page.

    Code pages make different characters of the same bytes, and statistics of a few of them cannot tell the pages
    apart. The page under which a unit can be read is the file's.

    Raises
    ------
    InputError : bytes that no text holds.
    """
    pairs = data[: min(len(data), _HEAD) // 2 * 2]
    even, odd = (2 * pairs[k::2].count(0) / max(len(pairs), 1) for k in (0, 1))
    if data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        name = "utf-16"
    elif max(even, odd) > _ZERO_BYTES > min(even, odd):
        name = "utf-16-be" if even > odd else "utf-16-le"
    else:
        name = "utf-8-sig"
    bad = _undecodable(data, name.removesuffix("-sig"), "\0")
    if bad is None:
        return name
    pages = [page for page in _CODE_PAGES if _undecodable(data, page, _CONTROLS) is None]
    if name == "utf-8-sig" and not data.startswith(codecs.BOM_UTF8) and pages:
        return next((page for page in pages if _has_units(data[:_HEAD].decode(page))), pages[0])
    row = data.count(b"\n", 0, bad) + 1
    raise InputError(f"row {row}: byte 0x{data[bad]:02x} is not UTF-8 text; save it as UTF-8 text")


def _undecodable(data: bytes, name: str, controls: str) -> int | None:
    """Place of the first byte that an encoding does not know, or of a control character; None if all are known."""
    try:
        text = data.decode(name)
    except UnicodeDecodeError as error:
        return error.start
    places = [at for character in controls if (at := text.find(character)) >= 0]
    return min(places, default=None)


def _has_units(text: str) -> bool:
    """Whether a word with a sign beyond ASCII is a unit, or ends in one behind a stroke."""
    words = {word for found in _BEYOND_ASCII.findall(text) for word in (found, found.partition("/")[2])}
    return any(map(is_unit, words))


def _read_header_line(number: int, line: str, header: dict[str, object], words: Vocabulary) -> None:
    """Add `# key: value` to `header`; a comment that merely has a colon in it stays a comment."""
    found = _HEADER_LINE.fullmatch(line)
    key, value = found.groups() if found else ("", "")
    value = _scalar(value)
    if key in header:
        raise InputError(f"row {number}: {key} is stated a second time; keep one of the lines")
    if key in words.header:
        header[key] = value
    elif words.unit_suffix.search(key):
        known = f"known: {', '.join(words.header)}"
        raise InputError(f"row {number}: unknown header key {quote(key)}; {known}; correct or reword it")


def _scalar(value: str) -> str:
    """A number in a file's head; spreadsheets pad short rows with delimiters."""
    value = value.rstrip(";, \t")
    return value.replace(",", ".") if _DECIMAL_COMMA.fullmatch(value) else value


def _delimiter(line: str) -> str | None:
    """What divides the cells of a row; None for white space."""
    # Between tabs, where each cell is one number, and between semicolons a comma is a decimal comma.
    if "\t" in line:
        cells = [cell.strip() for cell in line.split("\t")]
        if all(map(_NUMBER.fullmatch, cells)) and ("," in line or all(cells)):
            return "\t"
    return next((mark for mark in (";", ",") if mark in line), None)


def _parse(
    rows: Sequence[str], numbers: Sequence[int], names: Sequence[str]
) -> tuple[dict[str, FloatArray], dict[str, list[int]]]:
    """Columns (n,) of the rows' numbers, and the rows in which one is blank; skipped columns may hold anything.

    Parameters
    ----------
    numbers : of the rows in the file, for messages.
    """
    used = {name: at for at, name in enumerate(names) if name != SKIPPED}
    delimiter = _delimiter(rows[0]) if rows else None
    if rows and len(used) == len(names) and delimiter != ";":
        # Rows of nothing but numbers, as nearly all are; what is not so is read below, which says where and why.
        with suppress(ValueError):
            table = np.loadtxt(rows, delimiter=delimiter, comments=None, ndmin=2)
            if table.shape[1] == len(names):
                return {name: table[:, at].copy() for name, at in used.items()}, {}
    columns, blanks = {name: array("d") for name in used}, dict[str, list[int]]()
    for row, (number, line) in enumerate(zip(numbers, rows, strict=True)):
        # Between semicolons and tabs a comma can only be a decimal comma.
        cells = (line.replace(",", ".") if delimiter in (";", "\t") else line).split(delimiter, len(names) + 1)
        if len(cells) == len(names) + 1 and not cells[-1].strip():
            del cells[-1]  # spreadsheets end every row with a delimiter if one row needs it
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
    """Interpolate channels that were recorded more slowly than the others, which leave regular blanks.

    Rows before the first and behind the last value of such a channel are cut off, since nobody knows it there.

    Parameters
    ----------
    columns, numbers : are changed.

    Returns
    -------
    Name of the channel -> the rows from one of its values to the next.

    Raises
    ------
    InputError : a blank among values of all rows, or blanks that are not regular.
    """
    strides, first, end = dict[str, int](), 0, len(numbers)
    for name, rows in blanks.items():
        have = np.setdiff1d(np.arange(len(numbers)), rows)
        steps = np.unique(np.diff(have))
        ends = max(have[0], len(numbers) - 1 - have[-1]) if have.size else 0
        if have.size < MIN_SAMPLES or steps.size != 1 or ends >= steps[0]:
            row = f"row {numbers[rows[0]]}, column {name}"
            raise InputError(f"{row}: '' is no number; correct it, or put # before a remark")
        strides[name], first, end = int(steps[0]), max(first, int(have[0])), min(end, int(have[-1]) + 1)
        spline = scipy.interpolate.CubicSpline(have, columns[name][have])
        columns[name] = np.asarray(spline(np.arange(len(numbers))))
    if strides:
        columns.update({name: values[first:end] for name, values in columns.items()})
        del numbers[:first]
    return strides
