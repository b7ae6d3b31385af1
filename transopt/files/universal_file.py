"""Functions over frequency or time in dataset 58 of a universal file, in the units of their labels.

SDRC, "Universal File Format", dataset 58: Function at Nodal DOF. Records 8 to 10 describe abscissa, ordinate and
denominator: a type, three exponents, the axis' label and the label of its unit. Measurement software writes responses
in g per V as often as in SI, and states the unit only there. In a binary dataset, 58b, these records are text too.
"""

import io
import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from transopt.base.errors import InputError
from transopt.base.signals import FloatArray
from transopt.base.sizes import MOST_ROWS
from transopt.files.containers import Channels
from transopt.files.names import Layout, Vocabulary, labelled, quote
from transopt.files.unclear import UnclearError, chosen_channel
from transopt.files.units import UNITS, input_unit, parts

TIME_RESPONSE, FREQUENCY_RESPONSE = 1, 4  # function types of record 6
# Specific data types in records 8 to 10. A general quantity is described by exponents of length, force, temperature.
UNKNOWN, GENERAL, ACCELERATION, TIME, FREQUENCY = 0, 1, 12, 17, 18
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
    TIME: "a time",
    FREQUENCY: "a frequency",
    19: "a speed of rotation",
    20: "an order",
}
MAY_ACCELERATE = ("", TYPES[ACCELERATION], "length^1 force^0 temperature^0")
MARK = b"    -1"
# Ordinate type in record 7 -> (1 for real or 2 for complex, number type), in single or double precision.
ORDINATES = {2: (1, "f4"), 4: (1, "f8"), 5: (2, "f4"), 6: (2, "f8")}
WIDTHS = {"f4": 13, "f8": 20}  # characters of a number in text
ABSCISSA_WIDTH = 13
LINE_WIDTH = 80
HEAD_LINES = 11  # lines of the dataset before its numbers
LENGTHS = {1: 1.0, 5: 1e3, 6: 1e2, 8: 1e3, 10: 1e3}  # metres to the file's length, by the code of dataset 164
UNIT_LABEL = slice(47, 67)  # columns of the unit's label in records 8 to 11
NOT_STATED = ("", "NONE")


class _Dataset(NamedTuple):
    """One dataset: its number and lines, and for a binary one the data after eleven lines, with byte order."""

    kind: str
    lines: list[str]
    packed: bytes = b""
    order: str = "<"


def universal_columns(data: bytes, layout: Layout, words: Vocabulary) -> Channels:
    """One function of the datasets 58 of a universal file, ASCII or binary; the axes' labels name its columns.

    If the vocabulary requires frequencies it is a frequency response, in columns frequency and accelerance; otherwise
    a time record, in columns time and acceleration.

    Parameters
    ----------
    layout : `channel` selects among several functions; `units` overrides the types and labels of the file.

    Raises
    ------
    InputError : the file holds no such function, or the function is no acceleration by its types and labels.
    UnclearError : there are several functions, or the label of a response states its input alone.
    """
    is_response = "frequency" in words.required
    abscissa, ordinate = ("frequency", "accelerance") if is_response else ("time", "acceleration")
    datasets = _datasets(data)
    unit = next((_unit_of_164(each) for each in datasets if each.kind == "164"), "")
    functions = [each for each in datasets if each.kind in ("58", "58b")]
    chosen = _chosen(functions, layout.channel, is_response=is_response)
    kind, along, _ = _axis(chosen.lines, 7, "abscissa")
    if kind not in (UNKNOWN, FREQUENCY if is_response else TIME):
        raise InputError(f"dataset 58: its abscissa is no {abscissa}; export a function of {abscissa}")
    if unit and not along:
        along = "Hz" if is_response else "s"
    units = layout.units or {}
    is_stated = any(key in units for key in (ordinate, words.quantity_of(ordinate)))
    label = _label(chosen.lines, unit, is_response=is_response, is_stated=is_stated)
    cells = _numbers(chosen, 2 if is_response else 1)
    values = cells[:, 1] + 1j * cells[:, 2] if is_response else cells[:, 1]
    named = {labelled(abscissa, along): cells[:, 0], labelled(ordinate, label): values}
    return Channels(named, place=lambda k: f"point {k + 1}")


