"""Measured frequency responses, acceleration over current or voltage: read from CSV, text, NPZ, MAT and UFF files.

Tables have a column of frequencies and either magnitude and phase or real and imaginary part, named and with units as
instruments write them (`transopt.recordings.names`). A Universal File holds them as its dataset 58 in ASCII (SDRC,
"Universal File Format", dataset 58: Function at Nodal DOF). Of its many kinds of function a response is one, which is
read here in a hundred lines with messages that name the field; the package pyuff reads and writes all datasets, and
would bring its dependencies along for this one.
"""

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from transopt.base.errors import InputError
from transopt.base.files import read_file
from transopt.base.shown import brief
from transopt.base.signals import STANDARD_GRAVITY_M_S2, ComplexArray, FloatArray
from transopt.base.sizes import MOST_RECORD_BYTES, MOST_ROWS
from transopt.recordings.formats import MIN_SAMPLES, read_raw
from transopt.recordings.names import LEVEL, Layout, Vocabulary, quote

UFF_SUFFIXES = (".unv", ".uff", ".u58")
LARGEST = 1e9  # m/s^2 per A or V: far above every actuator, and its square still fits
WORDS = Vocabulary(
    columns={
        "frequency_Hz": ("frequency", 1.0),
        "frequency_kHz": ("frequency", 1e3),
        "magnitude": ("magnitude", 1.0),
        "magnitude_m_s2": ("magnitude", 1.0),
        "magnitude_g": ("magnitude", STANDARD_GRAVITY_M_S2),
        "magnitude_dB": ("magnitude", LEVEL),
        "phase_deg": ("phase", math.pi / 180),
        "phase_rad": ("phase", 1.0),
        "real": ("real", 1.0),
        "imaginary": ("imaginary", 1.0),
        "imag": ("imaginary", 1.0),
    },
    header={},
    required=("frequency",),
    step_s=(0.0, 0.0),
    unit_suffix=re.compile(r"(_(k?Hz|dB|deg|rad|m_s2|g)|^(magnitude|real|imag|imaginary))$"),
)
PAIRS = (("real", "imaginary"), ("magnitude", "phase"))
# Of dataset 58: what record 6 calls a frequency response, what record 8 calls a frequency, and record 9 an ordinate.
FREQUENCY_RESPONSE, FREQUENCY, ACCELERATION = 4, 18, (0, 1, 12)
MARK = "    -1"
WIDTHS = {5: 13, 6: 20}  # ordinate type, complex of single or double precision -> characters of each number
ABSCISSA_WIDTH = 13
LINE_WIDTH = 80
HEAD_LINES = 11  # of the dataset, before its numbers


@dataclass(frozen=True)
class MeasuredResponse:
    """A frequency response as measured.

    Attributes
    ----------
    frequencies_Hz : (m,) increasing, above 0.
    response : (m,) complex acceleration over input [m/s^2 per A or V].
    """

    frequencies_Hz: FloatArray
    response: ComplexArray

    __repr__ = brief


def read_response(path: Path, layout: Layout | None = None, *, scale: float = 1.0) -> MeasuredResponse:
    """Read one response; the format follows from the suffix.

    Parameters
    ----------
    path : .csv, .txt, .dat, .npz, .mat (-v6 or -v7), .unv, .uff or .u58.
    layout : names and units of columns that the file does not state.
    scale : what the response is multiplied with to be in m/s^2 per A or V.

    Raises
    ------
    InputError : one line, file first, whatever is wrong.
    """
    data = read_file(path, MOST_RECORD_BYTES, "name a file with a measured frequency response")
    try:
        if not (math.isfinite(scale) and scale != 0):
            raise InputError(f"--scale {scale}: must be a number other than 0")
        with np.errstate(all="ignore"):  # overflow in absurd values: found as inf by the check
            if path.suffix.lower() in UFF_SUFFIXES:
                frequencies_Hz, response = _of_uff(data)
            else:
                frequencies_Hz, response = _of_table(path.suffix, data, layout or Layout())
            return _checked(frequencies_Hz, scale * response)
    except InputError as error:
        file = str(path) if str(path).isprintable() else repr(str(path))
        raise InputError(f"{file}: {error}") from error


