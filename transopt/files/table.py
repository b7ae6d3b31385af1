"""Checks and converts the columns of a file to SI signals on one uniform time grid.

`read_table` serves every reader of signals over time, each with its own vocabulary. Errors are raised without the
file's name; `read_table` adds it in front.
"""

import hashlib
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import scipy

from transopt.base.errors import InputError
from transopt.base.files import read_file
from transopt.base.signals import FloatArray, IndexArray, Signal
from transopt.base.sizes import MOST_RECORD_BYTES
from transopt.files.containers import guarded
from transopt.files.formats import read_raw
from transopt.files.names import Layout, Vocabulary, axis_of, quote
from transopt.files.raw_table import LARGEST, MIN_SAMPLES, RawTable
from transopt.files.unclear import UnclearError, in_file
from transopt.files.units import UNITS, likely_units

_UNIFORM = 0.01  # steps: stamps closer than this to the uniform grid count as on it
_ASTRAY = 0.45  # steps: a stamp farther off the grid carries no time; its sample counts as missing
_MISSING = 0.01  # share of all samples that may be missing and are interpolated
_AT_MOST = f"at most {100 * _MISSING:g} % are interpolated; record again, or keep the rows of one stretch"
_IN_A_ROW = 1  # missing samples in a row that a spline can interpolate
_JITTER = 0.35  # steps, rms: above it the sampling instants are unknown
_BESIDE = 8  # stamps on either side of a long step, which show whether a row was lost
_DISORDER = 0.1  # share of steps that go back, above which the column is no time
_COUNTERS = [(bits, unit) for bits in (32, 16) for unit in ("us", "ms")]  # that micros() and millis() are, for two
_TINY = 1e-300
_AXES = ("x", "y", "z")
_NEIGHBOURS = 21  # stamps that each stamp is compared with


@dataclass(frozen=True)
class Table:
    """Content of one file, in SI.

    Attributes
    ----------
    signals : quantity -> signal in SI, all on the uniform grid of the mean time step, resampled to it by a cubic
        spline if a time stamp lay off that grid by more than 1 % of a step or a sample was missing.
    axes : x, y or z -> acceleration along it, if the file has several axes; `signals` then has no acceleration.
    scalars : quantity -> SI value, for those that the file states.
    sha256 : hash of the file's bytes.
    off_grid : rms distance of the time stamps from the uniform grid, in steps.
    missing : one sentence on what was interpolated; empty if no sample was missing.
    notes : what was left out, which columns were not used, stated units that contradict the file; one sentence
        each.
    """

    signals: Mapping[str, Signal]
    axes: Mapping[str, Signal]
    scalars: Mapping[str, float]
    sha256: str
    off_grid: float
    missing: str = ""
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class _Clock:
    """The uniform grid of a file's time stamps.

    Attributes
    ----------
    start_s, step_s : start and step of the grid.
    kept : (n,) rows of the file whose samples are kept.
    size : number of grid points.
    off_grid, missing : see `Table`.
    uniform : whether every stamp is on the grid and none is missing.
    """

    start_s: float
    step_s: float
    kept: IndexArray
    size: int
    off_grid: float
    missing: str
    uniform: bool


def read_table(path: Path, words: Vocabulary, layout: Layout | None = None) -> Table:
    """Read one file; the format follows from the suffix.

    Parameters
    ----------
    path : .csv, .txt, .dat, .npz, .mat (-v6 or -v7) or .wav.
    words : names of columns and scalars.
    layout : what the user states about the file.

    Raises
    ------
    InputError : one line, file first, that says what is wrong.
    """
    data = read_file(
        path, MOST_RECORD_BYTES, "name a recording, or several as tap_*.csv or FOLDER/*, in pieces if it is too long"
    )
    with in_file(path), np.errstate(all="ignore"):  # an overflow from absurd values becomes inf, which is refused
        if not data:
            raise InputError("is empty (0 bytes); record or export it again")
        raw = read_raw(path.suffix, data, layout or Layout(), words)
        notes: list[str] = []
        signals, clock = _signals(raw, words, notes)
        quantities = dict.fromkeys(scalar.quantity for scalar in words.header.values())
        stated = {quantity: _stated(raw.header, quantity, words) for quantity in quantities}
    axes = {name: signals.pop(name) for name in list(signals) if name in _AXES}
    scalars = {quantity: value for quantity, value in stated.items() if value is not None}
    notes += [*(each.note for each in raw.meanings.values() if each.note), *raw.notes]
    source_sha256 = hashlib.sha256(data).hexdigest()
    return Table(signals, axes, scalars, source_sha256, clock.off_grid, clock.missing, tuple(notes))


