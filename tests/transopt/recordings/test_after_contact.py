"""Recordings whose own hand pulls back are found, and no others."""

from dataclasses import replace

import numpy as np
import pytest

import problems
from tests.benches.places import IMPACTS
from transopt.base.signals import Signal
from transopt.files.names import Layout
from transopt.recordings.after_contact import pulled_back_after_s
from transopt.recordings.recording import load_recording
from transopt.recordings.settings import Recordings
from transopt.recordings.tap import prepare
from transopt.scene.keys import with_values
from transopt.scene.strikes import recordings

OBJECTS = ("wood_on_foam", "hard_metal", "soft_rubber", "second_order", "free_stylus")
SAID = "the hand pulls the stylus back"


def notes_of(scene_name: str, law: str) -> list[str]:
    """Notes of each tap that a hand of that law makes, joined."""
    scene = with_values(problems.load(scene_name), {"hand.yields": law, "recordings.simulated.repeats": 1})
    return ["; ".join(prepare(tap, scene.recordings).notes) for tap in recordings(scene)]


@pytest.mark.parametrize("scene_name", OBJECTS)
@pytest.mark.parametrize("law", ["pulls", "brakes", "straight", "stops", "decays"])
def test_a_hand_that_pulls_is_found_and_no_other(scene_name: str, law: str) -> None:
    assert {SAID in notes for notes in notes_of(scene_name, law)} == {law == "pulls"}


def position(z_m: np.ndarray) -> Signal:
    return Signal(-0.03, 1e-4, z_m)


def test_a_free_rebound_is_no_pull() -> None:
    """A ball that comes back as fast as it came, and slows down, or goes on."""
    t = -0.03 + 1e-4 * np.arange(1500)
    for slowing_m_s2 in (0.0, 5.0):
        z = np.where(t < 0, -0.2 * t, 0.2 * t - slowing_m_s2 * t**2 / 2)
        assert pulled_back_after_s(position(z), 0.0) is None
    out = np.where(t < 0.03, -1e-3, -1e-3 + (t - 0.03) ** 2)
    assert pulled_back_after_s(position(np.where(t < 0, -0.2 * t, out)), 0.0) is not None


def test_a_short_record_says_nothing() -> None:
    assert pulled_back_after_s(Signal(-0.03, 1e-4, np.zeros(600)), 0.0) is None


@pytest.mark.skipif(not IMPACTS.is_dir(), reason="the recorded impacts (CC BY-SA) are not part of the project")
def test_recorded_impacts_are_silent() -> None:
    settings = Recordings(files=["unused"], speed_m_s=1.14, implausible="accept")
    for path in sorted(IMPACTS.glob("*.txt")):
        recording = load_recording(path, Layout(columns=["time_s", "acceleration_g"]))
        assert SAID not in "; ".join(prepare(replace(recording, speed_m_s=1.14), settings).notes)
