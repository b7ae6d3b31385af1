"""The file formats of signals, each read as it stands in the file: text, arrays, loggers' files and WAV.

Each format has one function that returns the file's columns in the file's own units; nothing is checked but the
columns' names (`transopt.recordings.names`), for which the reader has a `Vocabulary`. `transopt.recordings.table`
checks and converts all of them alike.
"""

import io
from collections import Counter
from collections.abc import Callable, Collection, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from transopt.base import mat5
from transopt.base.errors import InputError
from transopt.base.npz import Archive
from transopt.base.signals import FloatArray
from transopt.recordings.containers import HDF5, Channels, guarded, hdf5_datasets, sheet_as_text, tdms_channels
from transopt.recordings.names import (
    SKIPPED,
    Layout,
    Meaning,
    Vocabulary,
    apart,
    looks_known,
    meanings,
    means_acceleration,
    means_time,
    quote,
    stated_for,
)
from transopt.recordings.raw_table import LARGEST, RawTable, check_size, without_times
from transopt.recordings.text import read_text, untimed

_SAVE_NPZ = "save real numeric arrays with numpy.savez (no objects, no pickles)"
_SAVE_MAT = "save it in MATLAB with -v7"
_AXES = "xyz"


def read_raw(suffix: str, data: bytes, layout: Layout, words: Vocabulary) -> RawTable:
    """Read the bytes of a file in the format that its suffix names.

    Parameters
    ----------
    suffix : with its dot, in any case.
    data : the file's bytes.
    layout : what the user states about the file.
    words : names of columns and scalars.

    Raises
    ------
    InputError : an unknown format or column, or content that is not of the format.
    """
    words = words.knowing(layout.units or {})
    if layout.rate_Hz is None:
        return _read(suffix, data, layout, words)
    return _read(suffix, data, layout, without_times(words)).timed(1 / layout.rate_Hz)


def _read(suffix: str, data: bytes, layout: Layout, words: Vocabulary) -> RawTable:
    match suffix.lower():
        case ".csv" | ".txt" | ".dat" | ".tsv" | ".lvm":
            return read_text(data, layout, words)
        case ".xlsx" | ".xlsm" | ".xls" | ".ods":
            return read_text(sheet_as_text(data), layout, words)
        case ".tdms":
            return _from_channels(tdms_channels(data), layout, words)
        case ".h5" | ".hdf5":
            return _from_channels(hdf5_datasets(data), layout, words)
        case ".npz":
            return _read_npz(data, layout, words)
        case ".mat":
            return _read_mat(data, layout, words)
        case ".wav":
            return _read_wav(data, layout)
    known = ".csv, .tsv, .txt, .dat, .lvm, .xlsx, .ods, .npz, .mat, .tdms, .h5, .wav"
    raise InputError(f"unknown format {quote(suffix)}; known: {known}; export it as CSV")


def refuse_idle(layout: Layout, suffixes: Collection[str]) -> None:
    """Refuse what a user states about files of which none has a use for it.

    Parameters
    ----------
    suffixes : of all files that the layout is for, with their dots, in any case.

    Raises
    ------
    InputError : one line that names the option and what to do instead.
    """
    sounds = [suffix.lower() == ".wav" for suffix in suffixes]
    if sounds and all(sounds):
        if layout.columns:
            raise InputError(
                f"--columns {','.join(layout.columns)} (in a scene recordings.columns): a WAV file has channels, no "
                "columns; leave it out and choose one, --channel 1"
            )
        if layout.units:
            name, unit = next(iter(layout.units.items()))
            raise InputError(
                f"--units {name}={unit} (in a scene recordings.units): a WAV file has no units; leave it out and "
                "state the acceleration of full scale in m/s^2, --full-scale 490.3"
            )
        if layout.rate_Hz is not None:
            raise InputError(
                f"--rate-Hz {layout.rate_Hz:g} (in a scene recordings.rate_Hz): a WAV file states its "
                "own; leave it out, or correct the file's"
            )
    if not any(sounds):
        if layout.channel is not None:
            raise InputError(
                f"--channel {layout.channel} (in a scene recordings.channel): only a WAV file has channels; leave it "
                "out and choose columns, --columns time_s,-,acceleration_g"
            )
        if layout.full_scale_m_s2 is not None:
            raise InputError(
                f"--full-scale {layout.full_scale_m_s2:g} (in a scene recordings.full_scale_m_s2): only a WAV file "
                "has a full scale; leave it out and state units, --units acceleration=g"
            )


def _read_npz(data: bytes, layout: Layout, words: Vocabulary) -> RawTable:
    with guarded("not a readable NPZ file", _SAVE_NPZ):
        archive = Archive(data)
    return _from_variables(archive, layout, words, lambda k: f"element [{k}]")


def _read_mat(data: bytes, layout: Layout, words: Vocabulary) -> RawTable:
    if data[512:520] == HDF5:  # what -v7.3 writes
        return _from_channels(hdf5_datasets(data), layout, words)
    with guarded("not a readable MAT file", _SAVE_MAT):
        variables = mat5.variables(data)
    return _from_variables(variables, layout, words, lambda k: f"element ({k + 1})")


def _from_channels(found: Channels, layout: Layout, words: Vocabulary) -> RawTable:
    """Variables of a logger's file, whose step stands in for times that it does not have."""
    has_times = any(means_time(name, words) for name in found.values)
    if found.step_s is None or layout.rate_Hz or has_times:
        return _from_variables(found.values, layout, words, lambda k: f"sample {k}")
    raw = _from_variables(found.values, layout, without_times(words), lambda k: f"sample {k}")
    return raw.timed(found.step_s, found.start_s)