def _signals(table: RawTable, words: Vocabulary, notes: list[str]) -> tuple[dict[str, Signal], _Clock]:
    """Every quantity of the table except time, in SI, on one uniform grid; and that grid.

    Several axes of an acceleration are called x, y and z.

    Parameters
    ----------
    notes : receives sentences on what was left out or derived.
    """
    size = table.rows()
    if size < MIN_SAMPLES:
        raise InputError(f"{size} samples, at least {MIN_SAMPLES} are needed; record a longer piece")
    empty = np.any([np.isnan(values) for values in table.columns.values()], axis=0)
    kept = size - int(np.argmin(empty[::-1])) if not empty.all() else size
    if size / 2 < kept < size:
        notes.append(f"the last {size - kept} rows hold what is no number (NaN), and are left out")
        table = replace(table, columns={name: values[:kept] for name, values in table.columns.items()})
    table = _without_empty(table)
    quantities = {name: table.meanings[name].quantity for name in table.columns}
    several = Counter(quantities.values())["acceleration"] > 1
    called = {name: axis_of(name) if several and of == "acceleration" else of for name, of in quantities.items()}
    si = {called[name]: _to_si(name, values, table) for name, values in table.columns.items()}
    times = _unwrapped(si.pop("time"), notes)
    velocity = si.pop("velocity", None)
    if velocity is not None and "acceleration" not in quantities.values():
        notes.append("the acceleration is the slope of the velocity")
        in_order = bool(np.all(np.diff(times) > 0))  # if not, `_clock` refuses them
        slope = scipy.interpolate.CubicSpline(times, velocity)(times, 1) if in_order else velocity
        si["acceleration"] = np.asarray(slope)
    clock = _clock(times, table.place, words.step_s)
    if not clock.uniform:
        grid = clock.start_s + clock.step_s * np.arange(clock.size)
        moved = {
            quantity: np.asarray(scipy.interpolate.CubicSpline(times[clock.kept], values[clock.kept])(grid))
            for quantity, values in si.items()
        }
        if clock.missing or not _stamped_late(si, moved):
            si = moved
    return {quantity: Signal(clock.start_s, clock.step_s, values) for quantity, values in si.items()}, clock


def _without_empty(table: RawTable) -> RawTable:
    """The table without its few rows that lack a number, which count as lost like those that a recorder left out.

    A row without a time stays, and is refused.
    """
    timed = [name for name in table.columns if table.meanings[name].quantity == "time"]
    signals = [values for name, values in table.columns.items() if name not in timed]
    if not signals or any(np.isnan(table.columns[name]).any() for name in timed):
        return table
    empty = np.any([np.isnan(values) for values in signals], axis=0)
    rows = np.flatnonzero(~empty)
    if not 0 < np.count_nonzero(empty) <= max(_MISSING * empty.size, 1):
        return table
    columns = {name: values[rows] for name, values in table.columns.items()}
    return replace(table, columns=columns, place=lambda k: table.place(int(rows[k])))


def _stamped_late(as_read: Mapping[str, FloatArray], moved: Mapping[str, FloatArray]) -> bool:
    """Whether the samples were taken on the grid and only their stamps are off, as when a host stamps timed samples.

    Interpolated to the grid from their stamps, such samples become rougher, while samples truly taken off the grid
    become smoother. Roughness is the energy of fourth differences; its logarithm is averaged over the quantities. A
    command is left out, because interpolation never makes a staircase smoother.
    """
    ratios = [
        np.log((np.sum(np.diff(moved[name], 4) ** 2) + _TINY) / (np.sum(np.diff(values, 4) ** 2) + _TINY))
        for name, values in as_read.items()
        if name != "command"
    ]
    return bool(np.mean(ratios) > 0) if ratios else True


