"""A frequency response in dataset 58 of a universal file, read in SI by the labels of its axes.

SDRC, "Universal File Format", dataset 58: Function at Nodal DOF. Records 8 to 10 describe abscissa, ordinate and
denominator: a type, three exponents, the axis' label and the label of its unit. Software for measurements writes a
response in g per V as often as one in SI, and says so there alone. Of many kinds of function a response is one, which
is read here with messages that name the field.
"""

from collections.abc import Mapping, Sequence

import numpy as np

from transopt.base.errors import InputError
from transopt.base.signals import FloatArray
from transopt.base.sizes import MOST_ROWS
from transopt.recordings.names import Layout, Meaning, quote, settled
from transopt.recordings.raw_table import RawTable
from transopt.recordings.text import encoding_of
from transopt.recordings.units import input_unit, parts, read_unit, remedy_of

FREQUENCY_RESPONSE = 4  # function type of record 6
# Specific data types of records 8 to 10. Of a general quantity exponents of length, force and temperature are stated.
UNKNOWN, GENERAL, ACCELERATION, FREQUENCY = 0, 1, 12, 18
TYPES = {
    UNKNOWN: "",
    2: "a stress",
    3: "a strain",
    5: "a temperature",
    6: "a heat flux",
    8: "a displacement",
    9: "a reaction force",
    11: "a velocity",
    ACCELERATION: "an acceleration",
    13: "an excitation force",
    15: "a pressure",
    16: "a mass",
    17: "a time",
    FREQUENCY: "a frequency",
    19: "a speed of rotation",
    20: "an order",
}
MAY_ACCELERATE = ("", TYPES[ACCELERATION], "length^1 force^0 temperature^0")
SI, EXAMPLE = "m/s^2", "--units magnitude=g/V"
MARK = "    -1"
WIDTHS = {5: 13, 6: 20}  # ordinate type, complex of single or double precision -> characters of each number
ABSCISSA_WIDTH = 13
LINE_WIDTH = 80
HEAD_LINES = 11  # of the dataset, before its numbers
UNIT_LABEL = slice(47, 67)  # columns of the unit's label in records 8 to 11
NOT_STATED = ("", "NONE")


