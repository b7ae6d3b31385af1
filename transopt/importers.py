"""Recordings from files: CSV, text, NPZ, MAT and WAV in, a `Recording` in SI units out.

Each format has one function that returns the file's columns as they stand there; `_signals` then checks and
converts all of them alike. g, mm, mm/s and ms exist nowhere else in the project but on plot axes.
Errors are raised without the file's name; `load_recording` puts it in front of all of them.
"""

import hashlib
import io
import re
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.io import wavfile

from transopt import matfile
from transopt.errors import InputError
from transopt.recording import Recording
from transopt.signals import STANDARD_GRAVITY_M_S2, FloatArray, Signal

# name in the file -> (quantity, factor to SI)
_COLUMNS: Mapping[str, tuple[str, float]] = {
    "time_s": ("time", 1.0),
    "time_ms": ("time", 1e-3),
    "acceleration_m_s2": ("acceleration", 1.0),
    "acceleration_g": ("acceleration", STANDARD_GRAVITY_M_S2),
    "position_m": ("position", 1.0),
    "position_mm": ("position", 1e-3),
    "force_N": ("force", 1.0),
    "current_A": ("current", 1.0),
}
# name in the file -> (quantity, factor to SI, unit)
_HEADER: Mapping[str, tuple[str, float, str]] = {
    "speed_m_s": ("speed", 1.0, "m/s"),
    "speed_mm_s": ("speed", 1e-3, "mm/s"),
    "grip_N": ("grip", 1.0, "N"),
}
_SKIPPED = "-"
_HOW_TO_NAME = 'name them in the scene: recordings.columns = ["time_s", "acceleration_g"] ("-" skips one)'
_SAVE_NPZ = "save real numeric arrays with numpy.savez (no objects, no pickles)"
_SAVE_MAT = "save it in MATLAB with -v7"
_HEADER_LINE = re.compile(r"#\s*([A-Za-z]\w*)\s*[:=]\s*(.*)")
# An unknown name that ends like this is more likely a misspelt quantity than something of the user's own.
_UNIT_SUFFIX = re.compile(r"_([mc]?m_s2?|[mcu]?m|m?g|m?N|m?A|[mu]?s)$", re.IGNORECASE)
_NUMBER_START = re.compile(r"[-+.]*\d|[-+]?(nan|inf)", re.IGNORECASE)

_MIN_SAMPLES = 8
_LARGEST = 1e12  # in any SI unit: beyond every instrument, yet its square and its slope still fit a float
_STEP_RANGE_S = (1e-9, 0.05)  # slower than 20 Hz nothing of a tap's band (10 Hz to 1 kHz) is left
_UNIFORM = 0.01  # of the median step: how far a time stamp may lie from the uniform grid
# Of the median step. Above: a sample is missing. Below: an interpolating spline amplifies noise tenfold.
_BUNCHED, _GAP = 0.1, 1.5


@dataclass(frozen=True)
class _Table:
    """What one file holds, in the file's own units; nothing is checked but the columns' names."""

    columns: Mapping[str, FloatArray]
    header: Mapping[str, object]
    place: Callable[[int], str]  # sample index -> where its reader finds it in the file


def load_recording(
    path: Path,
    *,
    columns: Sequence[str] = (),
    full_scale_m_s2: float | None = None,
    speed_m_s: float | None = None,
    grip_N: float | None = None,
) -> Recording:
    """Read one recorded tap; the format follows from the suffix.

    Parameters
    ----------
    path : .csv, .txt, .dat, .npz, .mat (-v6 or -v7) or .wav.
    columns : names of the file's columns, "-" for one to skip. Text needs them, in CSV they replace the
        header row, in NPZ and MAT they choose the variables; WAV ignores them.
    full_scale_m_s2 : acceleration of full scale [m/s^2], needed by WAV and ignored by the others.
    speed_m_s, grip_N : override what the file states.

    Returns
    -------
    Recording on the uniform grid of the mean time step, resampled to it by a cubic spline if a time stamp
    lies off that grid by more than 1 % of a step. Raises InputError, in one line, whatever is wrong.
    """
    try:
        data = _read_bytes(path)
        with np.errstate(all="ignore"):  # overflow in absurd values: found as inf by the checks
            table = _read_table(path.suffix, data, columns, full_scale_m_s2)
            signals = _signals(table)
            speed_m_s = _stated(table.header, "speed_m_s", speed_m_s)
            grip_N = _stated(table.header, "grip_N", grip_N)
    except InputError as error:
        # A message is one line, a file's name need not be.
        file = str(path) if str(path).isprintable() else repr(str(path))
        raise InputError(f"{file}: {error}") from error
    return Recording(
        name=path.name,
        source=str(path),
        sha256=hashlib.sha256(data).hexdigest(),
        speed_m_s=speed_m_s,
        grip_N=grip_N,
        **signals,  # acceleration and whatever else there is
    )


