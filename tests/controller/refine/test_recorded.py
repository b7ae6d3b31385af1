"""Taps from files: what a record says of a node is what the device did, or one line that says why it says nothing."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from controller.record.played import through_pole
from controller.refine.heard import Heard, fade_of, smooth
from controller.refine.recorded import recorded_tap
from tests.benches.commands import Run, assert_refused
from transopt.base.signals import FloatArray, Signal
from transopt.library.file import load_library
from transopt.library.library import Library
from transopt.recordings.recording import Recording

BANDWIDTH_HZ = 2500.0
NODE = (1, 1)  # 0.2 m/s at 3 N
RATE_HZ = 17e3  # no multiple of the servo's


def recording(library: Library, factor: float = 1.0, start_s: float = 3.2, before_s: float = 0.05) -> Recording:
    """The prediction of a node times a factor, behind the accelerometer's pole and on top of gravity."""
    grid = library.time_grid()
    times = grid.switching_times_s
    at = np.arange(-before_s, 0.05, 1 / RATE_HZ)
    a = factor * Signal(float(times[0]), grid.dt_s, library.acceleration_m_s2[NODE]).at(at)
    sensed = 9.81 + through_pole(a, 1 / RATE_HZ, BANDWIDTH_HZ)
    return Recording("tap.csv", "tap.csv", "", Signal(start_s, 1 / RATE_HZ, sensed), speed_m_s=0.2, grip_N=3.0)


def difference(library: Library, one: Recording) -> FloatArray:
    found = recorded_tap(one, library, BANDWIDTH_HZ)
    assert found.node == NODE
    assert isinstance(found.heard, Heard)
    return found.heard.difference_m_s2


def test_what_the_device_did_beside_the_prediction_wherever_it_begins(library: Library) -> None:
    grid = library.time_grid()
    p = fade_of(grid.switching_times_s) * smooth(library.acceleration_m_s2[NODE], grid.dt_s)
    size = np.linalg.norm(p)
    for start_s in (0.0, 3.2):
        assert np.linalg.norm(difference(library, recording(library, 1.0, start_s))) < 0.01 * size
        found = difference(library, recording(library, 1.2, start_s))
        assert np.linalg.norm(found - 0.2 * p) < 0.012 * size


def test_one_grip_need_not_be_stated(library: Library) -> None:
    assert "states no grip" in str(
        recorded_tap(replace(recording(library), grip_N=None), library, BANDWIDTH_HZ).heard
    )


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"speed_m_s": None}, "states no speed: write a line # speed_m_s"),
        ({"speed_m_s": 0.15}, "0.15 m/s at 3 N is near to no node of the library"),
    ],
)
def test_what_has_to_be_stated(library: Library, changed: dict[str, float | None], words: str) -> None:
    assert words in str(recorded_tap(replace(recording(library), **changed), library, BANDWIDTH_HZ).heard)


@pytest.mark.parametrize(
    ("factor", "words"),
    [
        (-1.0, "points the other way"),
        (9.81, "9.81 times the predicted one: check its unit"),
        (1 / 9.81, "0.102 times the predicted one: check its unit"),
    ],
)
def test_wrong_signs_and_units(library: Library, factor: float, words: str) -> None:
    assert words in str(recorded_tap(recording(library, factor), library, BANDWIDTH_HZ).heard)


def test_records_that_hold_too_little(library: Library) -> None:
    early = recording(library, before_s=0.002)
    assert "to know what the accelerometer reads at rest" in str(recorded_tap(early, library, BANDWIDTH_HZ).heard)
    whole = recording(library).acceleration
    cut = replace(early, acceleration=Signal(0.0, whole.dt_s, whole.values[: int(0.085 * RATE_HZ)]))
    assert "record until 40 ms after contact" in str(recorded_tap(cut, library, BANDWIDTH_HZ).heard)
    random = np.random.default_rng(1)
    noise = replace(early, acceleration=Signal(0.0, 1e-4, random.standard_normal(3000)))
    assert "nothing in it is like the predicted tap" in str(recorded_tap(noise, library, BANDWIDTH_HZ).heard)
    short = replace(early, acceleration=Signal(0.0, 1e-4, random.standard_normal(100)))
    assert "record from 20 ms before contact" in str(recorded_tap(short, library, BANDWIDTH_HZ).heard)


