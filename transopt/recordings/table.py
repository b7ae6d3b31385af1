"""The columns of a file, checked and converted: SI signals on one uniform time grid.

Taps on real objects (`transopt.recordings.recording`) and runs of a device (`transopt.identify.measurement`) are both
read by `read_table`, each with its own vocabulary. Errors are raised without the file's name; `read_table` puts it in
front of all of them.
"""

import hashlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import scipy

from transopt.base.errors import InputError
from transopt.base.signals import FloatArray, Signal
from transopt.recordings.formats import (
    LARGEST,
    MIN_SAMPLES,
    RawTable,
    Vocabulary,
    guarded,
    quote,
    read_bytes,
    read_raw,
)

_UNIFORM = 0.01  # of the median step: how far a time stamp may lie from the uniform grid
# Of the median step. Above: a sample is missing. Below: an interpolating spline amplifies noise tenfold.
_BUNCHED, _GAP = 0.1, 1.5


@dataclass(frozen=True)
class Table:
    """What one file held.

    Attributes
    ----------
    signals : quantity -> signal in SI, all on the uniform grid of the mean time step, resampled to it by a cubic
        spline if a time stamp lay off that grid by more than 1 % of a step.
    scalars : quantity -> SI value, of those that the file states.
    sha256 : of the file's bytes.
    off_grid : how far a time stamp lay off the uniform grid at most, in steps.
    """

    signals: Mapping[str, Signal]
    scalars: Mapping[str, float]
    sha256: str
    off_grid: float


def read_table(
    path: Path,
    words: Vocabulary,
    *,
    columns: Sequence[str] = (),
    full_scale_m_s2: float | None = None,
) -> Table:
    """Read one file; the format follows from the suffix.

    Parameters
    ----------
    path : .csv, .txt, .dat, .npz, .mat (-v6 or -v7) or .wav.
    words : names of columns and scalars.
    columns : names of the file's columns, "-" for one to skip. Text needs them, in CSV they replace the
        header row, in NPZ and MAT they choose the variables; WAV ignores them.
    full_scale_m_s2 : acceleration of full scale [m/s^2], needed by WAV and ignored by the others.

    Raises
    ------
    InputError : one line, file first, whatever is wrong.
    """
    try:
        data = read_bytes(path)
        with np.errstate(all="ignore"):  # overflow in absurd values: found as inf by the checks
            raw = read_raw(path.suffix, data, columns, full_scale_m_s2, words)
            signals, off_grid = _signals(raw, words)
            scalars = {}
            for quantity in dict.fromkeys(scalar.quantity for scalar in words.header.values()):
                value = _stated(raw.header, quantity, words)
                if value is not None:
                    scalars[quantity] = value
    except InputError as error:
        # A message is one line, a file's name need not be.
        file = str(path) if str(path).isprintable() else repr(str(path))
        raise InputError(f"{file}: {error}") from error
    return Table(signals, scalars, hashlib.sha256(data).hexdigest(), off_grid)


def _signals(table: RawTable, words: Vocabulary) -> tuple[dict[str, Signal], float]:
    """Every quantity of the table but time, in SI, on one uniform grid; and how far stamps lay off it, in steps."""
    sizes = {name: values.size for name, values in table.columns.items()}
    size = min(sizes.values())
    if max(sizes.values()) != size:
        listed = ", ".join(f"{name} {n}" for name, n in sizes.items())
        raise InputError(f"columns differ in length ({listed} samples); save them equally long")
    if size < MIN_SAMPLES:
        raise InputError(f"{size} samples, at least {MIN_SAMPLES} are needed; record a longer piece")
    si = {words.columns[name][0]: _to_si(name, values, table.place, words) for name, values in table.columns.items()}
    times = si.pop("time")
    step_s, off_grid = _time_grid(times, table.place, words.step_s)
    if off_grid > _UNIFORM:
        grid = times[0] + step_s * np.arange(size)
        si = {
            quantity: np.asarray(scipy.interpolate.CubicSpline(times, values)(grid))
            for quantity, values in si.items()
        }
    return {quantity: Signal(float(times[0]), step_s, values) for quantity, values in si.items()}, off_grid


def _to_si(name: str, values: FloatArray, place: Callable[[int], str], words: Vocabulary) -> FloatArray:
    converted = words.columns[name][1] * values
    bad = np.flatnonzero(~(np.abs(converted) <= LARGEST))
    if bad.size:
        at = int(bad[0])
        limit = f"must be finite and at most {LARGEST:g} in SI units"
        raise InputError(f"{place(at)}, column {name}: {values[at]:g}: {limit}; correct it or cut the file")
    return converted


def _time_grid(
    times: FloatArray, place: Callable[[int], str], step_range_s: tuple[float, float]
) -> tuple[float, float]:
    """Mean step [s] of the times (n,) [s], and how far off the grid of that step they lie, in median steps."""
    steps = np.diff(times)
    median = float(np.median(steps))
    at = int(np.argmax(steps <= 0))
    if steps[at] <= 0:
        order = f"time {times[at + 1]:.15g} s does not increase, before it {times[at]:.15g} s"
        raise InputError(f"{place(at + 1)}: {order}; sort the rows and remove repeated ones")
    low, high = step_range_s
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
    # The stamps are compared, not the steps: steps 1 % too long and later 1 % too short would each pass, yet
    # shift the middle of 1000 samples by five.
    off_grid_s = np.abs(times - (times[0] + mean * np.arange(times.size)))
    return mean, float(off_grid_s.max()) / median


def _stated(header: Mapping[str, object], quantity: str, words: Vocabulary) -> float | None:
    """The quantity in SI as the file states it, else None."""
    of = {key for key, scalar in words.header.items() if scalar.quantity == quantity}
    stated = {key: value for key, value in header.items() if key in of}
    if not stated:
        return None
    if len(stated) > 1:
        raise InputError(f"the {quantity} is stated twice, by {' and '.join(stated)}; keep one of them")
    key, raw = next(iter(stated.items()))
    scalar = words.header[key]
    with guarded(f"{key} is {quote(str(raw))}: must be one number, without a unit", "correct it"):
        value = float(np.asarray(raw).item())  # of a string from text, a number or an array of one
    limit, is_allowed = (">= 0", value >= 0) if scalar.zero else ("> 0", value > 0)
    if not (is_allowed and value <= LARGEST):
        raise InputError(f"{key} = {value:g} {scalar.unit}: must be {limit} and finite; correct it or leave it out")
    return scalar.factor * value
