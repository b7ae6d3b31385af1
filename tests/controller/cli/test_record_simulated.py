"""`transopt-play record --simulate`: the recorder of any port, on a simulated device in a simulated hand."""

import re
import shlex
from pathlib import Path

import numpy as np
import pytest

from controller.sim.sensors import SEED_SENSORS
from tests.benches.commands import Run, assert_refused, captured
from transopt.identify.hand.tap import usable_taps
from transopt.identify.measurement import load_measurement
from transopt.recordings.recording import load_recording
from transopt.scene.builtin import scene_path
from transopt.scene.scene import Scene

SWEEP = ("record", "sweep", "--simulate", "--out", "sweeps")
OBJECT = ("record", "tap", "--simulate", "--object", "--out", "t")


def columns(path: str) -> dict[str, np.ndarray]:  # type: ignore[type-arg]
    with np.load(path, allow_pickle=False) as file:
        return {name: file[name] for name in file.files}


def test_sweeps_of_a_series(play: Run) -> None:
    arguments = ("--grips", "0,2.5", "--trials", 2, "--seconds", 0.3, "--low", 20, "--mismatch", 0.1, "--seed", 4)
    outcome = play(*SWEEP, *arguments)
    assert outcome.code == 0, outcome.err
    assert "20 to 2000 Hz, 0.75 A on sim:, gain 1" in outcome.out
    assert "4 sweeps of 0.3 s" in outcome.out
    assert "transopt identify device sweeps/device_*.npz" in outcome.out
    names = sorted(path.name for path in Path("sweeps").iterdir())
    assert (names[0], names[3]) == ("device_0N_1_pos.npz", "device_2.5N_2_neg.npz")
    taken, free = load_measurement(Path("sweeps") / names[3]), load_measurement(Path("sweeps") / names[0])
    assert taken.grip_N == pytest.approx(2.5, rel=0.06)
    assert free.grip_N == 0.0
    assert taken.accelerometer_Hz == 2500.0
    for quantity in ("command", "current", "acceleration", "position"):
        assert taken.require(quantity).rate_Hz == pytest.approx(1e4)
    again = play(*SWEEP, *arguments)
    assert_refused(again, "--out sweeps: holds a recording already (device_0N_1_pos.npz)", "another folder")
    joined = play(*SWEEP, "--grips", 4, *arguments[2:])
    assert joined.code == 0, joined.err
    assert len(list(Path("sweeps").iterdir())) == 6


def test_taps_at_the_current_of_use_are_marked_as_kept_out_of_the_fit(play: Run) -> None:
    arguments = ("--grips", 3, "--trials", 1, "--seconds", 0.3, "--low", 20, "--tap-current", 3.5)
    outcome = play(*SWEEP, *arguments)
    assert outcome.code == 0, outcome.err
    assert "1 sweeps of 0.3 s, 2 taps, 1 multisines" in outcome.out
    repeated = load_measurement(Path("sweeps/device_3N_multisine_1_pos.npz"))
    assert repeated.period_s == pytest.approx(0.4)
    assert np.abs(repeated.require("current").values).max() == pytest.approx(1.75, rel=0.1)
    taps = [load_measurement(path) for path in sorted(Path("sweeps").glob("*_tap_*.npz"))]
    assert [one.name for one in taps] == ["device_3N_tap_1_pos.npz", "device_3N_tap_2_neg.npz"]
    assert all(one.held_out for one in taps)
    for one, sign in zip(taps, (1, -1), strict=True):
        current = sign * one.require("current").values
        assert current.max() == pytest.approx(3.5, rel=0.05)
        assert current.max() > -current.min()
    assert not load_measurement(Path("sweeps/device_3N_1_pos.npz")).held_out
    assert_refused(play(*SWEEP, "--tap-current", 0), "--tap-current")


