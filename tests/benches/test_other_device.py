"""The drive of other make: its integration, its nonlinear effects, and that its records show what they say."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.benches import other_records
from tests.benches.identification import DEFAULT, sampled_run
from tests.benches.other_device import TICK_S, Device, FloatArray, Truth, simulate, true_device
from tests.benches.other_records import EFFECTS, multisine, played, record, sweep, truth

pytestmark = pytest.mark.usefixtures("c_compiler")


def burst() -> FloatArray:
    """(800,) 4 A in a few milliseconds, rung down."""
    t = TICK_S * np.arange(800)
    return np.asarray(4 * np.sin(2 * np.pi * 150 * t) * np.exp(-t / 8e-3))


def largest(values: FloatArray) -> float:
    return float(np.abs(values).max())


def test_the_linear_device_moves_as_the_exact_solution_of_transopts_own_chain() -> None:
    command = sweep(seconds=1.0)
    ours = simulate(Device(force_per_current=DEFAULT.force_per_current_N_A), command)
    current, sensed, position = sampled_run(DEFAULT.plant(3.0), command)
    assert largest(ours.current_A - current) < 1e-7
    assert largest(ours.sensed_m_s2 - sensed) < 1e-6 * largest(sensed)
    assert largest(ours.position_m - position) < 1e-6 * largest(position)


@pytest.mark.parametrize("effect", ["none", "friction", "backlash", "stiffening", "soft_limit", "mode_600", "drift"])
def test_steps_a_quarter_as_long_change_nothing(effect: str) -> None:
    device = truth(effect, 1).at(3.0)
    usual, fine = (simulate(device, burst(), finer=finer).acceleration_m_s2 for finer in (1, 4))
    assert largest(usual - fine) < 1e-3 * largest(fine)


def settled(device: Device, current_A: float) -> tuple[float, float]:
    """Positions of motor and stylus after seconds of one current."""
    motion = simulate(device, np.full(20000, current_A))
    position = float(motion.position_m[-1])
    assert largest(motion.acceleration_m_s2[-100:]) < 1e-6
    return position, device.force_per_current * current_A


def test_springs_in_a_row_hold_a_constant_force() -> None:
    device = Device()
    position, force = settled(device, 0.5)
    give = 1 / device.transmission_stiffness + 1 / device.skin_stiffness + 1 / device.arm_stiffness
    assert position == pytest.approx(force * give, rel=1e-6)


def test_play_adds_half_its_width() -> None:
    loose, firm = (settled(replace(Device(), half_gap=gap), 0.5)[0] for gap in (5e-6, 0.0))
    assert loose - firm == pytest.approx(5e-6, rel=1e-4)


def test_a_stiffening_skin_gives_less() -> None:
    device = Truth(Device(), true_device(0, spread=0.0).hand, cubic_length_m=0.5e-3).at(3.0)
    position, force = settled(device, 2.0)
    rest = force / device.transmission_stiffness + force / device.arm_stiffness
    skin = position - rest
    assert device.skin_stiffness * skin * (1 + (skin / 0.5e-3) ** 2) == pytest.approx(force, rel=1e-5)


def test_friction_takes_motion_and_a_soft_limit_takes_current() -> None:
    plain, rubbing, soft = (
        simulate(replace(Device(), **more), burst()) for more in ({}, {"friction": 0.05}, {"soft_limit": 5.0})
    )
    assert largest(rubbing.position_m) < 0.99 * largest(plain.position_m)
    assert largest(soft.current_A) < 0.9 * largest(plain.current_A)


def test_true_devices_differ_by_seed_and_stay_within_the_spread() -> None:
    one, other, middle = (true_device(*of).at(2.0) for of in ((0,), (1,), (0, 0.0)))
    assert one != other
    for name in ("motor_mass", "stylus_mass", "skin_stiffness", "arm_damping", "transmission_damping"):
        assert abs(getattr(one, name) / getattr(middle, name) - 1) <= 0.2


def test_a_tap_without_noise_is_that_of_the_device_and_a_varying_hand_gives_several() -> None:
    command = burst()
    (plain,) = played("none", 0, 3.0, command, 68e-6)
    motion = simulate(true_device(0).at(3.0), np.append(command, 0.0), stride=1)
    np.testing.assert_allclose(plain, motion.acceleration_m_s2[17::25][: plain.size], atol=1e-3 * largest(plain))
    hands = played("varying", 0, 3.0, command, 68e-6)
    assert len(hands) > 3
    assert largest(hands[0] - hands[1]) > 1e-3 * largest(plain)


def test_a_multisine_repeats_and_leaves_lines_to_see_distortion_by() -> None:
    wave = multisine()
    period = round(other_records.PERIOD_S / TICK_S)
    np.testing.assert_allclose(wave[:period], wave[period : 2 * period], atol=1e-9)
    lines = np.abs(np.fft.rfft(wave[:period]))
    excited = lines > 1e-6 * lines.max()
    assert not excited[::2].any()
    assert excited[1::2].sum() > 30
    assert np.count_nonzero(~excited[1:500:2]) > 20
    assert largest(wave) == pytest.approx(other_records.MULTISINE_A)


def distortion(effect: str) -> float:
    """Power at the lines that were not excited over that at those that were, of a device without noise."""
    period = round(other_records.PERIOD_S / TICK_S)
    motion = simulate(truth(effect, 0).at(3.0), multisine())
    lines = np.abs(np.fft.rfft(motion.acceleration_m_s2[-period:]))[1:501] ** 2
    excited = np.abs(np.fft.rfft(multisine()[:period]))[1:501] > 1e-6
    return float(lines[~excited].sum() / lines[excited].sum())


@pytest.mark.parametrize("effect", ["friction", "backlash", "stiffening", "soft_limit"])
def test_a_multisine_at_the_amplitude_of_use_shows_what_is_not_linear(effect: str) -> None:
    assert distortion(effect) > 1e3 * distortion("none")


def test_records_show_what_their_effect_says() -> None:
    command = sweep(seconds=1.0)
    records = {effect: record(effect, 0, 3.0, command, 0) for effect in EFFECTS}
    plain = records["none"]
    assert "accelerometer_Hz" not in records["pole"]
    assert plain["accelerometer_Hz"] == 2500.0
    ratio = np.linalg.norm(records["gain"]["acceleration_m_s2"]) / np.linalg.norm(plain["acceleration_m_s2"])
    assert ratio == pytest.approx(1.2, abs=0.01)
    late = np.correlate(records["late"]["acceleration_m_s2"][1:], plain["acceleration_m_s2"][:-1])
    assert late > np.correlate(records["late"]["acceleration_m_s2"], plain["acceleration_m_s2"])
    assert np.unique(records["adc_10"]["acceleration_m_s2"]).size < np.unique(plain["acceleration_m_s2"]).size / 20
    assert records["clock"]["time_s"][-1] == pytest.approx(1.01 * plain["time_s"][-1])
    assert np.std(np.diff(records["jitter"]["time_s"])) == pytest.approx(np.sqrt(2) * 1e-5, rel=0.05)
    assert records["daq"]["time_s"].size > 4.9 * plain["time_s"].size
    for effect in ("pink", "hum", "tremor"):
        off = records[effect]["acceleration_m_s2"] - plain["acceleration_m_s2"]
        slow = np.abs(np.fft.rfft(off))[: round(200 * command.size * TICK_S)]
        fast = np.abs(np.fft.rfft(off))[round(3000 * command.size * TICK_S) :]
        assert slow.max() > 5 * np.median(fast)


@pytest.fixture
def _short_taps(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    taps = {tap: burst() for tap in other_records.TAPS}
    with monkeypatch.context() as patch:
        patch.setattr(other_records, "tap_commands", lambda: taps)
        yield


@pytest.mark.usefixtures("_short_taps")
def test_files_have_what_a_reader_sorts_them_by(tmp_path: Path) -> None:
    paths = other_records.make_records(tmp_path, "none", 0, grips_N=(3.0,), trials=2)
    files = {path.stem: np.load(path) for path in paths}
    assert sorted(files) == ["multisine_3N", "sweep_3N_1", "sweep_3N_2", "tap_0.1_3N", "tap_0.4_3N"]
    assert files["multisine_3N"]["period_s"] == other_records.PERIOD_S
    assert files["tap_0.4_3N"]["held_out"] == 1
    assert all(file["grip_N"] == 3 for file in files.values())
    first, second = (files[f"sweep_3N_{n}"]["command_A"] for n in (1, 2))
    np.testing.assert_allclose(first, -second)
