"""The file of one identification trial, which `transopt identify` reads."""

from collections.abc import Iterable, Mapping
from pathlib import Path

import numpy as np

from transopt.base.errors import InputError
from transopt.base.files import whole_file
from transopt.base.signals import FloatArray

COLUMNS = (
    "time_s",
    "command_A",
    "current_A",
    "acceleration_m_s2",
    "position_m",
    "force_N",
    "winding_C",
    "housing_C",
    "ambient_C",
    "voltage_V",
)
SCALARS = ("grip_N", "accelerometer_Hz", "speed_m_s", "held_out", "period_s")


def refuse_old(folder: Path, names: Iterable[str]) -> None:
    """Refuse to overwrite a recording."""
    old = next((name for name in names if (folder / name).exists()), None)
    if old is not None:
        raise InputError(f"--out {folder}: holds a recording already ({old}); choose another folder")


def write_measurement(path: Path, columns: Mapping[str, FloatArray], scalars: Mapping[str, float]) -> None:
    """Write one measurement as NPZ, completely or not at all: columns as arrays by name, scalars of shape ().

    Parameters
    ----------
    columns : some of `COLUMNS`, `time_s` among them; (n,) each, finite. Row k was measured at `time_s[k]`; its
        command is held from there to the next row.
    scalars : some of `SCALARS`. grip_N : mean over the trial. accelerometer_Hz : bandwidth, one pole.
        held_out : 1 for a trial held out for validation. period_s : period of the excitation.

    Raises
    ------
    ValueError : an unknown name, columns of unequal length, or a value that is not finite.
    InputError : the file cannot be written.
    """
    strange = (set(columns) - set(COLUMNS)) | (set(scalars) - set(SCALARS))
    if strange or "time_s" not in columns:
        raise ValueError(f"columns {sorted(columns)}, scalars {sorted(scalars)}")
    arrays = {name: np.asarray(value, dtype=float) for name, value in {**columns, **scalars}.items()}
    rows = {arrays[name].shape for name in columns}
    if len(rows) != 1 or len(next(iter(rows))) != 1 or any(arrays[name].shape != () for name in scalars):
        raise ValueError(f"shapes { {name: array.shape for name, array in arrays.items()} }")
    for name, array in arrays.items():
        if not np.all(np.isfinite(array)):
            raise ValueError(f"{name}: not every value is a finite number")
    with whole_file(path) as file:
        np.savez_compressed(file, **arrays)  # type: ignore[arg-type]
