"""Files of drives: WAV, raw samples, NPZ, CSV and a C header.

WAV and raw formats take one file per entry, named by its target or by its speed and grip. The other formats hold all
entries in one file.
"""

import csv
import io
import json
import re
import wave
from collections.abc import Callable, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final

import numpy as np
import scipy
from numpy.typing import NDArray

from transopt.base.errors import InputError
from transopt.base.files import whole_file
from transopt.library.arrays import HASH_FIELD
from transopt.library.drive import WHOLE, Drive, chosen, drive_of, driver_for
from transopt.library.drive_header import drive_header
from transopt.library.drive_replay import PlayedDrive, played
from transopt.library.library import Library

LONGEST_NAME = 60  # most characters of a target's name in a file's name
# Suffix -> the phone maker's format for describing an effect. Its intensities, sharpnesses and frequencies are steps
# of the phone's own amplifier and actuator, and no published measurement maps a waveform to them.
DESCRIPTIONS: Final = MappingProxyType(
    {".ahap": "AHAP (Apple)", ".pwle": "PWLE (Android)", ".json": "AHAP (Apple) and PWLE (Android)"}
)


def refuse_descriptions(path: Path) -> None:
    """Refuse to write a phone maker's description of an effect.

    Raises
    ------
    InputError : the suffix belongs to such a format.
    """
    whose = DESCRIPTIONS.get(path.suffix.lower())
    if whose is not None:
        raise InputError(
            f"{path}: {whose} cannot be written: no measurement says which waveform its intensities and sharpnesses "
            f"stand for; export the waveform itself with --drive, as {', '.join(FORMATS)}"
        )


def export_drive(
    library: Library,
    path: str | Path,
    *,
    rate_Hz: float | None = None,
    bits: str = "16",
    full_scale: float | None = None,
    target: str | None = None,
    speed_m_s: float | None = None,
    grip_N: float | None = None,
) -> tuple[list[Path], list[PlayedDrive]]:
    """Write the commands of a library for a driver, and replay what was written on the library's plants.

    Each file is written whole or not at all; an existing file is replaced.

    Parameters
    ----------
    path : its suffix names the format: .wav and .bin take one file per entry; .npz, .csv and .h hold all in one.
        If several entries are written as .wav or .bin, the entry's name is appended to the path's own.
    rate_Hz : rate of the driver, which holds each sample until the next; None means the design's rate.
    bits : "8", "16", "24", "32" or "float" (32 bit); .h takes 8 and 16 only.
    full_scale : output at the largest count [A or V]; None means the range of the command.
    target, speed_m_s, grip_N : select entries; without them all entries are written.

    Returns
    -------
    The files written, and the replay of each entry's samples.

    Raises
    ------
    InputError : an option out of its range, a suffix that names no format, a file that cannot be written.
    """
    library.scene().check_one_motor("export --drive")
    path = Path(path)
    refuse_descriptions(path)
    suffix = path.suffix.lower()
    if suffix not in FORMATS:
        raise InputError(
            f"{path}: suffix {suffix!r} names no format of a drive; give the file one of {', '.join(FORMATS)}"
        )
    driver = driver_for(library, rate_Hz, bits, full_scale)
    drives = [drive_of(library, iv, ig, driver) for iv, ig in chosen(library, target, speed_m_s, grip_N)]
    if suffix in OF_ONE:
        names = [""] if len(drives) == 1 else [f"_{name}" for name in file_names([drive.name for drive in drives])]
        files = {
            path.with_name(f"{path.stem}{name}{path.suffix}"): OF_ONE[suffix](drive)
            for name, drive in zip(names, drives, strict=True)
        }
    else:
        files = {path: OF_ALL[suffix](library, drives)}
    for place, content in files.items():
        with whole_file(place) as file:
            file.write(content)
    return list(files), played(library, drives)


def file_names(names: Sequence[str]) -> list[str]:
    """File names of letters, digits, dot, minus and underscore only, unique even where case is ignored."""
    found: list[str] = []
    for name in names:
        plain = re.sub(r"[^A-Za-z0-9.-]+", "_", name).strip("_.")[:LONGEST_NAME] or "target"
        taken, number, unique = {each.lower() for each in found}, 2, plain
        while unique.lower() in taken:
            unique, number = f"{plain}_{number}", number + 1
        found.append(unique)
    return found


