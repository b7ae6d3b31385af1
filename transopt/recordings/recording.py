"""One recorded contact, and its reading from a file.

A file is read in three steps: `formats` returns its columns unchanged, `table` checks and converts them to SI signals
on one uniform time grid, and `load_recording` makes a `Recording` of them. g, mm, mm/s and ms exist only in the
vocabularies of readers and on the axes of figures.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from transopt.base.errors import InputError
from transopt.base.shown import brief
from transopt.base.signals import Signal
from transopt.files.names import Layout, Scalar, Vocabulary
from transopt.recordings.axes import read_signals

VOCABULARY = Vocabulary(
    columns=(
        *("time_s", "time_ms"),
        *("acceleration_m_s2", "acceleration_g"),
        "velocity_m_s",  # from a vibrometer; its derivative is the acceleration
        *("position_m", "position_mm"),
        *("force_N", "grip_N", "current_A"),
        "command_A",  # recorded by the simulator; a tap on a real object has no command
    ),
    header={
        "speed_m_s": Scalar("speed", 1.0, "m/s"),
        "speed_mm_s": Scalar("speed", 1e-3, "mm/s"),
        "grip_N": Scalar("grip", 1.0, "N", zero=True),
    },
    required=("time", "acceleration"),
    step_s=(1e-9, 0.05),  # below 20 Hz nothing of a tap's band (10 Hz to 1 kHz) is left
)


@dataclass(frozen=True)
class Recording:
    """Acceleration of one tap over time, and the other signals recorded with it.

    Units are SI; signs and time are as recorded. `transopt.recordings.tap` finds offset, polarity and onset.

    Attributes
    ----------
    name : its name in messages and reports, usually the file name.
    source : where it comes from: a path, or a sentence for a simulated one.
    sha256 : hash of the file's bytes, empty for a simulated one.
    acceleration : [m/s^2].
    position : along the surface normal, positive out of the object [m].
    force : surface force [N].
    grip : force of the hand on the stylus; its mean before contact is the grip force of a tap that states none [N].
    current : motor current [A].
    across_1, across_2 : acceleration along two tangents, if all directions are asked for [m/s^2].
    speed_m_s : incoming speed if the recording states it, > 0.
    grip_N : grip force if the recording states it, >= 0.
    notes : what a user should know about how it was read, one sentence each.

    Raises
    ------
    InputError : the speed is outside 1e-4 to 100 m/s, or the grip force is negative or infinite.
    """

    name: str
    source: str
    sha256: str
    acceleration: Signal
    position: Signal | None = None
    force: Signal | None = None
    grip: Signal | None = None
    current: Signal | None = None
    across_1: Signal | None = None
    across_2: Signal | None = None
    speed_m_s: float | None = None
    grip_N: float | None = None
    notes: tuple[str, ...] = ()

    __repr__ = brief

    def __post_init__(self) -> None:
        if self.speed_m_s is not None and not 1e-4 <= self.speed_m_s <= 100:
            raise InputError(f"{self.name}: speed_m_s = {self.speed_m_s:g} m/s: must be between 1e-4 and 100 m/s")
        if self.grip_N is not None and not 0 <= self.grip_N < float("inf"):
            raise InputError(f"{self.name}: grip_N = {self.grip_N:g} N: must be >= 0 and finite")


def load_recording(path: Path, layout: Layout | None = None) -> Recording:
    """Read one file of a recorded tap, or of several in a row; the format follows from the suffix.

    Parameters
    ----------
    path : .csv, .txt, .dat, .npz, .mat (-v6 or -v7) or .wav.
    layout : what the user states about the file.

    Returns
    -------
    The recording on the uniform grid of the mean time step, resampled to it by a cubic spline if a time stamp lies
    off that grid by more than 1 % of a step or a sample is missing.

    Raises
    ------
    InputError : one line that says what is wrong with the file.
    """
    table = read_signals(path, VOCABULARY, layout or Layout())
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
        notes=tuple(filter(None, [table.missing, *table.notes])),
        # A simulated tap may have a command. It is not part of the recording, because nothing drives a real object.
        **{name: signal for name, signal in table.signals.items() if name != "command"},
    )