def _from_variables(
    named: Mapping[str, object], layout: Layout, words: Vocabulary, place: Callable[[int], str]
) -> RawTable:
    """The chosen columns among the variables; without a choice, all whose names end in a unit or are given one."""
    units, reads = layout.units or {}, _parted(named, words)
    candidates = [name for name in reads if name not in words.header]
    chosen = layout.columns or [
        name
        for name in candidates
        if words.unit_suffix.search(name) or apart(name)[1] or stated_for(name, words, units)
    ]
    if "magnitude" in words.quantities and not layout.columns:
        _refuse_unstated(reads, [name for name in candidates if name not in chosen], units)
    # Names that mean something are asked about where none has a unit.
    chosen = chosen or [name for name in candidates if looks_known(name, words)]
    wanted = [name for name in untimed(chosen, layout, words) if name != SKIPPED]
    known = meanings(wanted, words, units, list(reads))
    columns = dict[str, FloatArray]()
    for name in wanted:
        values = _column(reads[name], name, is_complex=known[name].quantity == "magnitude")
        if np.iscomplexobj(values):
            means = known.pop(name)
            for part, of in (("real", values.real), ("imaginary", values.imag)):
                columns[f"{name} ({part} part)"] = np.asarray(of)
                known[f"{name} ({part} part)"] = means._replace(quantity=part)
        else:
            columns[name] = values
    header = {name: _column(reads[name], name) for name in words.header if name in reads}
    return RawTable(columns, known, header, place)


def _refuse_unstated(
    reads: Mapping[str, Callable[[], object]], names: Sequence[str], units: Mapping[str, str]
) -> None:
    """Ask for the unit of a complex array, which is a response if anything is.

    Raises
    ------
    InputError : there is one.
    """
    for name in names:
        with guarded(f"variable {name} is not readable", _SAVE_NPZ):
            found = np.iscomplexobj(np.asarray(reads[name]()))
        if found:
            stated = ",".join(f"{key}={unit}" for key, unit in {"frequency": "Hz", **units, name: "m/s^2/V"}.items())
            raise InputError(
                f"variable {name} is complex, as a response is, and nothing states its unit: --units {stated}, or "
                "what else it is"
            )


def _parted(named: Mapping[str, object], words: Vocabulary) -> dict[str, Callable[[], object]]:
    """What reads each variable, by its name within a structure where that is clear; axes of an acceleration apart."""
    short = Counter(name.rpartition(".")[2] for name in named)
    found: dict[str, Callable[[], object]] = {}
    for name in named:
        last = name.rpartition(".")[2]
        key = last if short[last] == 1 else name
        found[key] = partial(named.__getitem__, name)
        if means_acceleration(key, words):
            with guarded(f"variable {name} is not readable", _SAVE_NPZ):
                values = np.asarray(named[name])
            rows = values if values.ndim == 2 and values.shape[0] == len(_AXES) else values.T
            if values.ndim == 2 and rows.shape[0] == len(_AXES) < rows.shape[1]:
                base, unit = apart(key)
                behind = f" [{unit}]" if unit else ""
                del found[key]
                found |= {f"{base} {axis}{behind}": partial(rows.__getitem__, k) for k, axis in enumerate(_AXES)}
    return found


def _column(read: Callable[[], object], name: str, *, is_complex: bool = False) -> NDArray[Any]:
    with guarded(f"variable {name} is not readable", _SAVE_NPZ):  # NPZ reads a variable when it is asked for
        values = np.asarray(read())
    if values.dtype.kind not in ("iufc" if is_complex else "iuf") or values.size != max(values.shape, default=1):
        found = f"{quote(str(values.dtype))} of shape {values.shape}"
        raise InputError(f"variable {name} is {found}: must be one row or column of real numbers; convert it")
    check_size(values.size)
    return np.asarray(values.ravel(), dtype=complex if values.dtype.kind == "c" else float)


def _read_wav(data: bytes, layout: Layout) -> RawTable:
    full_scale_m_s2, channel = layout.full_scale_m_s2, layout.channel
    if full_scale_m_s2 is None or not 0 < full_scale_m_s2 <= LARGEST:
        need = "WAV needs the acceleration of full scale, > 0 m/s^2; state it, here or by --full-scale 490.3"
        raise InputError(f"recordings.full_scale_m_s2 = {full_scale_m_s2}: {need}")
    with guarded("not a readable WAV file", "export it again as PCM or float WAV"):
        rate_Hz, samples = scipy.io.wavfile.read(io.BytesIO(data))
    count = 1 if samples.ndim == 1 else samples.shape[1]
    if channel is None and count > 1:
        choice = "--channel 1 (in a scene recordings.channel = 1)"
        raise InputError(f"{count} channels, and which is the accelerometer's is not stated; choose one: {choice}")
    if channel is not None and not 1 <= channel <= count:
        raise InputError(f"--channel {channel}: the file has {count}; choose 1 to {count}")
    samples = samples.reshape(-1, count)[:, (channel or 1) - 1]
    check_size(samples.size)
    values = np.asarray(samples, dtype=float)
    if samples.dtype.kind == "u":  # 8 bits and less are stored with an offset
        values = (values - 128.0) / 128.0
    elif samples.dtype.kind == "i":
        values = values / 2.0 ** (8 * samples.dtype.itemsize - 1)
    known = {"acceleration_m_s2": Meaning("acceleration", 1.0)}
    raw = RawTable({"acceleration_m_s2": full_scale_m_s2 * values}, known, {}, lambda k: f"sample {k}")
    return raw.timed(float(np.divide(1.0, rate_Hz)))