def _unit_of_164(dataset: _Dataset) -> str:
    """Unit of accelerations from dataset 164, which states the factor from metres to the file's length."""
    code = _whole(dataset.lines, 0, 0, 10, "units code of dataset 164")
    factor = _number(dataset.lines[1][:25], 2) if len(dataset.lines) > 1 else LENGTHS.get(code, 0.0)
    known = UNITS["acceleration"].items()
    unit = next(
        (unit for unit, si in known if unit.endswith("/s^2") and math.isclose(si * factor, 1, rel_tol=1e-3)), ""
    )
    if not unit:
        raise InputError(
            f"dataset 164: units other than SI, code {code}, {factor:g} to the metre; export in SI, code 1"
        )
    return unit


def _chosen(functions: Sequence[_Dataset], channel: int | None, *, is_response: bool) -> _Dataset:
    """The frequency or time response chosen, counted from 1 among those of its kind."""
    wanted, what = (FREQUENCY_RESPONSE, "frequency") if is_response else (TIME_RESPONSE, "time")
    found = [each for each in functions if _whole(each.lines, 5, 0, 5, "function type") == wanted]
    if not found:
        raise InputError(f"0 {what} responses in {len(functions)} datasets 58; export one of the acceleration")
    return found[chosen_channel(channel, [each.lines[0] for each in found], f"{what} responses")]


def _datasets(data: bytes) -> list[_Dataset]:
    """All datasets of a file: each stands between two lines of -1, and a binary one states its length."""
    found, stream = list[_Dataset](), io.BytesIO(data)
    while begin := stream.readline():
        if begin.rstrip() != MARK:
            continue
        words = stream.readline().decode("latin-1").split()
        kind, lines, packed, order = words[0] if words else "", list[str](), b"", "<"
        if kind == "58b":
            lines = [_decoded(stream.readline()) for _ in range(HEAD_LINES)]
            size = int(words[4]) if len(words) > 4 and words[4].isdecimal() else 0
            packed, order = stream.read(size), ">" if words[1:2] == ["2"] else "<"
        while (each := stream.readline()) and each.rstrip() != MARK:
            lines.append(_decoded(each))
        found.append(_Dataset(kind, lines, packed, order))
    if not found:
        raise InputError("no dataset between two lines of -1; export it as a universal file")
    return found


def _decoded(line: bytes) -> str:
    """A line decoded as UTF-8, or else by the Windows code page, which defines almost all bytes."""
    line = line.rstrip(b"\r\n")
    try:
        return line.decode()
    except UnicodeDecodeError:
        return line.decode("cp1252", "replace")


def _whole(block: Sequence[str], line: int, start: int, end: int, what: str, empty: int | None = None) -> int:
    """Whole number in columns of a dataset's line; `empty` for blank columns, if given."""
    cell = block[line][start:end].strip() if line < len(block) else ""
    if not cell and empty is not None and line < len(block):
        return empty
    try:
        return int(cell)
    except ValueError:
        raise InputError(
            f"dataset, line {line + 1}: {what} is {quote(cell)}, no whole number; export it again"
        ) from None