def _to_si(name: str, values: FloatArray, table: RawTable) -> FloatArray:
    converted = table.meanings[name].unit.factor * values
    bad = np.flatnonzero(~(np.abs(converted) <= LARGEST))
    if bad.size:
        at, lost = int(bad[0]), np.count_nonzero(np.isnan(values))
        limit, remedy = f"must be finite and at most {LARGEST:g} in SI units", "correct it or cut the file"
        if lost > max(_MISSING * values.size, 1):
            remedy = f"{lost} of {values.size} are lost or blank, {_AT_MOST}"
        raise InputError(f"{table.place(at)}, column {name}: {values[at]:g}: {limit}; {remedy}")
    return converted


def _unwrapped(times: FloatArray, notes: list[str]) -> FloatArray:
    """The times (n,) [s] of a counter that began anew, as if it had more bits; other times as they are.

    Parameters
    ----------
    notes : receives a sentence that names the counter.
    """
    steps = np.diff(times)
    back, median = steps < 0, float(np.median(steps))
    if not 0 < np.count_nonzero(back) <= _DISORDER * steps.size:
        return times
    for bits, unit in _COUNTERS:
        period_s = 2**bits * UNITS["time"][unit]
        if np.all(np.abs(steps[back] + period_s - median) < 0.5 * median):
            notes.append(f"the times begin anew after 2^{bits} {unit}, as a counter of {bits} bit does: they go on")
            return np.asarray(times + period_s * np.concatenate([[0], np.cumsum(back)]))
    return times


def _clock(times: FloatArray, place: Callable[[int], str], step_range_s: tuple[float, float]) -> _Clock:
    """The uniform grid of the stamps (n,) [s].

    The rms distance from the grid decides: the largest of 20 000 harmless distances is four times as large. A stamp
    far off the grid, such as late by most of a step, is no valid time; its sample counts as missing, like that of a
    lost row.
    """
    steps = np.diff(times)
    median = float(np.median(steps))
    at = int(np.argmax(steps <= 0))
    if steps[at] <= 0:
        order = f"time {times[at + 1]:.15g} s does not increase, before it {times[at]:.15g} s"
        many = np.count_nonzero(steps <= 0) > _DISORDER * steps.size
        begins = np.flatnonzero(steps > 0) + 1
        if many and (steps >= 0).all() and begins.size > 1:
            # The first and the last group may be incomplete; all between have full length.
            rate_Hz = (begins[-1] - begins[0]) / (times[begins[-1]] - times[begins[0]])
            raise UnclearError(
                f"{place(at + 1)}: the times repeat, in groups of {np.diff(begins).mean():.3g} rows, as of a "
                "sensor's buffer, and the sample rate is not stated",
                [{"rate_Hz": float(f"{rate_Hz:.5g}")}],
            )
        remedy = "is another column the time's?" if many else "sort the rows and remove repeated ones"
        raise InputError(f"{place(at + 1)}: {order}; {remedy}")
    low, high = step_range_s
    if not low <= median <= high:
        limit = f"must be {low:g} to {high:g} s: check the unit of the time"
        raise UnclearError(
            f"median time step {median:g} s: {limit}", [{"units": {"time": unit}} for unit in likely_units("time")]
        )
    periods = _periods(times, median)
    at = int(np.argmax(periods > 1 + _IN_A_ROW))
    if periods[at] > 1 + _IN_A_ROW:
        found = f"step {1e3 * steps[at]:.4g} ms, median {1e3 * median:.4g} ms: {periods[at] - 1:.0f} samples dropped"
        remedy = f"at most {_IN_A_ROW} in a row is interpolated; keep the rows before or behind it, or record again"
        raise InputError(f"after {place(at)} ({times[at]:.15g} s): {found}; {remedy}")
    index = np.concatenate([[0.0], np.cumsum(periods)])
    start, mean, late, jitter = _against_grid(times, index)
    good = np.abs(jitter) <= _ASTRAY
    size = int(index[-1] - index[0]) + 1
    lost = size - int(np.count_nonzero(good))
    missing = ""
    if lost:
        gaps = np.flatnonzero((np.diff(index) > 1) | ~good[1:])
        where = f"first after {place(int(gaps[0]))} ({times[gaps[0]]:.6g} s)" if gaps.size else "at its end"
        missing = f"{lost} of {size} samples lost or without a time, {where}"
        if lost > max(_MISSING * size, 1):
            raise InputError(f"{missing}: {_AT_MOST}")
        missing += ": interpolated"
    rms = float(np.sqrt(np.mean(jitter[good] ** 2)))
    if rms > _JITTER:
        limit = f"at most {_JITTER:g}; sample by a timer and record again"
        raise InputError(f"time stamps lie {rms:.2g} steps (rms) off a uniform grid: {limit}")
    uniform = not lost and float(np.abs(late).max()) <= _UNIFORM
    off_grid = float(np.sqrt(np.mean(late[good] ** 2)))
    return _Clock(start, mean, np.flatnonzero(good), size, off_grid, missing, uniform)


