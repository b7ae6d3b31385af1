"""A library in other formats: MAT, CSV, WAV to listen to, and a C header."""

import io
import json
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from transopt.base.errors import InputError
from transopt.base.files import whole_file
from transopt.base.signals import FloatArray
from transopt.library.arrays import HASH_FIELD
from transopt.library.c_header import c_header
from transopt.library.drive_files import refuse_descriptions
from transopt.library.library import Library
from transopt.plant.discretise import StageModel
from transopt.problem.baselines import seed_inversion

SOUND_RATE_HZ = 48000
SILENCE_S = 0.3
SOUND_PEAK = 10 ** (-1 / 20) * 32767  # -1 dBFS in 16 bit


def export_library(library: Library, path: str | Path) -> None:
    """Write a library in the format that the path's suffix names (.mat, .csv, .wav, .h; case does not matter).

    The file is written whole or not at all; an existing file is replaced.

    Raises
    ------
    InputError : an unknown suffix, a file that cannot be written, a library that the format cannot hold.
    """
    path = Path(path)
    formats = {".mat": mat_file, ".csv": csv_file, ".wav": wav_file, ".h": header_file}
    refuse_descriptions(path)
    suffix = path.suffix.lower()
    if suffix not in formats:
        known = ", ".join(formats)
        raise InputError(f"{path}: suffix {suffix!r} names no export format; give the file one of {known}")
    content = formats[suffix](library)
    with whole_file(path) as file:
        file.write(content)


def mat_file(library: Library) -> bytes:
    """MATLAB 5 file: every array of library.npz under its name there, `meta` as JSON text (`jsondecode(meta)`).

    Arrays keep their shapes; one-dimensional arrays become rows. `status` and `binding` become cells, because the
    rows of a char array must have equal length. MATLAB itself drops trailing dimensions of size 1.
    """
    arrays = library.arrays()
    texts = [name for name, array in arrays.items() if array.dtype.kind == "U" and array.ndim > 0]
    cells = {name: arrays[name].astype(object) for name in texts}
    file = io.BytesIO()
    content = {**arrays, **cells}
    into: Any = file  # scipy-stubs forget file objects before 1.18
    scipy.io.savemat(into, content, do_compression=True)
    return file.getvalue()


def csv_file(library: Library) -> bytes:
    """Long format: comment lines, column names, then one row per (speed, grip, k), k fastest.

    Numbers have enough digits to read back as the same double.
    """
    grid, meta = library.time_grid(), library.meta
    named, drive = library.axes.targets, library.driven_by
    taps = {"speed_m_s": library.speeds_m_s[:, None, None], "grip_N": library.grips_N[:, None]}
    if library.axes.places:
        taps |= {
            name: at[:, None]
            for name, at in zip(("normal", "posture"), np.transpose(library.axes.places), strict=True)
        }
    columns: dict[str, NDArray[np.generic]] = {
        **({"target": library.targets[:, None, None]} if named else taps),
        "k": np.arange(grid.stages),
        "issue_time_s": grid.issue_times_s,
        "switching_time_s": grid.switching_times_s,
        **_each("motor", f"command_{drive.unit}", library.command),
        **_each("motor", f"transient_command_{drive.unit}", library.transient_command),
        **_each("motor", f"{drive.name}_{drive.unit}", library.plant_input),
        **_each("direction", "acceleration_m_s2", library.acceleration_m_s2),
        **({} if library.cool is None else _second_columns(library.cool)),
        **_each("direction", "recorded_m_s2", library.recorded_m_s2),
        **_each("direction", "free_m_s2", library.free_m_s2),
        **_each("direction", "target_m_s2", library.target_m_s2),
    }
    comments = [
        # JSON keeps the name on one line, whatever characters it contains.
        f"transopt library, scene {json.dumps(meta['scene']['name'])}, {HASH_FIELD} {library.content_sha256}",
        "SI units; the target begins at time 0"
        if named
        else "SI units; current > 0 pushes out of the surface, acceleration > 0 decelerates the incoming stylus, "
        "contact at time 0",
        f"command k is issued at issue_time_s = -lead + k dt and held; {drive.name}, acceleration (what the "
        f"{drive.name} adds), recorded, free (without a {drive.name}) and target = recorded - free are those at "
        "switching_time_s = issue_time_s + delay",
        *([library.claim] if library.claim else []),
        f"dt_s: {grid.dt_s!r}",
        f"lead_s: {grid.lead_s!r}",
        f"delay_s: {grid.delay_s!r}",
    ]
    shape = (*library.command.shape[:2], grid.stages)
    flat = [np.broadcast_to(column, shape).ravel().tolist() for column in columns.values()]
    lines = [
        *(f"# {comment}" for comment in comments),
        ",".join(columns),
        *(",".join(map(_cell, row)) for row in zip(*flat, strict=True)),
    ]
    return ("\n".join(lines) + "\n").encode()


