"""Nothing is read wrong by a factor in silence: the speed contradicts it, or the unit is asked for.

A tap changes the stylus's speed by one to two times the speed that it came with, whatever was struck. A unit that is
wrong by 9.81 or 1000 takes the recording out of that range, a time that is wrong by 1000 makes the pulse too long or
too short. Where no label says a unit nothing is assumed.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.benches.recording_files import mat, npz, text, wav
from tests.benches.tap_formats import RATE_HZ, SPEED_M_S, hdf5, tdms, universal, workbook
from transopt.base.errors import InputError
from transopt.base.signals import STANDARD_GRAVITY_M_S2 as G
from transopt.base.signals import FloatArray
from transopt.files.names import Layout
from transopt.files.unclear import UnclearError
from transopt.identify.measured_response import read_response
from transopt.recordings.settings import Recordings
from transopt.recordings.tap import prepare, read_recordings

FULL_SCALE_M_S2 = 500.0
Pack = Callable[[FloatArray, FloatArray], bytes]
# Format -> a file of times and accelerations under labels that say s and g, and one under none.
LABELLED: dict[str, Pack] = {
    ".csv": lambda t, a: ("Time (s),Acc (g)\n" + text(t, a)).encode(),
    ".lvm": lambda t, a: ("time_s\tacc_g\n" + text(t, a, delimiter="\t")).encode(),
    ".xlsx": lambda t, a: workbook([("Time [s]", "Acc [g]"), *zip(t.tolist(), a.tolist(), strict=True)]),
    ".npz": lambda t, a: npz(t_s=t, acc_g=a),
    ".mat": lambda t, a: mat(log={"time_s": t, "acc_g": a}),
    ".h5": lambda t, a: hdf5({"time_s": (t, ""), "acc": (a, "g")}),
    ".tdms": lambda t, a: tdms({"time": (t, "s"), "acc": (a, "g")}),
}
BARE: dict[str, Pack] = {
    ".csv": lambda t, a: ("Time,Acc\n" + text(t, a)).encode(),
    ".lvm": lambda t, a: ("t\tacc\n" + text(t, a, delimiter="\t")).encode(),
    ".xlsx": lambda t, a: workbook([("Time", "Acc"), *zip(t.tolist(), a.tolist(), strict=True)]),
    ".npz": lambda t, a: npz(t=t, acc=a),
    ".mat": lambda t, a: mat(log={"time": t, "acc": a}),
    ".h5": lambda t, a: hdf5({"time": (t, ""), "acc": (a, "")}),
    ".tdms": lambda t, a: tdms({"time": (t, ""), "acc": (a, "")}),
}
FACTORS = (1e-3, 1 / 9.80665, 9.80665, 1e3)


def a_tap(seed: int) -> tuple[FloatArray, FloatArray]:
    """Times [s] and acceleration [g] of a tap: from steel to rubber, and thrown back by up to seven tenths."""
    random = np.random.default_rng(seed)
    length_s, back = random.uniform(1e-3, 8e-3), random.uniform(0, 0.7)
    t = np.arange(3000) / RATE_HZ
    pulse = np.where((t > 0.1) & (t < 0.1 + length_s), np.sin(np.pi * (t - 0.1) / length_s), 0.0)
    noise = 0.02 * random.standard_normal(t.size)
    return t, (SPEED_M_S * (1 + back) * np.pi / (2 * length_s) * pulse + noise) / G


def is_taken(path: Path, data: bytes, **stated: Any) -> bool:
    """Whether a file is read in silence and its tap used."""
    path.write_bytes(data)
    settings = Recordings(files=[str(path)], **{"speed_m_s": SPEED_M_S, **stated})
    try:
        taps = [prepare(recording, settings) for recording in read_recordings(settings)]
    except InputError:
        return False
    return not any(tap.implausible for tap in taps)


@pytest.mark.parametrize("suffix", LABELLED)
def test_a_wrong_unit_contradicts_the_speed(suffix: str, tmp_path: Path) -> None:
    path, (t, a), pack = tmp_path / f"tap{suffix}", a_tap(3), LABELLED[suffix]
    assert is_taken(path, pack(t, a))
    for factor in FACTORS[1:3] if suffix == ".h5" else FACTORS:  # HDF5 is read by a process of its own, which is slow
        assert not is_taken(path, pack(t, factor * a)), f"acceleration times {factor:g}"
        assert not is_taken(path, pack(t, a), speed_m_s=min(max(factor * SPEED_M_S, 1e-4), 100)), f"speed {factor:g}"
    for factor in (1e-3, 1e3):
        assert not is_taken(path, pack(factor * t, a)), f"times times {factor:g}"
    assert not is_taken(path, pack(a, t)), "swapped columns"


@pytest.mark.parametrize("seed", [3, 4])
@pytest.mark.parametrize("binary", [False, True])
def test_a_wrong_label_of_a_universal_file_contradicts_the_speed(binary: bool, seed: int, tmp_path: Path) -> None:
    path, a = tmp_path / "tap.uff", a_tap(seed)[1]
    assert is_taken(path, universal(("g", "12"), values=a, binary=binary))
    for label, size in (("m/s^2", 1.0), ("mg", 1.0), ("g", 1e-3), ("g", 9.80665), ("g", 1e3)):
        assert not is_taken(path, universal((label, "12"), values=size * a, binary=binary)), (label, size)
    assert not is_taken(path, universal(("NONE", "12"), values=a, binary=binary))


@pytest.mark.parametrize("seed", [3, 4])
def test_a_wrong_full_scale_contradicts_the_speed(seed: int, tmp_path: Path) -> None:
    data = wav(a_tap(seed)[1] * G / FULL_SCALE_M_S2)
    assert is_taken(tmp_path / "tap.wav", data, full_scale_m_s2=FULL_SCALE_M_S2)
    for factor in FACTORS:
        assert not is_taken(tmp_path / "tap.wav", data, full_scale_m_s2=factor * FULL_SCALE_M_S2)


@pytest.mark.parametrize("factor", [1e-3, 1e3])
def test_a_wrong_unit_of_the_position_contradicts_the_acceleration(factor: float, tmp_path: Path) -> None:
    t, a = a_tap(3)
    z = -SPEED_M_S * np.minimum(t - 0.1, 0.0)
    for by, taken in ((1.0, True), (factor, False)):
        rows = text(t, a, 1e3 * by * z)
        data = f"Time (s),Acc (g),Pos (mm)\n{rows}".encode()
        assert is_taken(tmp_path / "tap.csv", data, speed_m_s=None) == taken


@pytest.mark.parametrize("suffix", BARE)
def test_without_a_label_the_units_are_asked_for(suffix: str, tmp_path: Path) -> None:
    path, (t, a) = tmp_path / f"tap{suffix}", a_tap(3)
    path.write_bytes(BARE[suffix](t, a))
    settings = Recordings(files=[str(path)], speed_m_s=SPEED_M_S)
    with pytest.raises(UnclearError) as caught:
        read_recordings(settings)
    assert {"time": "s", "acceleration": "g"} in [each.get("units") for each in caught.value.answers]


F_HZ = np.linspace(10, 500, 50)
S = 2j * np.pi * F_HZ
ACCELERANCE = 3.0 * S**2 / (S**2 + 2 * np.pi * 150 / 8 * S + (2 * np.pi * 150) ** 2)
POLAR = (F_HZ, np.abs(ACCELERANCE), np.degrees(np.angle(ACCELERANCE)))
RESPONSES: dict[str, bytes] = {
    "f.csv": ("freq,Mag (g/V),Phase (deg)\n" + text(*POLAR)).encode(),
    "mag.csv": ("freq (Hz),Mag,Phase (deg)\n" + text(*POLAR)).encode(),
    "parts.npz": npz(freq=F_HZ, re=ACCELERANCE.real, im=ACCELERANCE.imag),
    "complex.mat": mat(freq=F_HZ, frf=ACCELERANCE),
    "r.xlsx": workbook([("freq", "Mag (g/V)", "Phase (deg)"), *zip(*(each.tolist() for each in POLAR), strict=True)]),
}


@pytest.mark.parametrize("name", RESPONSES)
def test_a_response_without_a_label_is_asked_about(name: str, tmp_path: Path) -> None:
    """Neither Hz nor rad/s, g nor m/s^2 is assumed."""
    (tmp_path / name).write_bytes(RESPONSES[name])
    with pytest.raises(UnclearError) as caught:
        read_response(tmp_path / name)
    units = [each["units"] for each in caught.value.answers]
    found = read_response(tmp_path / name, Layout(units=units[0]))
    assert found.frequencies_Hz.size == F_HZ.size
    if name.startswith(("f", "r")):
        assert {each["frequency"] for each in units} >= {"Hz", "kHz", "rad/s"}
