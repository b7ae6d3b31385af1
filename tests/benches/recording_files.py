"""Files of one tap in every format, for the tests of reading recordings."""

import io
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pytest
from scipy.io import savemat, wavfile

from transopt.base.errors import InputError
from transopt.base.signals import STANDARD_GRAVITY_M_S2 as G
from transopt.base.signals import FloatArray
from transopt.files.names import Layout
from transopt.recordings.recording import Recording, load_recording

DT_S = 1e-4
TIMES_S: FloatArray = DT_S * np.arange(200, dtype=float)
TAP_M_S2 = 30.0 * np.sin(2 * np.pi * 200 * TIMES_S) * np.exp(-TIMES_S / 5e-3)
FULL_SCALE_M_S2 = 100.0
HEADER = "time_s,acceleration_m_s2\n"


def text(*columns: FloatArray, delimiter: str = ",") -> str:
    return "".join(delimiter.join(f"{x:.12g}" for x in row) + "\n" for row in zip(*columns, strict=True))


def csv(times_s: FloatArray = TIMES_S, values: FloatArray = TAP_M_S2, comments: str = "") -> str:
    return comments + HEADER + text(times_s, values)


def npz(**variables: Any) -> bytes:
    stream = io.BytesIO()
    np.savez(stream, **variables)
    return stream.getvalue()


def mat(*, version: Literal["4", "5"] = "5", do_compression: bool = False, **variables: Any) -> bytes:
    stream: Any = io.BytesIO()
    savemat(stream, variables, format=version, do_compression=do_compression)
    content: bytes = stream.getvalue()
    return content


def wav(samples: Any, rate_Hz: int = 10_000) -> bytes:
    stream = io.BytesIO()
    wavfile.write(stream, rate_Hz, samples)
    return stream.getvalue()


VARIABLES: dict[str, Any] = {"time_s": TIMES_S, "acceleration_m_s2": TAP_M_S2}
PACKERS = {".npz": npz, ".mat": mat}
VALID: dict[str, bytes] = {
    ".csv": csv(comments="# speed_m_s: 0.21\n# grip_N: 3\n").encode(),
    ".txt": text(TIMES_S, TAP_M_S2, delimiter="\t").encode(),
    ".dat": text(TIMES_S, TAP_M_S2, delimiter=";").encode(),
    ".npz": npz(**VARIABLES, speed_m_s=0.21, grip_N=3.0),
    ".mat": mat(**VARIABLES, speed_m_s=0.21, grip_N=3.0),
    ".wav": wav(TAP_M_S2 / FULL_SCALE_M_S2),
}


def load(folder: Path, content: bytes | str, suffix: str = ".csv", **options: Any) -> Recording:
    path = folder / f"tap{suffix}"
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    return load_recording(path, Layout(**options))


def load_any(folder: Path, content: bytes, suffix: str) -> Recording:
    """Load a recording with the options that its format needs."""
    columns = ("time_s", "acceleration_m_s2") if suffix in (".txt", ".dat") else ()
    return load(folder, content, suffix, columns=columns, full_scale_m_s2=FULL_SCALE_M_S2)


def path_refusal(path: Path) -> str:
    with pytest.raises(InputError) as caught:
        load_recording(path)
    message = str(caught.value)
    assert message.isprintable()  # one line
    return message


def refusal(folder: Path, content: bytes | str, suffix: str = ".csv", **options: Any) -> str:
    """The message: always one line that begins with the file; returned without it."""
    with pytest.raises(InputError) as caught:
        load(folder, content, suffix, **options)
    message = str(caught.value)
    assert message.isprintable()
    file = f"{folder / 'tap'}{suffix}: "
    assert message.startswith(file)
    return message.removeprefix(file)


def session(times_s: FloatArray, speeds_m_s: FloatArray) -> str:
    """Time, acceleration in g and position of taps that begin at the given times."""
    t = np.arange(round((times_s[-1] + 0.5) / DT_S)) * DT_S
    a, z = np.full(t.size, G) + 0.05 * np.random.default_rng(2).standard_normal(t.size), np.full(t.size, 0.02)
    for start, speed in zip(times_s, speeds_m_s, strict=True):
        after = t - start
        hit = (after >= 0) & (after < 4e-3)
        a[hit] += 300 * speed * np.sin(np.pi * after[hit] / 4e-3)
        rebound = (after >= 0.05) & (after < 0.053)
        a[rebound] += 60 * speed * np.sin(np.pi * (after[rebound] - 0.05) / 3e-3)
        coming, gone = (after > -0.05) & (after <= 0), (after > 0) & (after < 0.1)
        z[coming], z[gone] = -speed * after[coming], 0.0
    return "time [s],acc [g],pos [m]\n" + text(t, a / G, z)


SPEEDS = np.array([0.1, 0.2, 0.4])
STARTS = np.array([0.4, 0.9, 1.5])
