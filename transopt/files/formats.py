"""The file formats of signals, each read as the file states it: text, arrays, loggers' files and WAV.

Each format has one function that returns the file's columns in the file's own units. It checks nothing but the
columns' names (`transopt.files.names`), for which the reader has a `Vocabulary`. `transopt.files.table`
checks and converts the columns of all formats.
"""

import io
import math
from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np
import scipy

from transopt.base.errors import InputError
from transopt.base.files import read_file
from transopt.base.npz import Archive
from transopt.base.signals import STANDARD_GRAVITY_M_S2, AnyArray, FloatArray
from transopt.base.sizes import MOST_RECORD_BYTES
from transopt.files import mat5
from transopt.files.containers import HDF5, Channels, guarded, hdf5_datasets, sheet_as_text, tdms_channels
from transopt.files.meanings import meanings
from transopt.files.names import (
    MOST_CHOICES,
    SKIPPED,
    Layout,
    Meaning,
    Vocabulary,
    apart,
    labelled,
    quote,
    spared,
    stated_for,
    with_axes,
)
from transopt.files.raw_table import LARGEST, RawTable, check_size
from transopt.files.statements import Rate, rate_of
from transopt.files.text import read_text, text_columns, untimed
from transopt.files.unclear import Answer, UnclearError, chosen_channel, options
from transopt.files.units import is_unit, known_units, read_unit
from transopt.files.universal_file import universal_columns

_SAVE_NPZ = "save real numeric arrays with numpy.savez (no objects, no pickles)"
_SAVE_MAT = "save it in MATLAB with -v7"
OF_A_LIBRARY = {"meta", "command", "speeds_m_s"}  # arrays that show that `transopt solve` wrote the file
UNIVERSAL = (".uff", ".unv", ".u58")
_AXES = "xyz"
Arrays = Mapping[str, AnyArray]
# Fields of a structure that hold the unit of its other fields; the last is that of Simcenter Testlab.
UNIT_FIELDS = ("unit", "units", "quantity.label")
FULL_SCALES_G = (50.0, 10.0, 5.0, 100.0, 16.0, 2.0, 500.0, 1.0)  # full scales of common sensors and their recorders


def read_raw(suffix: str, data: bytes, layout: Layout, words: Vocabulary) -> RawTable:
    """Read the bytes of a file in the format named by its suffix.

    Parameters
    ----------
    suffix : with its dot, in any case.
    data : the file's bytes.
    layout : what the user states about the file.
    words : the vocabulary of columns and scalars.

    Raises
    ------
    InputError : the format or a column is unknown, or the content is not of the format.
    """
    words = words.knowing(layout.units or {})
    stated = None if layout.rate_Hz is None else Rate(1 / layout.rate_Hz)
    if stated is not None:
        words = words.without_times()
    raw, rate = _read(suffix, data, layout, words)
    rate = stated or rate
    return raw if rate is None else raw.timed(rate)


def _read(suffix: str, data: bytes, layout: Layout, words: Vocabulary) -> tuple[RawTable, Rate | None]:
    """The columns of a file, and the sample rate that it states in place of times."""
    if suffix.lower() == ".wav":
        return _read_wav(data, layout)
    notes = list[str]()
    opened = universal_columns(data, layout, words) if suffix.lower() in UNIVERSAL else _opened(suffix, data, notes)
    if not isinstance(opened, bytes):
        return _from_variables(opened, layout, words)
    raw, rate = read_text(opened, layout, words)
    return replace(raw, notes=(*notes, *raw.notes)), rate


def _opened(suffix: str, data: bytes, notes: list[str]) -> bytes | Channels:
    """The text of a file, or its variables, by suffix; `notes` receives what was left out."""
    match suffix.lower():
        case ".csv" | ".txt" | ".dat" | ".tsv" | ".lvm" | ".log" | ".asc":
            return data
        case ".xlsx" | ".xlsm" | ".xls" | ".ods":
            return sheet_as_text(data, notes)
        case ".tdms":
            return tdms_channels(data)
        case ".npz":
            with guarded("not a readable NPZ file", _SAVE_NPZ):
                archive = Archive(data)
            if archive.keys() >= OF_A_LIBRARY:
                raise InputError("a library of currents, no recording: `transopt show` prints it")
            return Channels(archive, place=lambda k: f"element [{k}]")
        case ".mat" if data[512:520] != HDF5:
            with guarded("not a readable MAT file", _SAVE_MAT):
                return Channels(mat5.variables(data), place=lambda k: f"element ({k + 1})")
        case ".h5" | ".hdf5" | ".mat":  # -v7.3 is HDF5
            return hdf5_datasets(data)
    known = ".csv, .tsv, .txt, .dat, .log, .asc, .lvm, .xlsx, .ods, .npz, .mat, .tdms, .h5, .uff, .wav"
    raise InputError(f"unknown format {quote(suffix)}; known: {known}; export it as CSV")


