"""`transopt plant new`: a scene from a datasheet. All numbers here are invented."""

import io
import sys
from pathlib import Path

import numpy as np
import pytest

from tests.benches.commands import Run, assert_refused
from transopt.base import asking
from transopt.library.file import load_library
from transopt.plant.state_space import StateSpace
from transopt.scene.builtin import load_scene
from transopt.scene.datasheet import CYCLES

LRA = {
    "--resonance-Hz": 175.0,
    "--quality": 12.0,
    "--moving-mass-kg": 0.0021,
    "--case-mass-kg": 0.1,
    "--force-factor-N-A": 0.7,
    "--R-ohm": 7.5,
    "--L-H": 8e-5,
    "--rated": 2.5,
    "--peak": 3.0,
    "--stroke-m": 5e-4,
}
SHAKER = {
    "--kind": "shaker",
    "--resonance-Hz": 25.0,
    "--quality": 3.0,
    "--moving-mass-kg": 0.2,
    "--payload-kg": 0.3,
    "--BL": 9.0,
    "--R-ohm": 2.0,
    "--L-H": 3e-4,
    "--peak": 10.0,
    "--stroke-m": 5e-3,
}
BY_CURRENT = {
    "--kind": "voice_coil",
    "--input": "current",
    "--moving-mass-kg": 0.05,
    "--damping-N-s-m": 0.5,
    "--BL": 5.0,
    "--rated": 1.0,
    "--peak": 3.0,
}
FLOATING = {
    "--kind": "voice_coil",
    "--resonance-Hz": 60.0,
    "--quality": 3.0,
    "--moving-mass-kg": 0.05,
    "--case-mass-kg": 0.2,
    "--BL": 5.0,
    "--R-ohm": 6.0,
    "--peak": 3.0,
}
SHEETS = {"lra": LRA, "shaker": SHAKER, "by_current": BY_CURRENT, "floating": FLOATING}


def words(options: dict[str, object]) -> list[object]:
    return [word for pair in options.items() for word in pair]


@pytest.mark.parametrize("name", SHEETS)
def test_the_scene_solves_as_it_is(run: Run, name: str) -> None:
    outcome = run("plant", "new", name, *words(SHEETS[name]))
    assert outcome.code == 0, outcome.err
    assert f"transopt solve {name}.toml" in outcome.out
    assert run("solve", f"{name}.toml", "--no-figures").code == 0
    library = load_library(Path(f"out/{name}/library.npz"))
    # A burst of whole cycles well inside the limits: what is left is what a spring and a rail leave.
    assert library.tap_error.max() < 0.12
    assert library.input_limit == pytest.approx(SHEETS[name]["--peak"])
    assert library.steady_input == pytest.approx(SHEETS[name].get("--rated", SHEETS[name]["--peak"]))


def test_the_numbers_of_the_sheet_are_those_of_the_plant(run: Run) -> None:
    assert run("plant", "new", "lra.toml", *words(LRA)).code == 0
    scene = load_scene("lra.toml")
    assert scene.time.dt_s == pytest.approx(1 / 48e3, rel=1e-12)
    assert scene.targets[0].frequency_Hz == pytest.approx(175)
    assert scene.targets[0].cycles == pytest.approx(CYCLES)
    assert scene.limits.stroke_m == pytest.approx(5e-4)
    for option, value in LRA.items():
        key = option.removeprefix("--").replace("-", "_")
        if key not in ("rated", "peak", "stroke_m"):
            assert getattr(scene.model, key) == pytest.approx(value, rel=1e-12), key


