"""Taps by equations of their own, and what the comparison with the real object can find."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import problems
from controller.sim.true_device import device_of
from tests.benches.scripts import script
from transopt.design.build import Build, build_library
from transopt.scene.keys import with_values
from transopt.scene.scene import Scene
from transopt.scene.sections import Feedback
from transopt.scene.strikes import recordings, strike

PARTS = ("played_against_real", "played.motion", "played.figures", "played.wall", "played.missed", "played.hard")
against, motion, figures, walls, missed, extremes = (script(name) for name in PARTS)


@pytest.fixture(scope="module")
def scene() -> Scene:
    return with_values(problems.load("wood_on_foam"), {"grid.speeds_m_s": [0.2], "grid.grips_N": [3.0]})


@pytest.fixture(scope="module")
def build(scene: Scene) -> Build:
    return build_library(scene, recordings(scene))


@pytest.mark.parametrize("yields", ["brakes", "pulls"])
def test_a_struck_object_gives_what_the_recordings_integrate(scene: Scene, yields: Any) -> None:
    """Absolute positions and a method of eighth order here, deviations and Runge-Kutta of fourth order there."""
    target = scene.recordings.simulated
    hand = replace(scene.hand.intention(), yields=yields)
    times, acceleration, encoder = strike(scene.plant(3.0, struck=True), target, np.array([0.2]), 0.1, intention=hand)
    own = motion.Taps(device_of(scene), target, [motion.Tap(0.2, 3.0, motion.Hand(yields))], scene.hand.intention_s)
    found = own.courses(times[::40], np.array([1.0]))
    size = np.abs(acceleration).max()
    np.testing.assert_allclose(found.acceleration_m_s2[0], acceleration[0, ::40], atol=1e-4 * size)
    np.testing.assert_allclose(found.position_m[0], encoder[0, ::40], atol=1e-8)


def test_a_played_tap_is_as_near_to_the_real_one_as_the_table_says(scene: Scene, build: Build) -> None:
    (entry,) = against.played(scene, list(build.all_entries()))
    assert entry.played.tap == pytest.approx(entry.table.tap, abs=0.005)
    assert entry.played.felt == pytest.approx(entry.table.felt, abs=0.005)
    assert entry.played.felt_dB == pytest.approx(entry.table.felt_dB, abs=0.05)
    assert entry.played.speed == pytest.approx(entry.table.speed, abs=0.01)
    assert entry.played.bump_g == pytest.approx(entry.table.bump_g, abs=0.01)
    assert entry.played.heat_A2_ms == pytest.approx(entry.table.heat_A2_ms, rel=0.01)
    assert entry.further < entry.recording < 0.02


@pytest.fixture(scope="module")
def walled() -> Scene:
    return with_values(problems.load("walled"), {"grid.speeds_m_s": [0.2], "grid.grips_N": [5.0]})


@pytest.fixture(scope="module")
def over_a_wall(walled: Scene) -> Build:
    return build_library(walled, recordings(walled))


def test_over_a_wall_a_played_tap_is_what_the_table_says(walled: Scene, over_a_wall: Build) -> None:
    (entry,) = against.played(walled, list(over_a_wall.all_entries()))
    assert entry.apart < 1e-4
    assert entry.further < entry.recording + against.ALLOWED
    assert entry.played.heat_A2_ms == pytest.approx(entry.table.heat_A2_ms, rel=1e-3)


def test_another_wall_than_the_one_of_the_table_is_found(walled: Scene, over_a_wall: Build) -> None:
    other = with_values(walled, {"feedback.damping_N_s_m": 0.4, "feedback.derivative_filter_Hz": 50.0})
    (entry,) = against.played(other, list(over_a_wall.all_entries()))
    assert entry.apart > 1e-3


def test_a_command_that_is_cut_leaves_the_feedback_what_it_made_of_it() -> None:
    """The current goes half the way to the command in a tick; the feedback goes on from where a cut one left it."""
    pole_rad_s, dt_s = float(np.log(2) / 1e-4), 1e-4
    said = Feedback(stiffness_N_m=1.0, damping_N_s_m=0.0, latency_ticks=0)
    wall = walls.Pushing(said, 1.0, pole_rad_s, 1.0, dt_s)
    wall.start(np.zeros(1), np.zeros(1))
    below = np.array([-1.0])  # asks for 1 A, and in one tick for a command of 2 A
    assert wall.command(below, np.zeros(1)) == pytest.approx([1.0])
    assert wall.command(below, np.zeros(1)) == pytest.approx([1.0])
    assert wall.command(-below, np.zeros(1)) == pytest.approx([-0.75])


def test_another_command_than_the_one_of_the_table_is_found(scene: Scene, build: Build) -> None:
    (entry,) = build.all_entries()
    solution = replace(entry.solution, command=np.roll(entry.solution.command, 3))
    told = replace(entry, designed=replace(entry.designed, solution=solution))
    (found,) = against.played(scene, [told])
    assert found.further > found.recording + against.ALLOWED


def test_a_recording_whose_contact_is_put_late_is_found_to_be_nothing_else(scene: Scene) -> None:
    times, real = missed.real_taps(scene)
    (course,) = real.values()
    for late_s in (-120e-6, 0.0, 15e-6):
        recorded = missed.CubicSpline(times, course)(np.minimum(times + late_s, times[-1]))
        whole, found_s, left = missed.placed(times, course, recorded, scene.hand.intention_s)
        assert found_s == pytest.approx(late_s, abs=2e-6)
        assert left.tap < 1e-3
        assert whole.tap > 5e-3 or late_s == 0


def test_hard_scenes_are_no_everyday_ones() -> None:
    everyday = problems.load("wood_on_foam")
    found = dict(extremes.hard())
    assert len(found) > 20
    assert len({repr(each.model_dump()) for each in found.values()}) == len(found)
    assert all(each != everyday for each in found.values())


def test_hard_scenes_stand_in_a_table_of_their_own(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(extremes, "TWO_BY_TWO", {"grid.speeds_m_s": [0.1], "grid.grips_N": [1.0]})
    monkeypatch.setattr(extremes, "HARD", {"rail of 5 V": extremes.HARD["rail of 5 V"]})
    assert against.main(["single_grip"], hard_ones=True) == 0
    printed = capsys.readouterr().out
    assert "rail of 5 V  1  " in printed
    assert "beyond what recordings miss" in printed


def test_a_trembling_hand_passes_contact_with_the_speed_that_is_stated(scene: Scene) -> None:
    hand = motion.Hand("straight", incoming_m_s2=3.0, tremor_m=1e-4, tremor_Hz=9.0, tremor_rad=0.7)
    still = motion.Tap(0.2, 3.0, hand, np.zeros(1))
    own = motion.Taps(device_of(scene), scene.recordings.simulated, [still], scene.hand.intention_s)
    times = np.array([0.0, 1e-4, 2e-4])
    found = own.courses(times, np.array([1.0]))
    assert found.position_m[0, 0] == pytest.approx(0.0, abs=1e-6)
    assert np.gradient(found.position_m[0], times)[0] == pytest.approx(-0.2, abs=2e-3)


def test_a_tap_further_off_than_is_allowed_fails_the_command(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(against, "ALLOWED", -1.0)
    assert against.main(["single_grip"]) == 1