def _read_bytes(path: Path) -> bytes:
    try:
        if path.exists() and not path.is_file():  # a pipe or device would block or never end
            raise InputError("is a folder or a device; name the files themselves")
        data = path.read_bytes()
    except OSError as error:
        raise InputError(f"cannot be read ({error.strerror}); check the path and its permissions") from error
    if not data:
        raise InputError("is empty (0 bytes); record or export it again")
    return data


def _read_table(suffix: str, data: bytes, columns: Sequence[str], full_scale_m_s2: float | None) -> _Table:
    match suffix.lower():
        case ".txt" | ".dat" if not columns:
            raise InputError(f"columns have no names; {_HOW_TO_NAME}")
        case ".csv" | ".txt" | ".dat":
            return _read_text(data, columns)
        case ".npz":
            return _read_npz(data, columns)
        case ".mat":
            return _read_mat(data, columns)
        case ".wav":
            return _read_wav(data, full_scale_m_s2)
    known = ".csv, .txt, .dat, .npz, .mat, .wav"
    raise InputError(f"unknown format {_quote(suffix)}; known: {known}; export it as CSV")


def _read_text(data: bytes, columns: Sequence[str]) -> _Table:
    """Comment lines, at most one header row, rows of numbers; rows are counted as an editor counts them."""
    header: dict[str, object] = {}
    rows: list[tuple[int, str]] = []
    for number, line in enumerate(io.StringIO(_decode(data), newline=None), 1):
        content = line.strip()
        if number == 1 and content.lower().startswith("sep="):
            continue  # a spreadsheet's own note about its delimiter
        if content.startswith("#"):
            _read_header_line(number, content, header)
        elif content:
            rows.append((number, content))
    if not rows:
        raise InputError(f"no rows of numbers, at least {_MIN_SAMPLES} are needed; record or export it again")
    number, first = rows[0]
    cells = [cell.strip() for cell in first.rstrip(";,").split(_delimiter(first))]
    if not any(_NUMBER_START.match(cell) for cell in cells):
        del rows[0]
    elif not columns:
        begin = "begin with a row like time_s, acceleration_m_s2 (without #)"
        raise InputError(f"row {number}: {_quote(first)} has no header row above; {begin} or {_HOW_TO_NAME}")
    names = columns or cells
    _check_names(names)
    return _Table(_parse(rows, names), header, lambda k: f"row {rows[k][0]}")


def _decode(data: bytes) -> str:
    bad = data.find(b"\0")  # valid UTF-8, but only binary files have it
    try:
        text = data.decode().removeprefix("\ufeff")
    except UnicodeDecodeError as error:
        bad = error.start
    if bad >= 0:
        row = data.count(b"\n", 0, bad) + 1
        raise InputError(f"row {row}: byte 0x{data[bad]:02x} is not UTF-8 text; save it as UTF-8 text")
    return text.replace('"', "")  # spreadsheets quote cells; no name or number needs the quotes


def _read_header_line(number: int, line: str, header: dict[str, object]) -> None:
    """Add `# key: value` to `header`; a comment that merely has a colon in it stays a comment."""
    found = _HEADER_LINE.fullmatch(line)
    key, value = found.groups() if found else ("", "")
    value = value.rstrip(";, ")  # spreadsheets pad short rows with delimiters
    if key in header:
        raise InputError(f"row {number}: {key} is stated a second time; keep one of the lines")
    if key in _HEADER:
        header[key] = value
    elif _UNIT_SUFFIX.search(key):
        known = f"known: {', '.join(_HEADER)}"
        raise InputError(f"row {number}: unknown header key {_quote(key)}; {known}; correct or reword it")


def _delimiter(line: str) -> str | None:
    # The semicolon comes first: where both occur the comma is a decimal comma. None: white space.
    return next((mark for mark in (";", ",") if mark in line), None)


def _parse(rows: Sequence[tuple[int, str]], names: Sequence[str]) -> dict[str, FloatArray]:
    """Columns (n,) of the rows' numbers; skipped columns may hold anything."""
    used = {name: at for at, name in enumerate(names) if name != _SKIPPED}
    delimiter = _delimiter(rows[0][1]) if rows else None
    columns: dict[str, list[float]] = {name: [] for name in used}
    for number, line in rows:
        # Between semicolons a comma can only be a decimal comma.
        cells = line.replace(",", ".").split(delimiter) if delimiter == ";" else line.split(delimiter)
        if len(cells) == len(names) + 1 and not cells[-1].strip():
            del cells[-1]  # spreadsheets end every row with a delimiter if one row needs it
        if len(cells) != len(names):
            listed = _quote(", ".join(names))
            remedy = "correct the row or the columns' names (decimal commas? write points)"
            raise InputError(f"row {number}: {len(cells)} cells, {len(names)} columns ({listed}); {remedy}")
        for name, at in used.items():
            try:
                columns[name].append(float(cells[at]))
            except ValueError:
                remedy = "write decimal points" if "," in cells[at] else "correct it, or put # before a remark"
                problem = f"{_quote(cells[at])} is no number"
                raise InputError(f"row {number}, column {name}: {problem}; {remedy}") from None
    return {name: np.array(values, dtype=float) for name, values in columns.items()}


