"""Mistakes of unit in scenes, datasheets and taps: each is named, with the unit that was meant."""

from pathlib import Path

import numpy as np
import pytest

import problems
from tests.benches.commands import Run, assert_refused
from tests.benches.places import ROOT
from transopt.scene.builtin import load_scene, scene_names
from transopt.scene.plausible import implausible

RECORDINGS = ROOT / "problems/recordings"
WOOD, LRA = "wood_on_foam", "lra_click"
MOTOR = """
[motor]
name = "my motor"
datasheet = "typed from paper"
R_ohm = 2.18
L_H = 0.238e-3
kt_Nm_A = 23.4e-3
rotor_kg_m2 = 1.03e-6
i_continuous_A = 1.24
i_peak_A = 10.0
R_wh_K_W = 3.1
R_ha_K_W = 14.0
tau_w_s = 12.0
tau_h_s = 612.0
winding_max_C = 100.0
"""
# Scene, what it states, what is typed in its place, and what the message says.
SCENES = [
    (WOOD, "stylus_mass_kg = 0.026", "stylus_mass_kg = 26", ["stylus_mass_kg = 26 kg", "26 g, which is 0.026 kg"]),
    (WOOD, "mass_kg = 0.010", "mass_kg = 10", ["model.hand.mass_kg = 10 kg", "10 g, which is 0.01 kg"]),
    (WOOD, "[0.1, 0.2, 0.3, 0.4]", "[10, 20, 30]", ["speeds_m_s = 10 m/s", "10 cm/s, which is 0.1 m/s", "2 more"]),
    (WOOD, "[1.0, 3.0, 5.0]", "[100, 300, 500]", ["grips_N = 100 N", "100 gf, which is 0.980665 N"]),
    (WOOD, "beta = 3.2", "current_A = 4000", ["limits.current_A = 4000 A", "4000 mA, which is 4 A"]),
    (WOOD, "delay_s = 68e-6", "delay_s = 68", ["amplifier.delay_s = 68 s", "68 us, which is 6.8e-05 s"]),
    (WOOD, "pole_Hz = 1050.0", "pole_Hz = 1.05", ["pole_Hz = 1.05 Hz", "1.05 kHz, which is 1050 Hz"]),
    (WOOD, "dt_s = 1e-4", "dt_s = 0.1", ["time.dt_s = 0.1 s", "0.1 ms, which is 0.0001 s"]),
    (WOOD, "constant = 3000.0", "constant = 3.0", ["skin_stiffness_N_m = 3 N/m", "3 N/mm, which is 3000 N/m"]),
    (WOOD, "ambient_C = 25.0", "ambient_C = 298.15", ["ambient_C = 298.15 C", "298.15 K, which is 25 C"]),
    (WOOD, "noise_g_rtHz = 320e-6", "noise_g_rtHz = 320", ["= 320 g/sqrt(Hz)", "320 ug/sqrt(Hz), which is 0.00032"]),
    (LRA, "stroke_m = 0.6e-3", "stroke_m = 0.6", ["limits.stroke_m = 0.6 m", "0.6 mm, which is 0.0006 m"]),
    (LRA, "voltage_V = 3.0", "voltage_V = 3000", ["limits.voltage_V = 3000 V", "3000 mV, which is 3 V"]),
    (LRA, "moving_mass_kg = 0.003", "moving_mass_kg = 3", ["model.moving_mass_kg = 3 kg", "3 g, which is 0.003 kg"]),
    (LRA, "resonance_Hz = 150.0", "resonance_Hz = 0.15", ["resonance_Hz = 0.15 Hz", "0.15 kHz, which is 150 Hz"]),
    (LRA, "L_H = 1e-4", "L_H = 100", ["model.L_H = 100 H", "100 uH, which is 0.0001 H"]),
]
MOTORS = [
    ("L_H = 0.238e-3", "L_H = 0.238", ["motor.L_H = 0.238 H", "0.238 mH, which is 0.000238 H"]),
    ("kt_Nm_A = 23.4e-3", "kt_Nm_A = 23.4", ["motor.kt_Nm_A = 23.4 N m/A", "23.4 mN m/A, which is 0.0234 N m/A"]),
    ("rotor_kg_m2 = 1.03e-6", "rotor_kg_m2 = 10.3", ["rotor_kg_m2 = 10.3 kg m^2", "10.3 g cm^2, which is 1.03e-06"]),
    ("winding_max_C = 100.0", "winding_max_C = 373.15", ["winding_max_C = 373.15 C", "373.15 K, which is 100 C"]),
    ("R_ohm = 2.18", "R_ohm = 2180", ["motor.R_ohm = 2180 ohm", "2180 mohm, which is 2.18 ohm"]),
]
SHEET = {
    "--resonance-Hz": 175.0,
    "--quality": 8.0,
    "--moving-mass-kg": 0.002,
    "--case-mass-kg": 0.12,
    "--BL": 0.8,
    "--R-ohm": 8.0,
    "--peak": 3.0,
    "--stroke-m": 5e-4,
}
SHEETS = [
    ("--moving-mass-kg", 2, ["--moving-mass-kg = 2 kg", "2 g, which is 0.002 kg"]),
    ("--case-mass-kg", 120, ["--case-mass-kg = 120 kg", "120 g, which is 0.12 kg"]),
    ("--peak", 3000, ["--peak = 3000 V", "3000 mV, which is 3 V"]),
    ("--stroke-m", 0.5, ["--stroke-m = 0.5 m", "0.5 mm, which is 0.0005 m"]),
    ("--R-ohm", 8000, ["--R-ohm = 8000 ohm", "8000 mohm, which is 8 ohm"]),
    ("--rms-A", 69, ["--rms-A = 69 A", "69 mA, which is 0.069 A"]),
    ("--rms-V", 1800, ["--rms-V = 1800 V", "1800 mV, which is 1.8 V"]),
    ("--rms-g", 1200, ["--rms-g = 1200 g", "1200 mg, which is 1.2 g"]),
    ("--rise-s", 40, ["--rise-s = 40 s", "40 ms, which is 0.04 s"]),
]