def test_the_transfer_function_of_the_truth(play: Run, scene: Scene) -> None:
    """Spectra of two polarities: acceleration over current is the chain behind the sensor's pole."""
    outcome = play(*SWEEP, "--grips", 3, "--trials", 2, "--high", 1000, "--low", 5, "--seconds", 1, "--crossover", 0)
    assert outcome.code == 0, outcome.err
    one, other = (columns(f"sweeps/device_3N_{name}.npz") for name in ("1_pos", "2_neg"))
    spectra = {name: np.fft.rfft(one[name] - other[name], 1 << 16) for name in ("current_A", "acceleration_m_s2")}
    frequencies = np.fft.rfftfreq(1 << 16, 1e-4)
    band = (frequencies > 10) & (frequencies < 100)  # where the hold's staircase is a straight line
    found = spectra["acceleration_m_s2"][band] / spectra["current_A"][band]
    pole = 1 / (1 + 1j * frequencies[band] / SEED_SENSORS.accelerometer_bandwidth_Hz)
    wanted = scene.plant(3.0).response(frequencies[band]) * pole
    assert np.median(np.abs(found / wanted - 1)) < 0.02
    # The noise is another in each trial, and that of the accelerometer.
    total = one["acceleration_m_s2"] + other["acceleration_m_s2"]
    assert float(total.std()) == pytest.approx(2**0.5 * SEED_SENSORS.accelerometer_noise_m_s2, rel=0.1)


def test_more_samples_than_a_device_usually_holds(play: Run) -> None:
    outcome = play(*SWEEP, "--grips", 3, "--trials", 1, "--seconds", 2.1)
    assert outcome.code == 0, outcome.err


def test_taps_of_a_library(play: Run) -> None:
    outcome = play("record", "tap", "library.npz", "--simulate", "--speeds", 0.25, "--grips", "2,4", "--out", "t")
    assert outcome.code == 0, outcome.err
    assert "2 taps, tap_0.25m_s_2N_1.npz to tap_0.25m_s_4N_1.npz" in outcome.out
    taken = load_measurement(Path("t/tap_0.25m_s_2N_1.npz"))
    assert taken.speed_m_s == pytest.approx(0.25, rel=5e-3)
    command, current = taken.require("command"), taken.require("current")
    assert np.abs(command.values).max() > 1
    assert np.abs(current.values).max() > 1
    before = taken.require("acceleration").values[command.times_s < -1e-3]
    assert float(np.abs(before).max()) < 1


def test_taps_on_an_object(play: Run) -> None:
    """The recorded force is the only force on chain and hand: it decelerates them at impact."""
    outcome = play(*OBJECT, "--speeds", 0.3, "--grips", 3, "--repeats", 2, "--force-noise", 0)
    assert outcome.code == 0, outcome.err
    assert "transopt taps t/tap_*.npz" in outcome.out
    one, other = (columns(f"t/tap_0.3m_s_3N_{n}.npz") for n in (1, 2))
    assert one["time_s"][0] != other["time_s"][0]
    times, force, acceleration = one["time_s"], one["force_N"], one["acceleration_m_s2"]
    assert (force.min(), force[times < -1e-4].max()) == (0.0, 0.0)
    assert abs(times[force > 0][0]) <= 2e-4
    assert 60 < acceleration.max() < 120
    assert float(acceleration[times < -2e-4].std()) < 1.1 * SEED_SENSORS.accelerometer_noise_m_s2
    slope = np.polyfit(times[times < 0], one["position_m"][times < 0], 1)[0]
    assert slope == pytest.approx(-0.3, rel=2e-3)
    assert not one["command_A"].any()
    assert float(one["grip_N"]) == pytest.approx(3.0, abs=0.15)
    as_a_tap = load_recording(Path("t/tap_0.3m_s_3N_1.npz"))
    assert as_a_tap.speed_m_s == pytest.approx(0.3, rel=2e-3)
    np.testing.assert_array_equal(as_a_tap.acceleration.values, acceleration)


def test_the_accelerometer_has_the_range_of_the_scenes_recordings(play: Run) -> None:
    """The range of `firm_fast` is 50 g; a tap of 19 g would clip the built-in sensor of 18 g."""
    outcome = play(*OBJECT, "--true-device", "firm_fast", "--speeds", 0.6, "--grips", 1)
    assert outcome.code == 0, outcome.err
    peak_m_s2 = np.abs(columns("t/tap_0.6m_s_1N_1.npz")["acceleration_m_s2"]).max()
    assert peak_m_s2 > SEED_SENSORS.accelerometer_range_g * 9.81