def _periods(times: FloatArray, median_s: float) -> FloatArray:
    """(n - 1,) periods between stamps (n,): 1, or more where a step is long and all later stamps are late as well.

    After a lost row all stamps are late by a period; after a single late stamp they are not.
    """
    periods = np.ones(times.size - 1)
    long = np.flatnonzero(np.diff(times) > 1.5 * median_s)
    if long.size:
        late = times / median_s - np.arange(times.size)
        near = np.arange(_BESIDE)
        before = np.median(late[np.maximum(long[:, None] - near, 0)], axis=1)
        behind = np.median(late[np.minimum(long[:, None] + 1 + near, times.size - 1)], axis=1)
        most = np.maximum(np.rint(np.diff(times)[long] / median_s), 1)
        periods[long] = np.clip(1 + np.rint(behind - before), 1, most)
    return periods


def _against_grid(times: FloatArray, index: FloatArray) -> tuple[float, float, FloatArray, FloatArray]:
    """Start and step [s] of the grid through stamps (n,) with indices (n,); lateness, also against neighbours.

    Indices count from 0; lateness is in steps. Stamps are compared instead of steps: steps that are first 1 % too
    long and later 1 % too short would each pass, yet shift the middle of 1000 samples by five. A clock may drift, so
    a single late stamp is judged against the median of its neighbours. The first and the last stamp are no better
    than the others: if any is off, the grid is the regression line through all valid stamps.
    """
    mean = float((times[-1] - times[0]) / index[-1])
    late = (times - times[0]) / mean - index
    usual = scipy.ndimage.median_filter(late, _NEIGHBOURS, mode="nearest")
    jitter = late - scipy.ndimage.uniform_filter(usual, 3 * _NEIGHBOURS, mode="nearest")
    good = np.abs(jitter) <= _ASTRAY
    if np.abs(late).max() <= _UNIFORM or np.count_nonzero(good) < 2:
        return float(times[0]), mean, late, jitter
    slope, first = np.polyfit(index[good], late[good], 1)
    return float(times[0] + first * mean), float(mean * (1 + slope)), late - first - slope * index, jitter


def _stated(header: Mapping[str, object], quantity: str, words: Vocabulary) -> float | None:
    """The quantity in SI as the file states it; None if the file does not state it."""
    of = {key for key, scalar in words.header.items() if scalar.quantity == quantity}
    stated = {key: value for key, value in header.items() if key in of}
    if not stated:
        return None
    if len(stated) > 1:
        raise InputError(f"the {quantity} is stated twice, by {' and '.join(stated)}; keep one of them")
    key, raw = next(iter(stated.items()))
    scalar = words.header[key]
    with guarded(f"{key} is {quote(str(raw))}: must be one number, without a unit", "correct it"):
        value = float(np.asarray(raw).item())  # a string from text, a number, or an array of one number
    limit, is_allowed = (">= 0", value >= 0) if scalar.zero else ("> 0", value > 0)
    if not (is_allowed and value <= LARGEST):
        raise InputError(f"{key} = {value:g} {scalar.unit}: must be {limit} and finite; correct it or leave it out")
    return scalar.factor * value
