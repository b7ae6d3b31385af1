"""What an LRA's sheet leaves out, found from the sine that it states, against simulations of other make."""

import math
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest
import scipy
from typer.testing import CliRunner

from transopt.base.errors import InputError
from transopt.cli.main import app
from transopt.scene.builtin import load_scene
from transopt.scene.rated import TOLERANCE, UNKNOWN, Completed, Rating, completed, rated_swing_m

G = 9.80665
Actuator = Mapping[str, float]


def drawn(seed: int) -> Actuator:
    random = np.random.default_rng(seed)
    low = {"m": 8e-4, "BL": 0.5, "Q": 4.0, "R": 8.0, "f": 120.0, "M": 0.06, "V": 0.8}
    high = {"m": 3e-3, "BL": 2.5, "Q": 30.0, "R": 30.0, "f": 280.0, "M": 0.15, "V": 2.0}
    return {key: float(random.uniform(low[key], high[key])) for key in low}


def sheet_of(a: Actuator) -> dict[str, float]:
    """The sheet of an actuator by its equations of motion, in absolute positions of mass and jig, and its coil."""
    m, M, w = a["m"], a["M"], 2 * math.pi * a["f"]
    mu = m * M / (m + M)
    k, c = mu * w**2, mu * w / a["Q"]

    def rates(current_of_rest: float, x: np.ndarray) -> np.ndarray:
        current = (current_of_rest - a["BL"] * (x[2] - x[3])) / a["R"]
        force = a["BL"] * current - k * (x[0] - x[1]) - c * (x[2] - x[3])
        return np.array([x[2], x[3], force / m, -force / M])

    A = np.transpose([rates(0.0, unit) for unit in np.eye(4)])
    B = rates(1.0, np.zeros(4))
    phasor = np.linalg.solve(1j * w * np.eye(4) - A, B * a["V"])
    current = (a["V"] - a["BL"] * (phasor[2] - phasor[3])) / a["R"]
    # The slow part of the motion about the resonance, whose approach to rest is that of a swelling sine.
    slow = -np.linalg.eigvals(A).real
    rise = math.log(10) / float(np.min(slow[slow > 1e-6 * w]))
    return {
        "moving_mass_kg": m,
        "force_factor_N_A": a["BL"],
        "quality": a["Q"],
        "R_ohm": a["R"],
        "resonance_Hz": a["f"],
        "rms_A": abs(current),
        "rms_g": abs(1j * w * phasor[3]) / G,
        "rise_s": rise,
        "brake_s": rise,
        "quality_electrical": w * mu * a["R"] / a["BL"] ** 2,
        "quality_total": w / (2 * math.log(10) / rise),
        "stiffness_N_m": k,
    }


def by_its_sheet(told: Mapping[str, float], a: Actuator) -> Completed:
    return completed(told, Rating(a["M"], rms_V=a["V"], rms_A=told.get("rms_A")))


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("left_out", TOLERANCE)
def test_each_number_follows_from_the_others(seed: int, left_out: str) -> None:
    actuator = drawn(seed)
    sheet = sheet_of(actuator)
    told = {key: value for key, value in sheet.items() if key != left_out}
    found = by_its_sheet(told, actuator)
    again = sheet_of(
        {**actuator, **dict(zip(("m", "BL", "Q", "R", "f"), (found.values[key] for key in UNKNOWN), strict=True))}
    )
    assert again[left_out] == pytest.approx(sheet[left_out], rel=0.25)
    assert found.note == ""


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize(
    ("wrong", "said"), [("quality", "quality Q"), ("rise_s", "rise time"), ("rms_g", "rated acc")]
)
@pytest.mark.parametrize("factor", [0.1, 9.81])
def test_a_number_that_contradicts_the_others_is_named(seed: int, wrong: str, said: str, factor: float) -> None:
    actuator = drawn(seed)
    sheet = sheet_of(actuator)
    told = {**sheet, wrong: factor * sheet[wrong]}
    note = by_its_sheet(told, actuator).note
    assert note.startswith("the numbers contradict each other; one of these is wrong: ")
    assert said in note


def test_a_contradiction_that_leaves_nothing_to_be_found_is_named_and_not_asked_about() -> None:
    """A brake time ten times the rise time, of a coil that motion hardly shows in."""
    sheet = {"R_ohm": 25.0, "rms_A": 0.069, "rms_g": 1.2, "rise_s": 0.04, "quality": 13.0, "resonance_Hz": 235.0}
    rating = Rating(0.1, rms_V=1.8, rms_A=0.069)
    assert completed(sheet, rating).note == ""
    with pytest.raises(InputError, match=r"one of these is wrong: .*brake time 0\.4, by the others 0\.0"):
        completed({**sheet, "brake_s": 0.4}, rating)


