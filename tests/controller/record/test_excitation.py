"""The excitation's command and the file of a trial, by their defining properties."""

import re

import numpy as np
import pytest
from scipy import signal

from controller.record.excitation import multisine_command, multisine_period_s, sweep_command, tap_command
from controller.record.sweep_plan import FREE_LOW_HZ, Purpose, sweep_plan
from controller.record.trial_file import write_measurement
from transopt.base.errors import InputError

DT_S = 1e-4


def test_a_sweep_is_as_long_as_asked_and_begins_and_ends_in_zero() -> None:
    command = sweep_command(1, 2000, 2.0, 0.75, DT_S, offset_A=0.3)
    assert command.shape == (20_000,)
    assert command[0] == 0
    assert command[-1] == 0
    assert np.max(np.abs(command)) <= 0.3 + 0.75
    # No bang at either end: a step of the offset would be 0.3 A in one tick.
    assert np.max(np.abs(np.diff(command[:50]))) < 0.02
    assert np.max(np.abs(command[-3:])) < 0.05


def test_the_frequency_rises_by_equal_parts_in_equal_times() -> None:
    low, high, seconds = 20.0, 1000.0, 2.0
    command = sweep_command(low, high, seconds, 1.0, DT_S)
    phase = np.unwrap(np.angle(signal.hilbert(command)))
    frequency = np.diff(phase) / (2 * np.pi * DT_S)
    times = DT_S * (np.arange(frequency.size) + 0.5)
    inner = (times > 0.2) & (times < 1.9)
    expected = low * (high / low) ** (times / (seconds - DT_S))
    # Ripple of the Hilbert transform near the ends aside, the instantaneous frequency is the stated one.
    assert np.median(np.abs(frequency / expected - 1)[inner]) < 1e-3


def test_the_amplitude_is_full_in_the_whole_band_but_its_edges() -> None:
    low, high, seconds = 10.0, 1000.0, 1.0
    command = sweep_command(low, high, seconds, 0.75, DT_S)
    times = DT_S * np.arange(command.size)
    frequency = low * (high / low) ** (times / times[-1])
    envelope = np.abs(signal.hilbert(command))
    band = (frequency > 2 * low) & (frequency < 0.95 * high)
    assert np.all(np.abs(envelope[band] / 0.75 - 1) < 0.05)


def test_the_offset_shifts_the_middle() -> None:
    plain = sweep_command(10, 1000, 1.0, 0.5, DT_S)
    shifted = sweep_command(10, 1000, 1.0, 0.5, DT_S, offset_A=-0.4)
    middle = slice(1000, -500)
    np.testing.assert_allclose(shifted[middle] - plain[middle], -0.4, rtol=0, atol=1e-12)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"low_Hz": 0.0}, "low 0 Hz"),
        ({"low_Hz": 3000.0}, "below high"),
        ({"high_Hz": 5000.0}, "half the servo's rate, 5000 Hz"),
        ({"seconds": 0.5}, "seconds 0.5 s: must be 1 s or more, one period of low 1 Hz: give --seconds 1 or a"),
        ({"seconds": float("nan")}, "seconds nan"),
        ({"low_Hz": 900.0, "high_Hz": 1000.0, "seconds": 0.0012}, "12 samples are too few"),
        ({"amplitude_A": -1.0}, "amplitude -1 A"),
        ({"offset_A": float("inf")}, "offset inf A"),
        ({"dt_s": 0.0}, "dt 0 s"),
    ],
)
def test_numbers_out_of_range_are_named(change: dict[str, float], says: str) -> None:
    given = {"low_Hz": 1.0, "high_Hz": 2000.0, "seconds": 2.0, "amplitude_A": 0.75, "dt_s": DT_S, **change}
    with pytest.raises(InputError, match=says):
        sweep_command(**given)


@pytest.mark.parametrize("low_Hz", [0.3, 1.0, 7.0])
def test_the_length_that_is_named_is_taken(low_Hz: float) -> None:
    given = {"high_Hz": 2000.0, "amplitude_A": 0.75, "dt_s": DT_S}
    with pytest.raises(InputError) as refused:
        sweep_command(low_Hz=low_Hz, seconds=0.1, **given)
    named = re.search(r"--seconds ([\d.]+)", str(refused.value))
    assert named is not None
    assert sweep_command(low_Hz=low_Hz, seconds=float(named[1]), **given).size > 0