def _numbers(dataset: _Dataset, parts_of: int) -> FloatArray:
    """(points, 1 + parts_of) abscissa and parts of the ordinate."""
    block = dataset.lines
    kind = _whole(block, 6, 0, 10, "ordinate type")
    points = _whole(block, 6, 10, 20, "number of points")
    even = _whole(block, 6, 20, 30, "spacing of the abscissa") == 1
    if ORDINATES.get(kind, (0, ""))[0] != parts_of:
        wanted = "2 or 4, real" if parts_of == 1 else "5 or 6, complex: export real and imaginary part"
        raise InputError(f"dataset 58: ordinate type {kind}, must be {wanted}")
    if not 0 < points <= MOST_ROWS:
        raise InputError(f"dataset 58: {points} points, must be 1 to {MOST_ROWS}")
    kept = ORDINATES[kind][1]
    columns = parts_of + (not even)
    cells: FloatArray
    if dataset.kind == "58b":
        room = len(dataset.packed) // np.dtype(kept).itemsize
        cells = np.frombuffer(dataset.packed, dataset.order + kept, min(room, points * columns)).astype(float)
    else:
        widths = [*([] if even else [ABSCISSA_WIDTH]), *[WIDTHS[kept]] * parts_of]
        cells = _cells(block[HEAD_LINES:], widths * max(LINE_WIDTH // sum(widths), 1), points * columns)
    if cells.size < points * columns:
        raise InputError(f"dataset 58: {cells.size} numbers, its head promises {points * columns}; it is cut short")
    cells = cells.reshape(points, columns)
    if even:
        start, step = (_number(block[6][at : at + 13], 7) for at in (30, 43))
        cells = np.column_stack([start + step * np.arange(points), cells])
    return cells


def _axis(block: Sequence[str], line: int, what: str) -> tuple[int, str, str]:
    """Fields of one of the records 8 to 10, each of which describes an axis.

    Returns
    -------
    Type number; label of the unit, empty if not stated; meaning of the type, for messages. A general quantity is
    described by its exponents of length, force and temperature, or by an empty text if all are zero.
    """
    kind = _whole(block, line, 0, 10, f"type of the {what}", empty=UNKNOWN)
    label = block[line][UNIT_LABEL].strip()
    if kind == GENERAL:
        powers = [_whole(block, line, at, at + 5, f"exponent of the {what}", empty=0) for at in (10, 15, 20)]
        meaning = "length^{} force^{} temperature^{}".format(*powers) if any(powers) else ""
    else:
        meaning = TYPES.get(kind, f"a quantity of type {kind}")
    return kind, "" if label.upper() in NOT_STATED else label, meaning


def _label(block: Sequence[str], unit: str, *, is_response: bool, is_stated: bool) -> str:
    """Unit of the ordinate over that of its denominator; labels override types, which may refuse the function.

    Parameters
    ----------
    unit : unit of accelerations from dataset 164; empty without one.
    is_stated : whether the user states the unit of the function.

    Raises
    ------
    InputError : the ordinate is no acceleration, or the denominator is no input.
    UnclearError : the denominator has a label and the ordinate has none.
    """
    kind, above, ordinate = _axis(block, 8, "ordinate")
    _, below, denominator = _axis(block, 9, "denominator") if is_response else (UNKNOWN, "", "")
    may_accelerate = kind in (UNKNOWN, GENERAL, ACCELERATION) and (above or ordinate in MAY_ACCELERATE)
    if not (may_accelerate or is_stated):
        raise InputError(f"dataset 58: its ordinate is {ordinate}, no acceleration (type 12); export the accelerance")
    if parts(above)[1]:
        return above
    if (below or denominator) and input_unit(below) is None and not is_stated:
        found = f"in {quote(below)}" if below else f"{denominator} by its type"
        raise InputError(
            f"dataset 58: its denominator is {found}, neither a current nor a voltage; export the acceleration over "
            "the command, or state what it is by --units magnitude=g/V"
        )
    above = above or unit
    if below and not above and not is_stated:
        raise UnclearError(
            "dataset 58: no label says the unit of its magnitude",
            [{"units": {"magnitude": f"{of}/{below}"}} for of in ("m/s^2", "g", "mm/s^2")],
        )
    return f"{above}/{below}" if below and above else above


def _cells(lines: Sequence[str], widths: Sequence[int], wanted: int) -> FloatArray:
    """(n,) numbers of fixed width, at most `wanted`; neighbours may touch."""
    ends = np.cumsum(widths)
    numbers: list[float] = []
    for k, line in enumerate(lines):
        for end, width in zip(ends, widths, strict=True):
            cell = line[end - width : end]
            if len(numbers) < wanted and cell.strip():
                numbers.append(_number(cell, HEAD_LINES + k + 1))
    return np.array(numbers)


def _number(cell: str, line: int) -> float:
    try:
        return float(cell.replace("D", "E").replace("d", "e"))
    except ValueError:
        raise InputError(f"dataset 58, line {line}: {quote(cell)} is no number; export it again") from None