def columns_of(path: Path, words: Vocabulary) -> dict[str, FloatArray]:
    """The numeric columns of a file, whatever they mean; empty if there are none or the file is unreadable."""
    with suppress(InputError):
        data = read_file(path, MOST_RECORD_BYTES, "")
        if path.suffix.lower() == ".wav":
            return {f"channel {k + 1}": each for k, each in enumerate(_sound(data)[1].T)}
        opened = _opened(path.suffix, data, [])
        return text_columns(opened, words) if isinstance(opened, bytes) else numeric(_parted(opened.values, words))
    return {}


def refuse_idle(layout: Layout, suffixes: Collection[str]) -> None:
    """Refuse settings of the layout that none of the files can use.

    Parameters
    ----------
    suffixes : suffixes of all files that the layout is for, with their dots, in any case.
    """
    kinds = {suffix.lower() for suffix in suffixes}
    of_sounds, of_others = kinds == {".wav"}, bool(kinds) and ".wav" not in kinds
    with_channels = {".wav", *UNIVERSAL}
    idle = {
        "columns": (
            bool(kinds) and kinds <= with_channels,
            "WAV and universal files have no columns; leave it out and choose one, --channel 1",
        ),
        "units": (of_sounds, "a WAV file has no units; leave it out and state its full scale, --full-scale 490.3"),
        "rate_Hz": (of_sounds, "a WAV file states its own; leave it out, or correct the file's"),
        "channel": (
            bool(kinds) and not kinds & with_channels,
            "only WAV and universal files have channels; leave it out and choose columns, --columns time_s,-,acc_g",
        ),
        "full_scale_m_s2": (of_others, "only a WAV file has a full scale; leave it out, --units acceleration=g"),
    }
    for key, (is_idle, why) in idle.items():
        if is_idle and (value := getattr(layout, key)):
            raise InputError(f"{options({key: value})} (in a scene recordings.{key}): {why}")


def _from_variables(found: Channels, layout: Layout, words: Vocabulary) -> tuple[RawTable, Rate | None]:
    """The chosen variables as columns; without a choice, those whose names end in a unit or are given one.

    Returns
    -------
    The columns, and the sample rate that the file states in place of times.
    """
    units, arrays = layout.units or {}, _parted(found.values, words)
    if words.absent(arrays):
        words = words.labelled(list(numeric(arrays)))
    rate = None
    if "time" in words.absent(arrays) and (rate := found.rate or rate_of([], _scalars(arrays))):
        words = words.without_times()
    notes = list[str]()
    chosen = layout.columns or spared(_chosen(arrays, words, units), words, notes)
    wanted = [name for name in untimed(chosen, layout, words) if name != SKIPPED]
    known = meanings(wanted, words, units, list(arrays), lambda: numeric(arrays))
    columns = dict[str, FloatArray]()
    for name in wanted:
        values = _column(arrays[name], name, is_complex=known[name].quantity == "magnitude")
        if not np.iscomplexobj(values):
            columns[name] = values
            continue
        means = known.pop(name)
        if math.isnan(means.unit.factor):
            problem = f"variable {name} is complex, and a level in dB has no phase"
            raise InputError(f"{problem}; state its unit, --units magnitude=m/s^2/V")
        for part, of in (("real", values.real), ("imaginary", values.imag)):
            columns[f"{name} ({part} part)"] = np.asarray(of)
            known[f"{name} ({part} part)"] = means._replace(quantity=part)
    header = {name: _column(arrays[name], name) for name in words.header if name in arrays}
    return RawTable(columns, known, header, found.place, tuple(notes)), rate


def _chosen(arrays: Arrays, words: Vocabulary, units: Mapping[str, str]) -> list[str]:
    """The variables that are columns: with a unit in their name or a stated unit, and others that are required."""
    candidates = [name for name in arrays if name not in words.header]
    known = [name for name in candidates if words.quantity_of(name) is not None]
    chosen = [name for name in candidates if words.is_meant(name) or apart(name)[1] or stated_for(name, words, units)]
    if not set(chosen) <= set(known):
        vectors = numeric(arrays)
        chosen = [name for name in chosen if name in known or name in vectors]
    if "magnitude" in words.quantities:
        _refuse_unstated(arrays, [name for name in candidates if name not in chosen], words, chosen)
    if chosen and (absent := words.absent(chosen)):
        chosen += [name for name in numeric(arrays) if words.quantity_of(name) in absent]
    # If no name has a unit, names with a meaning are returned, and their units are asked for.
    return chosen or known or candidates


def _scalars(arrays: Arrays) -> list[str]:
    """The variables that hold one number, as `name = value` lines."""
    found = list[str]()
    for name, array in arrays.items():
        with suppress(InputError):
            values = _column(array, name).real
            if values.size == 1:
                found.append(f"{apart(name)[0]} = {values[0]:.17g}")
    return found


def numeric(arrays: Arrays) -> dict[str, FloatArray]:
    """The variables that are rows or columns of real numbers, of the greatest length among them."""
    found = dict[str, FloatArray]()
    for name, array in arrays.items():
        with suppress(InputError):
            found[name] = _column(array, name).real
    longest = max((values.size for values in found.values()), default=0)
    return {name: values for name, values in found.items() if values.size == longest}