def _each(what: str, name: str, courses: FloatArray) -> dict[str, FloatArray]:
    """One column, or one per motor or direction if there are several."""
    if courses.ndim == 3:
        return {name: courses}
    return {f"{what}_{j + 1}_{name}": courses[:, :, j] for j in range(courses.shape[2])}


def _second_columns(cool: Library) -> dict[str, FloatArray]:
    """Columns of the cool commands, which cause less heat."""
    return {
        "cool_command_A": cool.command,
        "cool_transient_command_A": cool.transient_command,
        "cool_current_A": cool.plant_input,
        "cool_acceleration_m_s2": cool.acceleration_m_s2,
    }


def _cell(value: object) -> str:
    """A number with all its digits; a name in CSV quotes."""
    return '"' + value.replace('"', '""') + '"' if isinstance(value, str) else repr(value)


def wav_file(library: Library) -> bytes:
    """16 bit mono at 48 kHz, to listen to the accelerations.

    For every entry, speeds outermost: the recorded r, then the motion under the seed's clipped inversion at the
    library's transient limit, then the motion under the library's own command; each is followed by 0.3 s of silence.
    The whole file has one scale, its peak at -1 dBFS, so that loudness can be compared.
    """
    library.scene().check_one_motor("export as .wav")
    grid = library.time_grid()
    limit, taper = library.input_limit, library.hand_over_samples
    stages = [library.stage(ig) for ig in range(library.grips_N.size)]
    silence = np.zeros(round(SILENCE_S / grid.dt_s))
    pieces: list[FloatArray] = []
    for iv in range(library.speeds_m_s.size):
        for ig, stage in enumerate(stages):
            free = library.free_m_s2[iv, ig]
            command = seed_inversion(stage, grid, library.uncorrected(iv, ig).window_m_s2, limit, taper)
            inversion = _made(library, iv, ig, stage, command)
            for sound in (library.recorded_m_s2[iv, ig], inversion + free, library.acceleration_m_s2[iv, ig] + free):
                pieces += [sound, silence]
    # Resampled in one piece, so that the filter rings out into the silences instead of being cut off.
    ratio = Fraction(SOUND_RATE_HZ * grid.dt_s).limit_denominator(1000)
    sound = scipy.signal.resample_poly(np.concatenate(pieces), ratio.numerator, ratio.denominator)
    peak = float(np.abs(sound).max())
    if peak > 0:
        sound = sound * (SOUND_PEAK / peak)
    file = io.BytesIO()
    scipy.io.wavfile.write(file, SOUND_RATE_HZ, np.rint(sound).astype(np.int16))
    return file.getvalue()


def sounds(library: Library) -> str:
    """Content of the file that `wav_file` writes, in one sentence."""
    count, seconds = library.command[..., 0].size, library.command.shape[-1] * library.time_grid().dt_s + SILENCE_S
    of = f"{count} target{'s' * (count > 1)}" if library.axes.targets else f"{count} tap{'s' * (count > 1)}"
    return (
        f"it is {3 * count * seconds:.1f} s of accelerations to listen to: of {of} what was asked for, what a "
        "clipped inversion makes of it, and the optimum"
    )


def _made(library: Library, iv: int, ig: int, stage: StageModel, command: FloatArray) -> FloatArray:
    """(N,) y'' of a command on an entry's device; zero where a nonlinear plant's motion is not finite."""
    if not library.nonlinear:
        return stage.rollout(command)[0]
    # Only a library of a nonlinear plant needs this import.
    from transopt.library.nonlinear import nonlinear_problem
    from transopt.proof.nonlinear import NonlinearEffect

    with np.errstate(all="ignore"):
        found = NonlinearEffect(nonlinear_problem(library, iv, ig), command).motion.acceleration_m_s2
    return np.nan_to_num(found, nan=0.0, posinf=0.0, neginf=0.0)


def header_file(library: Library) -> bytes:
    """C99/C++ header, see `transopt.library.c_header`."""
    return c_header(library).encode("ascii")
