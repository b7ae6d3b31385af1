"""`transopt-play device new|show`, and device files in the commands."""

import io
import sys
from pathlib import Path

import pytest

from controller.device.reading import find, read_device
from tests.benches.commands import Run, assert_refused


def answering(monkeypatch: pytest.MonkeyPatch, *lines: str) -> None:
    monkeypatch.setattr(sys, "stdin", io.StringIO("".join(f"{line}\n" for line in lines)))


def test_a_device_is_asked_for_step_by_step(play: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    # Name, encoder, no grip sensor, accelerometer, amplifier, servo, hardware; wrong answers are asked again.
    encoder, grip = ["far", "1", "1e-5", "-1", "1234"], ["perhaps", "no", "2.5"]
    answering(monkeypatch, "desk", *encoder, *grip, "", "", "9.81", "1600", "0.5", "16", "", "", "1e-4", "", "", "")
    outcome = play("device", "new", "mine.toml")
    assert outcome.code == 0, outcome.out + outcome.err
    assert "count_m [m]: path of the tip per count" in outcome.out
    assert "1: must be less than or equal to 0.0001" in outcome.out
    assert "perhaps: answer yes or no" in outcome.out
    assert "grip.scale" not in outcome.out
    assert "0.5: must be greater than or equal to 1" in outcome.out
    device = read_device(Path("mine.toml")).device
    assert (device.name, device.encoder.direction, device.grip.sensor) == ("desk", -1, False)
    assert device.encoder.surface_counts == pytest.approx(1234)
    assert device.accelerometer.bandwidth_Hz == pytest.approx(1600)
    assert device.accelerometer.range_g == pytest.approx(16)
    assert_refused(play("device", "new", "mine.toml"), "mine.toml: is there already")


def test_without_answers_there_is_no_file(play: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    answering(monkeypatch)
    assert_refused(play("device", "new", "mine.toml"), "no answers came", "--defaults")
    assert not Path("mine.toml").exists()
    assert play("device", "new", "mine.toml", "--defaults", "--from", "voice_coil").code == 0
    assert read_device(Path("mine.toml")).device.servo.dt_s == pytest.approx(5e-5)


def test_show_says_what_is_stated_and_what_is_built_in(play: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "200")
    Path("mine.toml").write_text("[encoder]\ncount_m = 1e-5\n")
    shown = play("device", "show", "mine.toml").out
    [row] = [line for line in shown.splitlines() if "encoder.count_m" in line]
    assert "1e-05" in row
    assert "yes" in row
    assert "no: built-in" in shown
    words = find("mine.toml").in_words
    assert "encoder.direction" in words
    assert "hardware.current_A" not in words, "the device itself says it"
    assert "built-in examples: voice_coil, with_grip, without_grip" in play("device", "show").out
    assert_refused(play("device", "show", "with_gripp"), "did you mean with_grip")


@pytest.mark.parametrize(
    "text",
    [
        "[encoder]\ncount_m = 1e-5\nsurface_counts = 1234\n[grip]\nsensor = false\nassumed_grip_N = 3.0\n",
        "[encoder]\ncount_m = 1e-6\n[accelerometer]\nbandwidth_Hz = 4000\n",
    ],
)
def test_a_simulated_tap_on_the_device_of_a_file(play: Run, text: str) -> None:
    """A fine encoder, its surface elsewhere, and no grip sensor: as good as the built-in device."""
    Path("device.toml").write_text(text)
    outcome = play("tap", "library.npz", "--simulate", "--speed", 0.3, "--grip", 3, "--crossover", 0)
    assert outcome.code == 0, outcome.out + outcome.err
    assert "device: device.toml" in outcome.out
    [row] = [line.split("│") for line in outcome.out.splitlines() if line.startswith("│   1 ")]
    speed, grip, latency_us, tap_error, error = (float(cell) for cell in row[2:7])
    assert speed == pytest.approx(0.3, rel=0.01)
    assert grip == pytest.approx(3.0, abs=0.2)
    assert abs(latency_us) < 15
    assert tap_error == pytest.approx(20, abs=1)
    assert error < 1.5


def test_a_grip_beyond_the_library_is_moved_to_its_edge_and_said_so(play: Run) -> None:
    Path("blind.toml").write_text("[grip]\nsensor = false\nassumed_grip_N = 20\n")
    outcome = play("record", "tap", "library.npz", "--simulate", "--out", "taps", "--device", "blind.toml")
    assert outcome.code == 0, outcome.out + outcome.err


def test_a_simulated_device_is_wired_as_its_file_says(play: Run) -> None:
    """Reversed, upside down, of other scales, with gravity: the device puts all of it right by the same file."""
    Path("odd.toml").write_text(
        "[encoder]\ndirection = -1\nsurface_counts = 700\n[grip]\nscale = -2.0\nzero_N = 0.5\n"
        "[accelerometer]\nscale = -0.5\nrest_m_s2 = 9.81\n[amplifier]\nscale = -2.0\nmonitor_scale = 3.0\n"
    )
    outcome = play("tap", "library.npz", "--simulate", "--speed", 0.3, "--grip", 3, "--device", "odd.toml")
    assert outcome.code == 0, outcome.out + outcome.err
    plain = play("tap", "library.npz", "--simulate", "--speed", 0.3, "--grip", 3)
    rows = [
        next(line.split("│") for line in run.out.splitlines() if line.startswith("│   1 "))
        for run in (outcome, plain)
    ]
    for odd, usual, room in zip(rows[0][2:8], rows[1][2:8], (0.002, 0.05, 3, 0.3, 0.05, 0.05), strict=True):
        assert float(odd) == pytest.approx(float(usual), abs=room)