def test_intervals_hold_what_sheets_round() -> None:
    """Numbers off by their tolerances lead to values off by what is stated, two times out of three or more."""
    random, inside = np.random.default_rng(9), []
    for seed in range(20):
        actuator = drawn(seed)
        sheet = sheet_of(actuator)
        told = {
            key: sheet[key] * math.exp(TOLERANCE[key] * random.standard_normal())
            for key in ("resonance_Hz", "R_ohm", "rms_A", "rms_g", "rise_s", "quality")
        }
        found = by_its_sheet(told, actuator)
        inside += [abs(math.log(found.values[key] / sheet[key])) < 2 * found.deviations[key] for key in UNKNOWN]
    assert np.mean(inside) > 0.85


def test_too_little_is_asked_for_by_what_would_do() -> None:
    actuator = drawn(0)
    sheet = sheet_of(actuator)
    told = {key: sheet[key] for key in ("R_ohm", "rms_A", "rms_g", "resonance_Hz")}
    with pytest.raises(
        InputError, match="resistance, resonance f0, rated current, rated acceleration: too"
    ) as caught:
        by_its_sheet(told, actuator)
    options = [word[2:].replace("-", "_") for word in str(caught.value).split() if word.startswith("--")]
    assert "rise_s" in options
    for key in options:
        assert by_its_sheet({**told, key: sheet[key]}, actuator).note == ""


def test_the_scene_of_a_sheet_makes_the_rated_acceleration(tmp_path: Path) -> None:
    """A coin of 235 Hz: 1.2 g on a jig of 100 g at 1.8 V and 69 mA through 25 ohm, risen in 40 ms."""
    file = tmp_path / "coin.toml"
    sine = "--rms-V 1.8 --rms-A 0.069 --rms-g 1.2 --rise-s 0.04"
    sheet = f"--resonance-Hz 235 --case-mass-kg 0.1 --R-ohm 25 --peak 3 {sine}"
    ended = CliRunner().invoke(app, ["plant", "new", str(file), *sheet.split()])
    assert ended.exit_code == 0, ended.output
    assert (
        "moving mass 0.0155 kg: a guess: it would swing 0.057 mm at the rating, a tenth of it 0.5 mm; "
        "measure it, and state --moving-mass-kg" in ended.output
    )
    plant = load_scene(str(file)).plant(0.0)
    made = 1.8 * abs(plant.response(np.array([235.0]))[0]) / G
    assert made == pytest.approx(1.2, rel=0.01)
    again = CliRunner().invoke(app, ["plant", "new", str(file), "--kind", "voice_coil", "--rms-V", "1", "--force"])
    assert again.exit_code != 0


def test_mass_times_swing_follows_from_the_rated_acceleration() -> None:
    """The swing of a simulated mass in a case at resonance, by the motion of its two masses in steady state."""
    m, M, f, c, force = 2e-3, 0.1, 200.0, 0.3, 0.5
    w = 2 * math.pi * f
    mu = m * M / (m + M)
    k = mu * w**2
    dynamic = np.array([[k - m * w**2 + 1j * w * c, -k - 1j * w * c], [-k - 1j * w * c, k - M * w**2 + 1j * w * c]])
    mass, case = np.linalg.solve(dynamic, [force, -force])
    rms_g = w**2 * abs(case) / math.sqrt(2) / G
    assert rated_swing_m(M, f, rms_g, m) == pytest.approx(abs(mass - case), rel=1e-9)


def test_a_swelling_sine_rises_as_its_slowest_motion_does() -> None:
    """The rise of the equations, against an integration of the sine itself."""
    a = {"m": 1.5e-3, "BL": 1.2, "Q": 12.0, "R": 12.0, "f": 180.0, "M": 0.1, "V": 1.0}
    m, M, w = a["m"], a["M"], 2 * math.pi * a["f"]
    mu = m * M / (m + M)
    c = mu * w / a["Q"] + a["BL"] ** 2 / a["R"]

    def rates(t: float, x: np.ndarray) -> list[float]:
        return [x[1], (a["BL"] / a["R"] * a["V"] * math.sin(w * t) - mu * w**2 * x[0] - c * x[1]) / mu]

    rise = sheet_of(a)["rise_s"]
    run = scipy.integrate.solve_ivp(
        rates, (0, 3 * rise), [0.0, 0.0], method="DOP853", rtol=1e-9, atol=1e-12, dense_output=True
    )
    times = np.linspace(0, 3 * rise, 20_000)
    size = np.hypot(w * run.sol(times)[0], run.sol(times)[1])
    assert times[np.argmax(size > 0.9 * size[-1])] == pytest.approx(rise, rel=0.1)