def _refuse_unstated(arrays: Arrays, names: Sequence[str], words: Vocabulary, chosen: Sequence[str]) -> None:
    """Ask for the unit of a complex array, since a complex array is most likely a response.

    Parameters
    ----------
    names : arrays without a stated unit. chosen : the columns chosen among the others.
    """
    is_known = any(words.quantity_of(name) == "frequency" for name in chosen)
    for name in names:
        if np.iscomplexobj(arrays[name]):
            raise UnclearError(
                f"variable {name} is complex, as a response is, and nothing states its unit",
                [{"units": {**({} if is_known else {"frequency": "Hz"}), name: of}} for of in known_units("real")],
            )


def _parted(named: Mapping[str, object], words: Vocabulary) -> dict[str, AnyArray]:
    """The variables, by their names within a structure if these are unique; the rows of a matrix become columns.

    A matrix of three rows that is an acceleration becomes the axes x, y and z.
    """
    short = Counter(name.rpartition(".")[2] for name in named)
    found: dict[str, AnyArray] = {}
    for name in named:
        above, _, last = name.rpartition(".")
        key = last if short[last] == 1 else name
        unit = next((named[at] for of in UNIT_FIELDS if (at := f"{above}.{of}".strip(".")) in named), "")
        is_other = isinstance(unit, str) and words.quantity_of(key) == "time" and read_unit(unit, "time") is None
        if isinstance(unit, str) and is_unit(unit) and apart(key)[1] is None and not is_other:
            key = labelled(key, unit)
        with guarded(f"variable {name} is not readable", _SAVE_NPZ):  # NPZ reads a variable on access
            values = found[key] = np.asarray(named[name])
        if key in words.header:
            continue
        rows = values if values.ndim == 2 and values.shape[0] < values.shape[1] else values.T
        if values.ndim == 2 and values.dtype.kind in "iuf" and 1 < rows.shape[0] <= MOST_CHOICES < rows.shape[1]:
            is_sensor = rows.shape[0] == len(_AXES) and words.quantity_of(key) == "acceleration"
            base, unit = apart(key)
            del found[key]
            columns = _AXES if is_sensor else map(str, range(1, rows.shape[0] + 1))
            for k, which in enumerate(columns):
                found[labelled(f"{base} {which}", unit)] = rows[k]
    return dict(zip(with_axes(list(found)), found.values(), strict=True))


def _column(values: AnyArray, name: str, *, is_complex: bool = False) -> AnyArray:
    if values.dtype.kind not in ("iufc" if is_complex else "iuf") or values.size != max(values.shape, default=1):
        found = f"{quote(str(values.dtype))} of shape {values.shape}"
        raise InputError(f"variable {name} is {found}: must be one row or column of real numbers; convert it")
    check_size(values.size)
    return np.asarray(values.ravel(), dtype=complex if values.dtype.kind == "c" else float)


def full_scales() -> list[Answer]:
    """Possible full scales of a WAV file, as answers to a question."""
    return [{"full_scale_m_s2": float(f"{g * STANDARD_GRAVITY_M_S2:.4g}")} for g in FULL_SCALES_G]


def _read_wav(data: bytes, layout: Layout) -> tuple[RawTable, Rate]:
    """One channel of a WAV file, and its rate."""
    full_scale_m_s2 = layout.full_scale_m_s2
    if full_scale_m_s2 is None:
        raise UnclearError("the acceleration of a WAV file's full scale is not stated, in m/s^2", full_scales())
    if not 0 < full_scale_m_s2 <= LARGEST:
        raise InputError(f"recordings.full_scale_m_s2 = {full_scale_m_s2:g}: must be above 0 m/s^2 and finite")
    rate_Hz, values = _sound(data)
    values = values[:, chosen_channel(layout.channel, [""] * values.shape[1], "channels")]
    known = {"acceleration_m_s2": Meaning("acceleration")}
    raw = RawTable({"acceleration_m_s2": full_scale_m_s2 * values}, known, {}, lambda k: f"sample {k}")
    return raw, Rate(float(np.divide(1.0, rate_Hz)))


def _sound(data: bytes) -> tuple[float, FloatArray]:
    """Sample rate [Hz] and samples (n, channels) of a WAV file, at full scale 1."""
    with guarded("not a readable WAV file", "export it again as PCM or float WAV"):
        rate_Hz, samples = scipy.io.wavfile.read(io.BytesIO(data))
    check_size(samples.shape[0])
    values = np.asarray(samples.reshape(samples.shape[0], -1), dtype=float)
    if samples.dtype.kind == "u":  # WAV stores 8 bits and less as unsigned with an offset
        values = (values - 128.0) / 128.0
    elif samples.dtype.kind == "i":
        values = values / 2.0 ** (8 * samples.dtype.itemsize - 1)
    return float(rate_Hz), values
