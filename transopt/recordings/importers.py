"""Recordings of taps from files: a `Recording` in SI units out.

g, mm, mm/s and ms exist nowhere else in the project but in readers' vocabularies and on plot axes.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from transopt.base.errors import InputError
from transopt.base.signals import STANDARD_GRAVITY_M_S2
from transopt.recordings.formats import Scalar, Vocabulary
from transopt.recordings.recording import Recording
from transopt.recordings.table import read_table

TAPS = Vocabulary(
    columns={
        "time_s": ("time", 1.0),
        "time_ms": ("time", 1e-3),
        "acceleration_m_s2": ("acceleration", 1.0),
        "acceleration_g": ("acceleration", STANDARD_GRAVITY_M_S2),
        "position_m": ("position", 1.0),
        "position_mm": ("position", 1e-3),
        "force_N": ("force", 1.0),
        "current_A": ("current", 1.0),
        "command_A": ("command", 1.0),  # as the simulator records it; a tap on a real object has none
    },
    header={
        "speed_m_s": Scalar("speed", 1.0, "m/s"),
        "speed_mm_s": Scalar("speed", 1e-3, "mm/s"),
        "grip_N": Scalar("grip", 1.0, "N", zero=True),
    },
    required=("time", "acceleration"),
    how_to_name='name them in the scene: recordings.columns = ["time_s", "acceleration_g"] ("-" skips one)',
    rename="rename it, or list what to read in recordings.columns",
    step_s=(1e-9, 0.05),  # slower than 20 Hz nothing of a tap's band (10 Hz to 1 kHz) is left
)


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
    stated = {"speed_m_s": speed_m_s, "grip_N": grip_N}
    table = read_table(path, TAPS, columns=columns, full_scale_m_s2=full_scale_m_s2, stated=stated)
    acceleration = table.signals["acceleration"].values
    if np.all(acceleration == acceleration[0]):
        raise InputError(
            f"{path}: recording is constant at {acceleration[0]:g} m/s^2 throughout: is the sensor connected?"
        )
    return Recording(
        name=path.name,
        source=str(path),
        sha256=table.sha256,
        speed_m_s=table.scalars.get("speed"),
        grip_N=table.scalars.get("grip"),
        # Acceleration and whatever else there is, but for a command: nobody played the real object.
        **{name: signal for name, signal in table.signals.items() if name != "command"},
    )