def test_what_thiele_and_small_state_is_a_voice_coil(run: Run) -> None:
    """Fs, Re, Mms, Qes, Qts and Cms of a driver: BL, Q and its plant follow; a brake time stands for Qts."""
    told = {"--kind": "voice_coil", "--R-ohm": 4.0, "--moving-mass-kg": 0.02, "--peak": 3.0}
    w, m, R, Q, BL = 2 * np.pi * 60.0, 0.02, 4.0, 5.0, 6.0
    electrical = m * w * R / BL**2
    total = 1 / (1 / Q + 1 / electrical)
    brake_s = 2 * np.log(10) * total / w
    shared = {**told, "--Qes": electrical}
    ways = {
        "qts": {**shared, "--resonance-Hz": 60, "--Qts": total},
        "brake": {**shared, "--resonance-Hz": 60, "--brake-s": brake_s},
        "spring": {**shared, "--stiffness-N-m": m * w**2, "--Qts": total},
    }
    for name, options in ways.items():
        outcome = run("plant", "new", name, *words(options))
        assert outcome.code == 0, outcome.err
        assert "force factor BL 6 N/A: +-" in outcome.out
        assert ("resonance f0 60 Hz: +-" in outcome.out) == (name == "spring")
        plant = load_scene(f"{name}.toml").plant(0.0)
        pole = np.linalg.eigvals(plant.A)[0]
        assert abs(pole) / (2 * np.pi) == pytest.approx(60, rel=1e-3)
        assert abs(pole) / (-2 * pole.real) == pytest.approx(total, rel=1e-3)
        assert plant.D[0, 0] == pytest.approx(BL / R / m, rel=1e-3)


def test_a_current_that_the_voltage_cannot_drive_is_named(run: Run) -> None:
    sheet = words({"--resonance-Hz": 235, "--R-ohm": 22.5, "--rms-V": 1.8, "--rms-A": 0.09})
    sheet += words({"--case-mass-kg": 0.1, "--peak": 3})
    said = ["1.8 V through 22.5 ohm are 0.08 A at standstill", "the rated current is 0.09 A"]
    more = ["--rms-g", "1.2", "--rise-s", "0.04"]
    for options in (sheet, [*sheet, *more]):
        assert_refused(run("plant", "new", "lra", *options), *said)
    without = [word for word in [*sheet, *more] if word not in ("--rms-A", 0.09)]
    outcome = run("plant", "new", "lra", *without, "--moving-mass-kg", 0.0012)
    assert outcome.code == 0, outcome.err


def test_a_payload_lowers_the_resonance_of_a_shaker_and_leaves_its_spring(run: Run) -> None:
    for name, payload in (("bare", 0.0), ("laden", 0.6)):
        options = {**SHAKER, "--payload-kg": payload, "--input": "current"}
        assert run("plant", "new", name, *words(options)).code == 0
    found = {}
    for name in ("bare", "laden"):
        poles = np.linalg.eigvals(load_scene(f"{name}.toml").plant(0.0).A)
        found[name] = float(np.abs(poles[0])) / (2 * np.pi)
    assert found["bare"] == pytest.approx(25, rel=1e-9)
    assert found["laden"] == pytest.approx(25 / 2, rel=1e-9)  # four times the mass


def test_in_a_case_the_resonance_is_that_of_the_sheet(run: Run) -> None:
    assert run("plant", "new", "floating", *words({**FLOATING, "--input": "current"})).code == 0
    plant = load_scene("floating.toml").plant(0.0)
    pole = np.linalg.eigvals(plant.A)[0]
    assert abs(pole) / (2 * np.pi) == pytest.approx(60, rel=1e-9)
    assert abs(pole) / (-2 * pole.real) == pytest.approx(3, rel=1e-9)