def test_the_presets_of_a_plan() -> None:
    planned = sweep_plan(Purpose.DEVICE, [0.0, 1.0, 5.0], 4)
    assert [trial.polarity for trial in planned[:4]] == [1, -1, 1, -1]
    assert [trial.low_Hz for trial in planned] == [FREE_LOW_HZ] * 4 + [1.0] * 8
    assert {trial.high_Hz for trial in planned} == {2000.0}
    assert planned[5].file_name == "device_1N_2_neg.npz"
    amplifier = sweep_plan(Purpose.AMPLIFIER, None, 2)
    assert [(trial.grip_N, trial.offset_A) for trial in amplifier] == [(3.0, 0.0)] * 2 + [(3.0, 0.5)] * 2
    assert amplifier[3].file_name == "amplifier_3N_0.5A_2_neg.npz"
    offset = amplifier[2].command(DT_S)
    np.testing.assert_array_equal(offset, -amplifier[3].command(DT_S))
    # Over the middle of the sweep the offset keeps the current clear of the crossover.
    assert offset[offset.size // 4 : -offset.size // 10].min() > 0.1
    assert len({trial.file_name for trial in [*planned, *amplifier]}) == 16


def test_plans_that_are_refused() -> None:
    for grips, trials, words in (
        ([], 1, "at least one"),
        ([3.0, 3.0], 1, "once"),
        ([-1.0], 1, "0 to 50 N"),
        (None, 0, "--trials 0"),
    ):
        with pytest.raises(InputError, match=words):
            sweep_plan(Purpose.DEVICE, grips, trials)


def test_a_measurement_comes_back_as_it_was(tmp_path) -> None:
    path = tmp_path / "trial_01.npz"
    time = DT_S * np.arange(50)
    write_measurement(path, {"time_s": time, "command_A": np.sin(time)}, {"grip_N": 2.5, "accelerometer_Hz": 4000.0})
    with np.load(path, allow_pickle=False) as read:
        assert set(read.files) == {"time_s", "command_A", "grip_N", "accelerometer_Hz"}
        np.testing.assert_array_equal(read["command_A"], np.sin(time))
        assert read["grip_N"].shape == ()
        assert read["grip_N"] == 2.5
    assert [one.name for one in tmp_path.iterdir()] == ["trial_01.npz"]


def test_a_tap_reaches_its_peak_and_ends_at_rest() -> None:
    command = tap_command(4.0, DT_S)
    assert np.abs(command).max() == pytest.approx(4.0)
    assert (command[0], command[-1]) == (0.0, 0.0)
    assert np.abs(command[-100:]).max() < 1e-4
    for peak_A, dt_s in ((0.0, DT_S), (np.nan, DT_S), (4.0, 1e-3)):
        with pytest.raises(InputError, match="tap: "):
            tap_command(peak_A, dt_s)


@pytest.mark.parametrize("dt_s", [DT_S, 5e-5, 4e-4])
def test_a_multisine_repeats_and_excites_odd_lines_alone(dt_s: float) -> None:
    command, period_s = multisine_command(2.0, dt_s), multisine_period_s(dt_s)
    size = round(period_s / dt_s)
    assert period_s == pytest.approx(size * dt_s)
    assert (command[0], command[-1]) == (0.0, 0.0)
    assert np.abs(command).max() <= 2.0 + 1e-12
    whole = command[size : 4 * size].reshape(3, size)
    np.testing.assert_allclose(whole, np.broadcast_to(whole[0], whole.shape), atol=1e-12)
    assert np.abs(whole[0]).max() == pytest.approx(2.0)
    lines = np.abs(np.fft.rfft(whole[0]))
    excited = np.flatnonzero(lines > 1e-6 * lines.max())
    assert np.all(excited % 2 == 1)
    assert excited[0] / period_s == pytest.approx(10.0, abs=5.0)
    assert excited[-1] / period_s == pytest.approx(1000.0, abs=60.0)
    odd = np.arange(excited[0], excited[-1] + 1, 2)
    assert np.setdiff1d(odd, excited).size > 20  # some are left out to listen at
    assert np.sqrt(np.mean(whole[0] ** 2)) > 2.0 / 3.5  # not one tall peak
    for peak_A, period in ((0.0, DT_S), (np.inf, DT_S), (1.0, 1e-3)):
        with pytest.raises(InputError, match="multisine: "):
            multisine_command(peak_A, period)


def test_at_the_current_of_use_taps_and_a_multisine_follow_the_sweeps_of_each_grip() -> None:
    planned = sweep_plan(Purpose.DEVICE, [1.0, 3.0], 2, tap_A=4.0)
    assert [trial.file_name for trial in planned[:5]] == [
        "device_1N_1_pos.npz",
        "device_1N_2_neg.npz",
        "device_1N_tap_1_pos.npz",
        "device_1N_tap_2_neg.npz",
        "device_1N_multisine_1_pos.npz",
    ]
    assert [np.abs(trial.command(DT_S)).max() for trial in planned[2:5]] == pytest.approx([4.0, 4.0, 2.0])
    assert [trial.period_s(DT_S) for trial in planned[3:5]] == [None, pytest.approx(0.4)]
    assert len({trial.file_name for trial in planned}) == 10


@pytest.mark.parametrize(
    ("columns", "scalars"),
    [
        ({"time_s": np.zeros(3), "acceleration_g": np.zeros(3)}, {}),
        ({"command_A": np.zeros(3)}, {}),
        ({"time_s": np.zeros(3), "command_A": np.zeros(4)}, {}),
        ({"time_s": np.array([0.0, np.nan])}, {}),
        ({"time_s": np.zeros(3)}, {"grip_N": np.nan}),
        ({"time_s": np.zeros(3)}, {"mass_kg": 1.0}),
    ],
)
def test_nothing_is_written_that_no_reader_understands(tmp_path, columns, scalars) -> None:
    with pytest.raises(ValueError, match=r"columns|shapes|finite"):
        write_measurement(tmp_path / "x.npz", columns, scalars)
    assert not list(tmp_path.iterdir())


def test_a_place_that_cannot_be_written_is_named(tmp_path) -> None:
    with pytest.raises(InputError, match=r"there is no folder .*: create it"):
        write_measurement(tmp_path / "no" / "x.npz", {"time_s": np.zeros(3)}, {})
