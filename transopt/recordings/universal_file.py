"""A frequency response in dataset 58 of a universal file, read in SI by the labels of its axes.

SDRC, "Universal File Format", dataset 58: Function at Nodal DOF. Records 8 to 10 describe abscissa, ordinate and
denominator: a type, three exponents, the axis' label and the label of its unit. Software for measurements writes a
response in g per V as often as one in SI, and says so there alone. Of many kinds of function a response is one, which
is read here with messages that name the field.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from transopt.base.errors import InputError
from transopt.base.shown import brief
from transopt.base.signals import ComplexArray, FloatArray
from transopt.base.sizes import MOST_ROWS
from transopt.recordings.names import Layout, factor_of, quote

# What record 6 calls a frequency response, record 8 a frequency, and record 9 an acceleration or a general quantity.
FREQUENCY_RESPONSE, FREQUENCY, ACCELERATION = 4, 18, (0, 1, 12)
MARK = "    -1"
WIDTHS = {5: 13, 6: 20}  # ordinate type, complex of single or double precision -> characters of each number
ABSCISSA_WIDTH = 13
LINE_WIDTH = 80
HEAD_LINES = 11  # of the dataset, before its numbers
UNIT_LABEL = slice(47, 67)  # columns of the unit's label in records 8 to 11
NOT_STATED = ("", "NONE")


@dataclass(frozen=True)
class UniversalResponse:
    """A frequency response as a universal file holds it.

    Attributes
    ----------
    frequencies_Hz : (m,). response : (m,) complex [m/s^2 per A or V].
    input_unit : "A" or "V", what the response is to; empty where neither the file nor the user says it.
    notes : what labels and user state differently, one sentence each.
    """

    frequencies_Hz: FloatArray
    response: ComplexArray
    input_unit: str
    notes: tuple[str, ...]

    __repr__ = brief


def read_universal_file(data: bytes, layout: Layout) -> UniversalResponse:
    """The one frequency response among the datasets of a universal file.

    Parameters
    ----------
    layout : `units` of the magnitude, as "g/V", and of the frequency go before the labels in the file.

    Raises
    ------
    InputError : a file that holds none or several, is binary, or states units that are not known; an option that says
        nothing about such a file.
    """
    units = dict(layout.units or {})
    other = [name for name in units if name not in ("magnitude", "frequency")]
    if layout.columns:
        raise InputError("--columns: a universal file has no columns; leave it out")
    if other:
        raise InputError(
            f"--units {other[0]}={units[other[0]]}: a universal file has a magnitude and a frequency; write --units "
            "magnitude=g/V,frequency=Hz"
        )
    text = _text(data)
    lines = text.splitlines()
    found = [block for kind, block in _datasets(lines) if kind == "58"]
    if any(kind.startswith("58b") for kind, _ in _datasets(lines)):
        raise InputError("holds a binary dataset 58b; export dataset 58 in ASCII")
    code = next((block for kind, block in _datasets(lines) if kind == "164"), None)
    if code is not None and _whole(code, 0, 0, 10, "units code of dataset 164") != 1:
        raise InputError("dataset 164: units other than SI; export in SI, units code 1")
    responses = [block for block in found if _whole(block, 5, 0, 5, "function type") == FREQUENCY_RESPONSE]
    if len(responses) != 1:
        raise InputError(
            f"{len(responses)} frequency responses in {len(found)} datasets 58, must be one; export the one that "
            "leads from the input to the acceleration"
        )
    return _of_dataset(responses[0], units)


def _text(data: bytes) -> str:
    """The file's text; a label may hold a superscript in one of the usual encodings.

    Raises
    ------
    InputError : bytes that no text holds.
    """
    if b"\0" in data:
        raise InputError("holds binary datasets; export dataset 58 in ASCII")
    try:
        return data.decode("utf-8")
    except UnicodeDecodeError:
        return data.decode("latin-1")


def _datasets(lines: list[str]) -> list[tuple[str, list[str]]]:
    """Number and lines of every dataset: they stand between two lines of -1."""
    marks = [k for k, line in enumerate(lines) if line.rstrip() == MARK]
    inside = [lines[a + 1 : b] for a, b in zip(marks[::2], marks[1::2], strict=False)]
    if not inside:
        raise InputError("no dataset between two lines of -1; export it as a universal file in ASCII")
    return [(block[0].split()[0] if block and block[0].split() else "", block[1:]) for block in inside]


def _whole(block: Sequence[str], line: int, start: int, end: int, what: str) -> int:
    """A whole number in columns of a line of a dataset."""
    cell = block[line][start:end].strip() if line < len(block) else ""
    try:
        return int(cell)
    except ValueError:
        raise InputError(
            f"dataset, line {line + 1}: {what} is {quote(cell)}, no whole number; export it again"
        ) from None


def _of_dataset(block: Sequence[str], units: Mapping[str, str]) -> UniversalResponse:
    """One frequency response in SI, by the labels of its axes or by the user's units."""
    kind = _whole(block, 6, 0, 10, "ordinate type")
    points = _whole(block, 6, 10, 20, "number of points")
    even = _whole(block, 6, 20, 30, "spacing of the abscissa") == 1
    if kind not in WIDTHS:
        raise InputError(f"dataset 58: ordinate type {kind}, must be 5 or 6, complex: export real and imaginary part")
    if not 0 < points <= MOST_ROWS:
        raise InputError(f"dataset 58: {points} points, must be 1 to {MOST_ROWS}")
    if _whole(block, 7, 0, 10, "kind of the abscissa") not in (0, FREQUENCY):
        raise InputError("dataset 58: its abscissa is no frequency; export a frequency response")
    if _whole(block, 8, 0, 10, "kind of the ordinate") not in ACCELERATION:
        raise InputError("dataset 58: its ordinate is no acceleration (type 12); export the accelerance")
    widths = [*([] if even else [ABSCISSA_WIDTH]), WIDTHS[kind], WIDTHS[kind]]
    per_line = max(LINE_WIDTH // sum(widths), 1)
    cells = _cells(block[HEAD_LINES:], widths * per_line, points * len(widths)).reshape(points, -1)
    if even:
        start, step = (_number(block[6][at : at + 13], 7) for at in (30, 43))
        frequencies = start + step * np.arange(points)
    else:
        frequencies, cells = cells[:, 0], cells[:, 1:]
    abscissa, ordinate, denominator = (_unit_label(block, line) for line in (7, 8, 9))
    stated_Hz, stated = units.get("frequency"), units.get("magnitude")
    to_Hz = _factor(stated_Hz or abscissa or "Hz", "frequency", "abscissa", "frequency=Hz")
    # A unit of the acceleration alone, as g, leaves the input to the file's label.
    factor, per = _ratio(stated or ordinate, denominator)
    notes = []
    if stated_Hz is not None and abscissa not in ("", stated_Hz):
        notes.append(f"the file's label says {abscissa} for the abscissa, --units says {stated_Hz}, which is taken")
    if stated is not None and (ordinate or denominator):
        label = f"{ordinate}/{denominator}" if denominator else ordinate
        if label != stated:
            notes.append(f"the file's labels say {label}, --units says {stated}, which is taken")
    response = factor * (cells[:, 0] + 1j * cells[:, 1])
    return UniversalResponse(np.asarray(frequencies) * to_Hz, np.asarray(response), per, tuple(notes))


def _unit_label(block: Sequence[str], line: int) -> str:
    """The unit of an axis: the second label of its record, behind four whole numbers; empty where none is stated."""
    label = block[line][UNIT_LABEL].strip() if line < len(block) else ""
    return "" if label.upper() in NOT_STATED else label


def _factor(unit: str, quantity: str, what: str, example: str) -> float:
    """What makes SI of a unit.

    Raises
    ------
    InputError : a unit that is not known.
    """
    factor = factor_of(unit, quantity)
    if factor is None:
        raise InputError(
            f"dataset 58: its {what} is in {quote(unit)}, which is not known; state it by --units {example}"
        )
    return factor


def _ratio(ordinate: str, denominator: str) -> tuple[float, str]:
    """Factor to m/s^2 per A or V, and which of the two; empty where nothing is said of the input.

    Parameters
    ----------
    ordinate : unit of the acceleration, or of the whole ratio as in g/V. denominator : unit of the input.

    Raises
    ------
    InputError : units that are not known, or an input that is neither a current nor a voltage.
    """
    whole, mark, behind = ordinate.rpartition("/")
    if mark and factor_of(behind, "current") is None and factor_of(behind, "voltage") is None:
        whole = ""  # the stroke of m/s^2, or of a unit that is not known
    acceleration, of_input = (whole, behind) if whole else (ordinate, denominator)
    example = "magnitude=g/V"
    factor = _factor(acceleration or "m/s^2", "acceleration", "ordinate", example)
    if not of_input:
        return factor, ""
    for unit, quantity in (("A", "current"), ("V", "voltage")):
        by = factor_of(of_input, quantity)
        if by is not None:
            return factor / by, unit
    raise InputError(
        f"dataset 58: its denominator is in {quote(of_input)}, neither a current nor a voltage; export the "
        f"acceleration over the command, or state what it is by --units {example}"
    )


def _cells(lines: Sequence[str], widths: Sequence[int], wanted: int) -> FloatArray:
    """(wanted,) numbers of fixed width: neighbours may touch."""
    ends = np.cumsum(widths)
    numbers: list[float] = []
    for k, line in enumerate(lines):
        for end, width in zip(ends, widths, strict=True):
            cell = line[end - width : end]
            if len(numbers) < wanted and cell.strip():
                numbers.append(_number(cell, HEAD_LINES + k + 1))
    if len(numbers) < wanted:
        raise InputError(f"dataset 58: {len(numbers)} numbers, its head promises {wanted}; it is cut short")
    return np.array(numbers)


def _number(cell: str, line: int) -> float:
    try:
        return float(cell.replace("D", "E").replace("d", "e"))
    except ValueError:
        raise InputError(f"dataset 58, line {line}: {quote(cell)} is no number; export it again") from None