def wav(drive: Drive) -> bytes:
    """One channel; 8-bit samples are unsigned with zero at 128, as WAV requires, all others signed.

    Raises
    ------
    InputError : the rate is not a whole number, so WAV cannot state it.
    """
    depth, rate_Hz = drive.driver.depth, drive.driver.rate_Hz
    if abs(rate_Hz - round(rate_Hz)) > WHOLE:
        raise InputError(f"rate {rate_Hz:.10g} Hz: WAV states whole numbers; give --rate-Hz {round(rate_Hz)}")
    file = io.BytesIO()
    if depth.counts == 0:
        scipy.io.wavfile.write(file, round(rate_Hz), drive.samples)
        return file.getvalue()
    with wave.open(file, "wb") as writer:
        writer.setnchannels(1)
        writer.setsampwidth(depth.bits // 8)
        writer.setframerate(round(rate_Hz))
        unsigned = (drive.samples.astype(np.int64) + 128).astype(np.uint8)
        writer.writeframes(unsigned.tobytes() if depth.bits == 8 else raw(drive))
    return file.getvalue()


def raw(drive: Drive) -> bytes:
    """The samples without a header, little-endian; 24-bit samples take three bytes each."""
    bits = drive.driver.depth.bits
    samples = drive.samples.astype(drive.samples.dtype.newbyteorder("<"))
    if bits != 24:
        return samples.tobytes()
    return samples.view(np.uint8).reshape(-1, 4)[:, :3].tobytes()


def npz(library: Library, drives: Sequence[Drive]) -> bytes:
    """`samples` (entries, m), `names` (entries,), `scale` (unit per count), `full_scale`, `unit`, `rate_Hz`, `bits`,
    `lead_s`, and the library's hash.
    """
    driver, file = drives[0].driver, io.BytesIO()
    content: dict[str, Any] = {
        "samples": np.stack([drive.samples for drive in drives]),
        "names": np.array([drive.name for drive in drives]),
        "scale": driver.scale,
        "full_scale": driver.full_scale,
        "unit": driver.unit,
        "rate_Hz": driver.rate_Hz,
        "bits": driver.depth.bits,
        "lead_s": library.lead_s,
        HASH_FIELD: library.content_sha256,
    }
    np.savez_compressed(file, **content)
    return file.getvalue()


def table(library: Library, drives: Sequence[Drive]) -> bytes:
    """CSV: comment lines, column names, then one row per entry and sample: entry, index, time, sample and output.

    `time_s` is when a sample is sent, 0 at contact or at the target's beginning. Numbers read back as the same
    double.
    """
    axes, driver, text = library.axes, drives[0].driver, io.StringIO()
    for comment in (
        f"transopt drive, scene {json.dumps(library.meta['scene']['name'])}, {HASH_FIELD} {library.content_sha256}",
        f"rate_Hz: {driver.rate_Hz!r}",
        f"full_scale_{driver.unit}: {driver.full_scale!r}",
        f"samples: {driver.depth.word}, {driver.scale!r} {driver.unit} each",
    ):
        text.write(f"# {comment}\n")
    writer = csv.writer(text, lineterminator="\n")
    entry = ["target"] if axes.targets else ["speed_m_s", "grip_N"]
    writer.writerow([*entry, "k", "time_s", "sample", f"command_{driver.unit}"])
    for drive in drives:
        which = [drive.name] if axes.targets else [axes.speeds_m_s[drive.iv], axes.grips_N[drive.ig]]
        times = np.arange(drive.samples.size) / driver.rate_Hz - library.lead_s
        columns: list[NDArray[Any]] = [times, drive.samples, drive.values]
        rows = zip(*(column.tolist() for column in columns), strict=True)
        writer.writerows([*which, k, *row] for k, row in enumerate(rows))
    return text.getvalue().encode()


def header(library: Library, drives: Sequence[Drive]) -> bytes:
    """C99/C++ header, see `transopt.library.drive_header`."""
    return drive_header(library, drives).encode("ascii")


OF_ONE: Final[dict[str, Callable[[Drive], bytes]]] = {".wav": wav, ".bin": raw}
OF_ALL: Final[dict[str, Callable[[Library, Sequence[Drive]], bytes]]] = {".npz": npz, ".csv": table, ".h": header}
FORMATS: Final = (*OF_ONE, *OF_ALL)