def test_the_target_is_within_reach(run: Run) -> None:
    assert run("plant", "new", "lra", *words(LRA)).code == 0
    scene = load_scene("lra.toml")
    plant = scene.plant(0.0)
    f = np.array([175.0])
    per_volt = abs(plant.response(f)[0])
    displacement = abs(StateSpace(plant.A, plant.B, plant.Ce, np.zeros((1, 1))).response(f)[0])
    peak = scene.targets[0].peak_m_s2
    assert peak is not None
    assert peak / per_volt < 0.26 * 3.0
    assert peak / per_volt * displacement < 0.26 * 5e-4
    assert peak > 0.2 * min(3.0 * per_volt, 5e-4 * per_volt / displacement)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({**LRA, "--rated": 4}, ["rated = 4 V", "above peak = 3 V"]),
        ({**LRA, "--moving-mass-kg": 0.3}, ["--moving-mass-kg = 0.3", "not below --case-mass-kg", "kilograms"]),
        ({**LRA, "--stroke-m": 0.15}, ["--stroke-m = 0.15", "above 0.1 m", "metres"]),
        ({**BY_CURRENT, "--rated": 4}, ["rated = 4 A", "above peak = 3 A"]),
        ({**LRA, "--peak": -3}, ["--peak -3.0: must be greater than 0"]),
        ({**LRA, "--rate-Hz": 1000}, ["--rate-Hz = 1000", "20 times --resonance-Hz = 175 Hz, 3500 Hz"]),
        ({**LRA, "--frequency-Hz": 1}, ["--rate-Hz = 48000", "samples", "at most 20000"]),
        ({**LRA, "--damping-N-s-m": 1}, ["--damping-N-s-m: follows from --resonance-Hz and quality"]),
        ({**LRA, "--payload-kg": 1}, ["--payload-kg: belongs to a shaker"]),
        ({**SHAKER, "--case-mass-kg": 1}, ["--case-mass-kg: a shaker's body is held"]),
        ({k: v for k, v in FLOATING.items() if k != "--quality"}, ["--resonance-Hz and quality belong together"]),
        ({k: v for k, v in BY_CURRENT.items() if k != "--damping-N-s-m"}, ["states --damping-N-s-m: 0 is taken"]),
        ({"--peak": 3}, ["--resonance-Hz, --quality, --case-mass-kg", "missing for --kind inertial", "terminal"]),
        ({"--kind": "speaker"}, ["--kind speaker: unknown; choose inertial, voice_coil, shaker"]),
        ({"--input": "force"}, ["--input force: unknown; choose voltage, current"]),
        ({**LRA, "--moving-mass-kg": 1e9}, ["--moving-mass-kg = 1e+09 kg", "1e-05 to 0.5 kg; check its unit"]),
    ],
)
def test_what_contradicts_is_refused(run: Run, options: dict[str, object], said: list[str]) -> None:
    assert_refused(run("plant", "new", "lra", *words(options)), *said)
    assert not Path("lra.toml").exists()


def test_it_never_overwrites_unasked(run: Run) -> None:
    Path("lra.toml").write_text("precious")
    assert_refused(run("plant", "new", "lra", *words(LRA)), "exists already")
    assert Path("lra.toml").read_text() == "precious"
    assert run("plant", "new", "lra", *words(LRA), "--force").code == 0


class TestAsked:
    @pytest.fixture(autouse=True)
    def person(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(asking, "on_a_terminal", lambda: True)

    def test_what_is_missing_is_asked_for(self, run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
        # Resonance (twice, the first is none), quality, moving mass, case, force factor, R, L offered, rated left
        # out, peak (an empty answer is none), stroke and the rest left out.
        answers = ["fast", "175", "12", "0.0021", "0.1", "0.7", "7.5", "", "", "", "3", "", "", ""]
        monkeypatch.setattr(sys, "stdin", io.StringIO("".join(f"{line}\n" for line in answers)))
        outcome = run("plant", "new", "lra")
        assert outcome.code == 0, outcome.out + outcome.err
        assert "resonance_Hz [Hz]: resonance f0" in outcome.out
        assert "fast: must be a number" in outcome.out
        assert "payload" not in outcome.out
        assert "damping" not in outcome.out
        scene = load_scene("lra.toml")
        assert scene.limits.voltage_V == pytest.approx(3)
        assert scene.limits.stroke_m is None

    def test_without_answers_there_is_no_scene(self, run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(sys, "stdin", io.StringIO(""))
        assert_refused(run("plant", "new", "lra"), "plant new: no answers came")
        assert not Path("lra.toml").exists()