def _checked(frequencies_Hz: FloatArray, response: ComplexArray) -> MeasuredResponse:
    """The points above 0 Hz, in increasing order."""
    bad = ~(np.isfinite(frequencies_Hz) & (np.abs(response) <= LARGEST))
    if bad.any():
        k = int(bad.argmax())
        raise InputError(
            f"point {k + 1}: {frequencies_Hz[k]:g} Hz, {response[k]:g}: must be finite and at most {LARGEST:g} m/s^2 "
            "per A or V in size; check units and scale"
        )
    order = np.argsort(frequencies_Hz, kind="stable")
    f, G = frequencies_Hz[order], response[order]
    f, G = f[f > 0], G[f > 0]  # an analyser's first line is that of 0 Hz, of which an accelerometer knows nothing
    twice = np.flatnonzero(np.diff(f) <= 0)
    if twice.size:
        raise InputError(f"{f[twice[0]]:g} Hz stands there twice; average repeated measurements first")
    if f.size < MIN_SAMPLES:
        raise InputError(f"{f.size} frequencies above 0, at least {MIN_SAMPLES} are needed; measure more")
    return MeasuredResponse(f, G)


def _of_table(suffix: str, data: bytes, layout: Layout) -> tuple[FloatArray, ComplexArray]:
    raw = read_raw(suffix, data, layout, WORDS)
    columns = {quantity: (raw.columns[name], factor) for name, (quantity, factor) in raw.meanings.items()}
    sizes = {name: values.size for name, values in raw.columns.items()}
    if len(set(sizes.values())) > 1:
        listed = ", ".join(f"{name} {n}" for name, n in sizes.items())
        raise InputError(f"columns differ in length ({listed}); save them equally long")
    pair = next((pair for pair in PAIRS if all(part in columns for part in pair)), None)
    if pair is None or sum(part in columns for other in PAIRS for part in other) > 2:
        raise InputError(
            f"columns {quote(', '.join(raw.columns))}: a response has frequency_Hz and either magnitude (or "
            "magnitude_dB) and phase_deg (or phase_rad), or real and imaginary; name these by --columns, - skips one"
        )
    values, factor = columns["frequency"]
    (one, by), (other, other_by) = columns[pair[0]], columns[pair[1]]
    if pair[0] == "real":
        return values * factor, one * by + 1j * other * other_by
    magnitude = 10 ** (one / 20) if math.isnan(by) else one * by
    if magnitude.min() < 0:
        raise InputError("a magnitude is negative: is it in dB? name the column magnitude_dB")
    return values * factor, magnitude * np.exp(1j * other * other_by)


def _of_uff(data: bytes) -> tuple[FloatArray, ComplexArray]:
    """The one frequency response among the datasets of a universal file."""
    try:
        lines = data.decode("ascii").splitlines()
    except UnicodeDecodeError:
        raise InputError("holds binary datasets; export dataset 58 in ASCII") from None
    found = [block for kind, block in _datasets(lines) if kind == "58"]
    if any(kind.startswith("58b") for kind, _ in _datasets(lines)):
        raise InputError("holds a binary dataset 58b; export dataset 58 in ASCII")
    units = next((block for kind, block in _datasets(lines) if kind == "164"), None)
    if units is not None and _whole(units, 0, 0, 10, "units code of dataset 164") != 1:
        raise InputError("dataset 164: units other than SI; export in SI, units code 1")
    responses = [block for block in found if _whole(block, 5, 0, 5, "function type") == FREQUENCY_RESPONSE]
    if len(responses) != 1:
        raise InputError(
            f"{len(responses)} frequency responses in {len(found)} datasets 58, must be one; export the one that "
            "leads from the input to the acceleration"
        )
    return _of_dataset(responses[0])


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


def _of_dataset(block: Sequence[str]) -> tuple[FloatArray, ComplexArray]:
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
    return np.asarray(frequencies), np.asarray(cells[:, 0] + 1j * cells[:, 1])


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