@pytest.mark.parametrize(("scene", "old", "new", "words"), SCENES, ids=lambda part: str(part)[:24])
def test_in_a_scene(run: Run, scene: str, old: str, new: str, words: list[str]) -> None:
    text = problems.scene_path(scene).read_text()
    assert old in text
    Path("mine.toml").write_text(text.replace(old, new, 1))
    assert_refused(run("solve", "mine.toml"), "mine.toml: ", "--accept", *words)
    assert not Path("out").exists()


@pytest.mark.parametrize(("old", "new", "words"), MOTORS, ids=lambda part: str(part)[:24])
def test_in_a_motor(run: Run, old: str, new: str, words: list[str]) -> None:
    lines = problems.scene_path(WOOD).read_text().splitlines()
    text = "\n".join(line for line in lines if not line.startswith("motor = "))
    Path("mine.toml").write_text(text + MOTOR.replace(old, new))
    assert_refused(run("solve", "mine.toml"), *words)


@pytest.mark.parametrize(("option", "value", "words"), SHEETS, ids=lambda part: str(part)[:24])
def test_in_a_datasheet(run: Run, option: str, value: float, words: list[str]) -> None:
    stated = [word for pair in {**SHEET, option: value}.items() for word in pair]
    assert_refused(run("plant", "new", "lra", *stated), *words)
    assert not Path("lra.toml").exists()


@pytest.mark.parametrize(
    ("stated", "column", "right"),
    [
        ("# grip_N: 300", "", ["--accept"]),
        ("# a load cell's", ",305.9", ["--units", "grip=gf"]),
        ("# a load cell's", ",3000", ["--units", "grip=mN"]),
    ],
)
def test_a_grip_that_no_hand_has(run: Run, stated: str, column: str, right: list[str]) -> None:
    """A target of 300 N would serve every grip of the grid as that of the nearest one."""
    head, *rows = (RECORDINGS / "tap_0.2_m_s.csv").read_text().split("time_s,")[1].splitlines()
    lines = ["# speed_m_s: 0.1932", stated, f"time_s,{head}{',grip_N' * bool(column)}"]
    Path("tap.csv").write_text("\n".join([*lines, *(row + column for row in rows)]))
    said = ["N, a hand's 0.05 to 60 N: check the unit of the grip", " ".join(right)]
    outcome = run("taps", "tap.csv", "--scene", "wrong.toml")
    assert outcome.code == 2
    assert all(each in outcome.err for each in said), outcome.err
    assert_refused(run("solve", "wrong.toml"), said[0], "--accept")
    assert run("taps", "tap.csv", *right).code == 0


