"""Writes the example recordings of problems/recordings, which show the file format.

`python -m problems.generators.strikes FOLDER` writes the first recording of each speed from 0.2 m/s on of the default
scene, at 3 N, as canonical CSV files.
"""

import sys
from pathlib import Path

import problems
from transopt.base.errors import InputError
from transopt.base.files import whole_file
from transopt.base.signals import STANDARD_GRAVITY_M_S2
from transopt.recordings.recording import Recording
from transopt.scene.strikes import recordings

GRIP_N = 3.0


def write_csv(recording: Recording, path: Path) -> None:
    """Write a recording in the canonical format: comment lines, column names, rows.

    Raises
    ------
    InputError : a recording without position, or a path that cannot be written.
    """
    if recording.position is None:
        raise InputError(f"{recording.name}: no position to write")
    lines = [f"# {recording.source}", f"# speed_m_s: {recording.speed_m_s:.4f}", f"# grip_N: {recording.grip_N:g}"]
    lines.append("time_s,acceleration_g,position_m")
    rows = zip(
        recording.acceleration.times_s,
        recording.acceleration.values / STANDARD_GRAVITY_M_S2,
        recording.position.values,
        strict=True,
    )
    lines += [f"{t:.4f},{a:.4f},{z:.7f}" for t, a, z in rows]
    with whole_file(path) as file:
        file.write(("\n".join(lines) + "\n").encode("ascii"))


def write_examples(folder: Path) -> None:
    """Write the three files of problems/recordings."""
    scene = problems.load("wood_on_foam")
    assert scene.recordings.simulated is not None
    held = [recording for recording in recordings(scene) if recording.grip_N == GRIP_N]
    firsts = held[:: scene.recordings.simulated.repeats]
    for speed, recording in list(zip(scene.grid.speeds_m_s, firsts, strict=True))[1:]:
        write_csv(recording, folder / f"tap_{speed:g}_m_s.csv")


if __name__ == "__main__":
    write_examples(Path(sys.argv[1]))