def _read_npz(data: bytes, columns: Sequence[str]) -> _Table:
    with _guarded("not a readable NPZ file", _SAVE_NPZ):
        archive = np.load(io.BytesIO(data), allow_pickle=False)
    if not isinstance(archive, np.lib.npyio.NpzFile):
        raise InputError(f"a single array, not an NPZ archive; {_SAVE_NPZ}")
    return _from_variables(archive, columns, lambda k: f"element [{k}]")


def _read_mat(data: bytes, columns: Sequence[str]) -> _Table:
    with _guarded("not a readable MAT file", _SAVE_MAT):
        variables = matfile.variables(data)
    return _from_variables(variables, columns, lambda k: f"element ({k + 1})")


@contextmanager
def _guarded(what: str, remedy: str) -> Iterator[None]:
    """Run a reader on unchecked bytes: whatever it raises or warns of, nothing but InputError comes out."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            warnings.filterwarnings("error", "Reached EOF prematurely")  # a WAV file cut short
            yield
    except Exception as error:
        raise InputError(f"{what} ({_quote(str(error) or type(error).__name__)}); {remedy}") from error


def _from_variables(named: Mapping[str, object], columns: Sequence[str], place: Callable[[int], str]) -> _Table:
    """The chosen columns among the named variables; without `columns`, all whose names end in a unit."""
    wanted = [name for name in columns if name != _SKIPPED] or [
        name for name in named if name not in _HEADER and _UNIT_SUFFIX.search(name)
    ]
    _check_names(wanted, list(named))
    header = {name: _column(named, name) for name in _HEADER if name in named}
    return _Table({name: _column(named, name) for name in wanted}, header, place)


def _column(named: Mapping[str, object], name: str) -> FloatArray:
    with _guarded(f"variable {name} is not readable", _SAVE_NPZ):  # NPZ reads a variable only now
        array = np.asarray(named[name])
    if array.dtype.kind not in "iuf" or array.size != max(array.shape, default=1):
        found = f"{_quote(str(array.dtype))} of shape {array.shape}"
        raise InputError(f"variable {name} is {found}: must be one row or column of real numbers; convert it")
    return np.asarray(array.ravel(), dtype=float)


def _read_wav(data: bytes, full_scale_m_s2: float | None) -> _Table:
    if full_scale_m_s2 is None or not 0 < full_scale_m_s2 <= _LARGEST:
        need = "WAV needs the acceleration of full scale, > 0 m/s^2; state it in the scene, for example 490.3"
        raise InputError(f"recordings.full_scale_m_s2 = {full_scale_m_s2}: {need}")
    with _guarded("not a readable WAV file", "export it again as PCM or float WAV"):
        rate_Hz, samples = wavfile.read(io.BytesIO(data))
    if samples.ndim != 1:
        raise InputError(f"{samples.shape[1]} channels, must be 1; export the accelerometer's as mono")
    values = np.asarray(samples, dtype=float)
    if samples.dtype.kind == "u":  # 8 bits and less are stored with an offset
        values = (values - 128.0) / 128.0
    elif samples.dtype.kind == "i":
        values = values / 2.0 ** (8 * samples.dtype.itemsize - 1)
    columns = {"time_s": np.arange(values.size) / rate_Hz, "acceleration_m_s2": full_scale_m_s2 * values}
    return _Table(columns, {}, lambda k: f"sample {k}")


def _check_names(names: Sequence[str], found: Sequence[str] = ()) -> None:
    """Known names (of the variables `found`), each quantity at most once, one time and one acceleration."""
    present = _quote(", ".join(found or names))
    used = [name for name in names if name != _SKIPPED]
    for name in used:
        if name not in _COLUMNS:
            remedy = "rename it, or list what to read in recordings.columns"
            raise InputError(f"unknown column {_quote(name)}; known: {', '.join(_COLUMNS)}; {remedy}")
        if found and name not in found:
            raise InputError(f"no variable {name}; found: {present}; correct the name")
    for quantity in ("time", "acceleration", "position", "force", "current"):
        count = sum(_COLUMNS[name][0] == quantity for name in used)
        if count > 1 or (count == 0 and quantity in ("time", "acceleration")):
            choice = " or ".join(name for name, (of, _) in _COLUMNS.items() if of == quantity)
            raise InputError(f"{count} {quantity} columns in {present}: must be 1; name one {choice}")


def _signals(table: _Table) -> dict[str, Signal]:
    """Every quantity of the table but time, in SI, on one uniform grid."""
    sizes = {name: values.size for name, values in table.columns.items()}
    size = min(sizes.values())
    if max(sizes.values()) != size:
        listed = ", ".join(f"{name} {n}" for name, n in sizes.items())
        raise InputError(f"columns differ in length ({listed} samples); save them equally long")
    if size < _MIN_SAMPLES:
        raise InputError(f"{size} samples, at least {_MIN_SAMPLES} are needed; record a longer piece")
    si = {_COLUMNS[name][0]: _to_si(name, values, table.place) for name, values in table.columns.items()}
    times = si.pop("time")
    step_s, is_uniform = _time_grid(times, table.place)
    first = si["acceleration"][0]
    if np.all(si["acceleration"] == first):
        raise InputError(f"recording is constant at {first:g} m/s^2 throughout: is the sensor connected?")
    if not is_uniform:
        grid = times[0] + step_s * np.arange(size)
        si = {quantity: np.asarray(CubicSpline(times, values)(grid)) for quantity, values in si.items()}
    return {quantity: Signal(float(times[0]), step_s, values) for quantity, values in si.items()}


def _to_si(name: str, values: FloatArray, place: Callable[[int], str]) -> FloatArray:
    converted = _COLUMNS[name][1] * values
    bad = np.flatnonzero(~(np.abs(converted) <= _LARGEST))
    if bad.size:
        at = int(bad[0])
        limit = f"must be finite and at most {_LARGEST:g} in SI units"
        raise InputError(f"{place(at)}, column {name}: {values[at]:g}: {limit}; correct it or cut the file")
    return converted


def _time_grid(times: FloatArray, place: Callable[[int], str]) -> tuple[float, bool]:
    """Mean step [s] of the times (n,) [s], and whether they lie on the uniform grid of that step."""
    steps = np.diff(times)
    median = float(np.median(steps))
    at = int(np.argmax(steps <= 0))
    if steps[at] <= 0:
        order = f"time {times[at + 1]:.15g} s does not increase, before it {times[at]:.15g} s"
        raise InputError(f"{place(at + 1)}: {order}; sort the rows and remove repeated ones")
    low, high = _STEP_RANGE_S
    if not low <= median <= high:
        limit = f"must be {low:g} to {high:g} s; is time in the unit its name states?"
        raise InputError(f"median time step {median:g} s: {limit}")
    irregular = (steps < _BUNCHED * median) | (steps > _GAP * median)
    at = int(np.argmax(irregular))
    if irregular[at]:
        what = "sample dropped" if steps[at] > median else "samples bunched"
        found = f"step {1e3 * steps[at]:.4g} ms, median {1e3 * median:.4g} ms"
        remedy = f"must be {_BUNCHED:g} to {_GAP:g} medians; cut the file there or record again"
        raise InputError(f"{what} after {place(at)} ({times[at]:.15g} s): {found}; {remedy}")
    mean = float(times[-1] - times[0]) / steps.size
    # The stamps are judged, not the steps: steps 1 % too long and later 1 % too short would each pass, yet
    # shift the middle of 1000 samples by five.
    off_grid_s = np.abs(times - (times[0] + mean * np.arange(times.size)))
    return mean, bool(np.all(off_grid_s <= _UNIFORM * median))


def _stated(header: Mapping[str, object], argument: str, override: float | None) -> float | None:
    """Speed [m/s] or grip [N]: `override` if given, else what the file states, else None."""
    quantity = _HEADER[argument][0]
    stated = {key: value for key, value in header.items() if _HEADER[key][0] == quantity}
    if override is not None:
        stated = {argument: override}
    if not stated:
        return None
    if len(stated) > 1:
        raise InputError(f"the {quantity} is stated twice, by {' and '.join(stated)}; keep one of them")
    key, raw = stated.popitem()
    _, factor, unit = _HEADER[key]
    with _guarded(f"{key} is {_quote(str(raw))}: must be one number, without a unit", "correct it"):
        value = float(np.asarray(raw).item())  # of a string from text, a number or an array of one
    limit, is_allowed = (">= 0", value >= 0) if quantity == "grip" else ("> 0", value > 0)
    if not (is_allowed and value <= _LARGEST):
        raise InputError(f"{key} = {value:g} {unit}: must be {limit} and finite; correct it or leave it out")
    return factor * value


def _quote(text: str) -> str:
    """The text in quotes, on one line, at most 120 characters of it."""
    line = " ".join(text.split())
    return repr(line if len(line) <= 120 else line[:117] + "...")