def test_a_stated_grip_that_no_hand_has(run: Run) -> None:
    rows = [row for row in (RECORDINGS / "tap_0.2_m_s.csv").read_text().splitlines() if "grip" not in row]
    Path("tap.csv").write_text("\n".join(rows))
    outcome = run("taps", "tap.csv", "--grip", "300")
    assert outcome.code == 2
    assert "tried on it, of which only you know the right one: --grip 2.942 " in outcome.err
    assert run("taps", "tap.csv", "--grip", "2.942").code == 0


@pytest.mark.parametrize(
    ("factor", "said"), [(1e5, "1000: mm/s^2, mg or mV?"), (1e-5, "1000: mm/s^2, mg or mV?"), (1.0, "")]
)
def test_in_matrices(run: Run, factor: float, said: str) -> None:
    """A plant by its matrices, stated in the scene or in a file beside it."""
    w, gain = 2 * np.pi * 60, factor * 10.0
    A, C = [[0.0, 1.0], [-(w**2), -w / 5]], [-gain * w**2, -gain * w / 5]
    np.savez("plant.npz", A=A, B=[0.0, 1.0], C=C, D=gain, input="voltage")
    head = problems.scene_path(LRA).read_text().split("[model]")[0]
    stated = f'input = "voltage"\nA = {A}\nB = [0.0, 1.0]\nC = {C}\nD = {gain}\n'
    for model in (stated, 'file = "plant.npz"\n'):
        Path("mine.toml").write_text(f'{head}[model]\nkind = "state_space"\n{model}[limits]\nvoltage_V = 3.0\n')
        if said:
            assert_refused(run("solve", "mine.toml"), "model: the largest response is", said, "--accept")
        else:
            assert not implausible(load_scene("mine.toml").model_dump())


def test_in_a_study(run: Run) -> None:
    said = ["limits.current_A = 4000 A", "4000 mA, which is 4 A"]
    assert_refused(run("study", "--vary", "limits.current_A=4000,5000", "--out", "s"), "--vary: ", *said)
    assert_refused(run("study", "--set", "limits.current_A=4000", "--vary", "weights.rho=1", "--out", "s"), *said)


def test_what_is_accepted_is_solved_and_said(run: Run) -> None:
    text = problems.scene_path(LRA).read_text().replace("stroke_m = 0.6e-3", "stroke_m = 0.6")
    for file, head, options in (("asked", "", ["--accept"]), ("stated", 'implausible = "accept"\n', [])):
        Path(f"{file}.toml").write_text(head + text)
        outcome = run("solve", f"{file}.toml", "--no-figures", *options)
        assert outcome.code == 0
        assert "accepted as it is: limits.stroke_m = 0.6 m: devices and hands have" in outcome.out
        assert "**Accepted as it is: limits.stroke_m = 0.6 m: devices" in Path(f"out/{file}/report.md").read_text()
        assert run("verify", f"out/{file}/library.npz").code == 0


def test_a_sheet_that_is_accepted_makes_a_scene_that_accepts(run: Run) -> None:
    stated = [word for pair in {**SHEET, "--peak": 0.04}.items() for word in pair]
    assert_refused(run("plant", "new", "lra", *stated), "--peak = 0.04 V")
    assert run("plant", "new", "lra", *stated, "--accept").code == 0
    assert load_scene("lra.toml").limits.voltage_V == pytest.approx(0.04)


@pytest.mark.parametrize("name", scene_names())
def test_every_built_in_scene_passes(name: str) -> None:
    assert not implausible(load_scene(name).model_dump())


def test_how_well_a_mass_is_known_is_no_mass() -> None:
    drive = {"kind": "drive", "stylus_mass_kg": 0.02, "intervals": {"stylus_mass_kg": [1e-7, 0.1]}}
    assert not implausible({"model": {"kind": "identified", "device": drive}})
    drive["stylus_mass_kg"] = 1e-7
    (wrong,) = implausible({"model": {"kind": "identified", "device": drive}})
    assert wrong.startswith("model.device.stylus_mass_kg = 1e-07 kg: ")