def test_a_hand_that_did_not_come_in_steadily(library: Library) -> None:
    """The hand's acceleration grows from nothing at the beginning of the record to 5 m/s^2 at contact."""
    tap = recording(library)
    x = tap.acceleration
    turned = x.with_values(x.values + np.linspace(0.0, 10.0, x.values.size))
    said = recorded_tap(replace(tap, acceleration=turned), library, BANDWIDTH_HZ).heard
    assert str(said).startswith("no steady approach: ")


class TestCommand:
    """A device of its own is the simulated one here, which records its taps as files."""

    DEVICE = ("--simulate", "--mismatch", 0.2, "--seed", 4, "--grips", 3, "--speeds", "0.2")

    def record(self, play: Run, library: str, folder: str, repeats: int) -> list[Path]:
        outcome = play("record", "tap", library, *self.DEVICE, "--repeats", repeats, "--out", folder)
        assert outcome.code == 0, outcome.err
        # Taps of one number have the same noise with any library: each step takes three of its own.
        return sorted(path for path in Path(folder).glob("*.npz") if int(path.stem[-1]) > repeats - 3)

    def test_step_by_step_to_a_confirmed_library(self, play: Run, library: Library) -> None:
        first = self.record(play, "library.npz", "taps_0", 3)
        outcome = play("refine", "library.npz", "--from-files", *first, "--rounds", 1, "--out", "step_1")
        assert outcome.code == 0, outcome.err
        assert "next: play step_1/library.npz and record 3 taps at" in outcome.out
        assert "0.2 m/s at 3 N" in outcome.out
        assert "fewer than 2 taps, which stay as they were" in outcome.out
        again = play("refine", "step_1/library.npz", "--from-files", *first, "--out", "step_2")
        assert_refused(again, "was learnt from in an earlier step", "record taps of this library")
        assert_refused(play("refine", "step_1/library.npz", "--simulate", "--out", "x"), "between two steps")
        second = self.record(play, "step_1/library.npz", "taps_1", 6)
        outcome = play("refine", "step_1/library.npz", "--from-files", *second, "--rounds", 1, "--out", "step_2")
        assert outcome.code == 0, outcome.err
        assert "better beyond chance at 1" in outcome.out
        third = self.record(play, "step_2/library.npz", "taps_2", 9)
        outcome = play("refine", "step_2/library.npz", "--from-files", *third, "--out", "done")
        assert outcome.code == 0, outcome.err
        assert "1 of 12 nodes refined, confirmed by new taps" in outcome.out
        done = load_library(Path("done/library.npz"))
        told = done.meta["refinement"]
        assert told["learning"] is None
        assert told["confirmed"]["playback_error"][1][1] < told["rounds"][0]["playback_error"][1][1] / 3
        np.testing.assert_array_equal(done.command[2:], library.command[2:])

    def test_what_does_not_go_together(self, play: Run) -> None:
        refuse = lambda *words: play("refine", "library.npz", *words, "--out", "x")  # noqa: E731
        assert_refused(refuse("--from-files"), "--from-files: names no files")
        assert_refused(refuse("--from-files", "--simulate"), "leave --simulate and --port out")
        assert_refused(refuse("--from-files", "--mismatch", 0.1), "--mismatch: not with --from-files")
        assert_refused(refuse("--simulate", "--units", "acc=g"), "--units: only with --from-files")
        assert_refused(refuse("--simulate", "tap.csv"), "FILES: only with --from-files")

    def test_files_that_are_no_such_taps(self, play: Run) -> None:
        random = np.random.default_rng(3)
        for number in (1, 2):
            rows = np.column_stack([1e-4 * np.arange(2000), random.standard_normal(2000)])
            header = "speed_m_s: 0.2\ngrip_N: 3\ntime_s,acceleration_m_s2"
            np.savetxt(f"noise_{number}.csv", rows, "%.6g", ",", header=header)
        outcome = play("refine", "library.npz", "--from-files", "noise_1.csv", "noise_2.csv", "--out", "x")
        assert_refused(outcome, "at least 2 taps at a node are needed")
        assert "noise_1.csv does not count: nothing in it is like the predicted tap" in outcome.out
        Path("copy.csv").write_bytes(Path("noise_1.csv").read_bytes())
        outcome = play("refine", "library.npz", "--from-files", "noise_1.csv", "copy.csv", "--out", "x")
        assert_refused(outcome, "is named twice, or another file is equal to it")