def test_taps_beyond_the_range_have_no_file_and_a_reason(play: Run) -> None:
    text = scene_path("firm_fast").read_text(encoding="utf-8")
    Path("narrow.toml").write_text(text.replace("range_g = 50.0 ", "range_g = 10.0 "))
    outcome = play(*OBJECT, "--true-device", "narrow.toml", "--speeds", "0.1,0.6", "--grips", 1)
    assert outcome.code == 1
    assert "1 of 2 taps have no file, tap_0.6m_s_1N_1.npz: the accelerometer was at its rail at" in outcome.err
    assert [path.name for path in Path("t").iterdir()] == ["tap_0.1m_s_1N_1.npz"]


def test_the_hand_is_read_from_taps_on_a_soft_object(play: Run) -> None:
    """A soft object's force rises out of the noise milliseconds after contact: displacements begin where it began."""
    outcome = play(*OBJECT, "--speeds", 0.1, "--grips", "1,5")
    assert outcome.code == 0, outcome.err
    trials = [load_measurement(path) for path in sorted(Path("t").glob("*.npz"))]
    taps, complaints = usable_taps(trials)
    assert complaints == []
    for trial, tap in zip(trials, taps, strict=True):
        force, position = trial.require("force"), trial.require("position").values
        times = force.times_s
        before = times < -0.01
        straight = np.polynomial.Polynomial.fit(times[before], position[before], 1)
        away = (position - straight(times))[: np.searchsorted(times, 0.03)]
        assert float(tap.displacement_m[-1]) == pytest.approx(float(away[-1]), rel=0.05)


def test_a_touch_too_light_for_the_trigger_is_named(play: Run) -> None:
    outcome = play(*OBJECT, "--speeds", "0.03,0.2", "--grips", "1,3")
    assert outcome.code == 1
    assert "nothing above 1 g (--trigger) in tap_0.03m_s_1N_1.npz, tap_0.03m_s_3N_1.npz, the softest" in outcome.err
    (trigger,) = re.findall(r"give --trigger ([\d.]+), another --out", outcome.err)
    lower = play(*OBJECT[:-1], "lower", "--speeds", 0.03, "--grips", "1,3", "--trigger", trigger)
    assert lower.code == 0, lower.err
    assert len(list(Path("lower").iterdir())) == 2


def test_heat(play: Run) -> None:
    outcome = play(
        "record", "heat", "--simulate", "--heating", 60, "--cooling", 30, "--out", "h", "--true-device", "hot_coil"
    )
    assert outcome.code == 0, outcome.err
    assert load_measurement(Path("h/heat.npz")).require("winding").values.size == 91


@pytest.mark.parametrize("motor_of", ["wood_on_foam", "hot_coil", "small_coil"])
def test_the_command_that_a_heating_record_prints_finds_the_coil(play: Run, motor_of: str) -> None:
    """Also where taps begin on a hot coil, and where the motor is another than the default one."""
    short = ("--heating", 900, "--cooling", 600, "--every", 0.4)
    outcome = play("record", "heat", "--simulate", *short, "--true-device", motor_of, "--out", "my heat")
    assert outcome.code == 0, outcome.err
    found = captured(*shlex.split(outcome.out.split("next: ")[1]))
    assert found.code == 0, found.out + found.err
    assert "verdict: supports temperature limits" in found.out


def test_the_command_that_sweeps_print_names_their_files_and_their_scene(play: Run) -> None:
    sweep = ("record", "sweep", "--simulate", "--trials", 1, "--seconds", 0.2, "--low", 20, "--grips", 3)
    for scene, named in (("wood_on_foam", []), ("second_order", ["--scene", "second_order"])):
        outcome = play(*sweep, "--true-device", scene, "--out", f"of {scene}")
        assert outcome.code == 0, outcome.err
        words = shlex.split(outcome.out.split("next: ")[1].splitlines()[0])
        assert words == ["transopt", "identify", "device", f"of {scene}/device_*.npz", *named, "--out", "MODEL.json"]