def read_universal_file(data: bytes, layout: Layout) -> RawTable:
    """The one frequency response among the datasets of a universal file: columns frequency, real, imaginary.

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
    if b"\0" in data:
        raise InputError("holds binary datasets; export dataset 58 in ASCII")
    lines = data.decode(encoding_of(data)).splitlines()
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


def _datasets(lines: list[str]) -> list[tuple[str, list[str]]]:
    """Number and lines of every dataset: they stand between two lines of -1."""
    marks = [k for k, line in enumerate(lines) if line.rstrip() == MARK]
    inside = [lines[a + 1 : b] for a, b in zip(marks[::2], marks[1::2], strict=False)]
    if not inside:
        raise InputError("no dataset between two lines of -1; export it as a universal file in ASCII")
    return [(block[0].split()[0] if block and block[0].split() else "", block[1:]) for block in inside]


def _whole(block: Sequence[str], line: int, start: int, end: int, what: str, empty: int | None = None) -> int:
    """A whole number in columns of a line of a dataset; `empty` where they are blank, if blanks are allowed."""
    cell = block[line][start:end].strip() if line < len(block) else ""
    if not cell and empty is not None and line < len(block):
        return empty
    try:
        return int(cell)
    except ValueError:
        raise InputError(
            f"dataset, line {line + 1}: {what} is {quote(cell)}, no whole number; export it again"
        ) from None


def _of_dataset(block: Sequence[str], units: Mapping[str, str]) -> RawTable:
    """One frequency response, its units by the labels of its axes or by the user's word."""
    kind = _whole(block, 6, 0, 10, "ordinate type")
    points = _whole(block, 6, 10, 20, "number of points")
    even = _whole(block, 6, 20, 30, "spacing of the abscissa") == 1
    if kind not in WIDTHS:
        raise InputError(f"dataset 58: ordinate type {kind}, must be 5 or 6, complex: export real and imaginary part")
    if not 0 < points <= MOST_ROWS:
        raise InputError(f"dataset 58: {points} points, must be 1 to {MOST_ROWS}")
    frequency, ratio = _frequency(block, units.get("frequency", "")), _ratio(block, units.get("magnitude", ""))
    widths = [*([] if even else [ABSCISSA_WIDTH]), WIDTHS[kind], WIDTHS[kind]]
    per_line = max(LINE_WIDTH // sum(widths), 1)
    cells = _cells(block[HEAD_LINES:], widths * per_line, points * len(widths)).reshape(points, -1)
    if even:
        start, step = (_number(block[6][at : at + 13], 7) for at in (30, 43))
        cells = np.column_stack([start + step * np.arange(points), cells])
    meanings = {"frequency": frequency, "real": ratio, "imaginary": ratio._replace(quantity="imaginary")}
    columns = {name: cells[:, at] for at, name in enumerate(meanings)}
    return RawTable(columns, meanings, {}, lambda k: f"point {k + 1}")


def _axis(block: Sequence[str], line: int, what: str) -> tuple[int, str, str]:
    """Fields of one of the records 8 to 10, which describe an axis.

    Returns
    -------
    Number of the type; label of the unit, empty where none is stated; what the type says, for messages. A general
    quantity is described by its exponents of length, force and temperature, and by nothing if all are zero.
    """
    kind = _whole(block, line, 0, 10, f"type of the {what}", empty=UNKNOWN)
    label = block[line][UNIT_LABEL].strip()
    if kind == GENERAL:
        powers = [_whole(block, line, at, at + 5, f"exponent of the {what}", empty=0) for at in (10, 15, 20)]
        meaning = "length^{} force^{} temperature^{}".format(*powers) if any(powers) else ""
    else:
        meaning = TYPES.get(kind, f"a quantity of type {kind}")
    return kind, "" if label.upper() in NOT_STATED else label, meaning


def _frequency(block: Sequence[str], user: str) -> Meaning:
    """What the abscissa means, by the user's word or by its label."""
    kind, label, _ = _axis(block, 7, "abscissa")
    if kind not in (UNKNOWN, FREQUENCY):
        raise InputError("dataset 58: its abscissa is no frequency; export a frequency response")
    stated = user or label or "Hz"
    if read_unit(stated, "frequency") is None:
        raise InputError(
            f"dataset 58: its abscissa is in {quote(stated)}, which is not known; state it by --units frequency=Hz"
        )
    said = f"label says {label} for the abscissa" if label else ""
    return settled("frequency", stated, read_unit(label, "frequency"), said)


def _ratio(block: Sequence[str], user: str) -> Meaning:
    """What ordinate over denominator means: the user's word goes before the labels, and these before the types.

    Raises
    ------
    InputError : units that are not known, an ordinate that is no acceleration, or a denominator that is no input.
    """
    kind, above, ordinate = _axis(block, 8, "ordinate")
    _, below, denominator = _axis(block, 9, "denominator")
    acceleration, of_input = parts(user)[0] or parts(above)[0], parts(user)[1] or parts(above)[1] or below
    if kind not in (UNKNOWN, GENERAL, ACCELERATION) or not (acceleration or ordinate in MAY_ACCELERATE):
        raise InputError(f"dataset 58: its ordinate is {ordinate}, no acceleration (type 12); export the accelerance")
    acceleration = acceleration or SI
    if read_unit(acceleration, "real") is None:
        remedy = remedy_of(acceleration) or f"; state it by {EXAMPLE}"
        raise InputError(f"dataset 58: its ordinate is in {quote(acceleration)}, which is not known{remedy}")
    if input_unit(of_input) is None and (of_input or denominator):
        found = f"in {quote(of_input)}" if of_input else f"{denominator} by its type"
        raise InputError(
            f"dataset 58: its denominator is {found}, neither a current nor a voltage; export the acceleration over "
            f"the command, or state what it is by {EXAMPLE}"
        )
    label = f"{above or SI}/{below}" if below and not parts(above)[1] else above
    stated = f"{acceleration}/{of_input}" if of_input else acceleration
    return settled("real", stated, read_unit(label, "real"), f"labels say {label}" if label and user else "")


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
