"""`transopt-play zero` and drift: the surface in the device file and in the device."""

from pathlib import Path

import pytest

from controller.device.reading import read_device
from tests.benches.commands import Run, assert_refused
from tests.benches.desk import PORT, START_M, Desk

COUNT_M = 24.5e-6


@pytest.fixture
def touching(desk: Desk) -> Desk:
    """The hand touches the surface three times when it is asked to."""

    def touch() -> None:
        # Down to the surface, a rest, and up by 3 mm, three times.
        down = START_M / 0.1
        desk.hand.go(desk.now_s(), (0.01, -0.1), (down - 0.01, -0.1), (0.01, 0.0), (0.5, 0.0))
        for _ in range(2):
            desk.hand.go(desk.now_s(), (0.01, 0.1), (0.03, 0.1), (0.01, 0.0), (0.1, 0.0))
            desk.hand.go(desk.now_s(), (0.01, -0.1), (0.03, -0.1), (0.01, 0.0), (0.5, 0.0))

    desk.obeys["touch"] = touch
    return desk


def test_the_surface_is_stored_with_the_owners_words(play: Run, touching: Desk) -> None:
    Path("mine.toml").write_text("# mine\n[encoder]\ncount_m = 24.5e-6  # datasheet\nsurface_counts = 500.0\n")
    outcome = play("zero", *PORT, "--device", "mine.toml")
    assert outcome.code == 0, outcome.out + outcome.err
    surface = read_device(Path("mine.toml")).device.encoder.surface_counts
    assert surface == pytest.approx(0.0, abs=6)
    assert "mine.toml: encoder.surface_counts = " in outcome.out
    assert "mm from before" in outcome.out
    assert "# datasheet" in Path("mine.toml").read_text()


def test_without_a_file_or_without_touches_nothing_is_stored(play: Run, desk: Desk) -> None:
    assert_refused(play("zero", *PORT), "no device file to store the surface in", "device new")
    desk.obeys["touch"] = lambda: None
    Path("mine.toml").write_text("[encoder]\nsurface_counts = 500.0\n")
    assert_refused(
        play("zero", *PORT, "--device", "mine.toml", "--patience", 1), "no 3 touches at one place within 1 s"
    )
    assert read_device(Path("mine.toml")).device.encoder.surface_counts == pytest.approx(500)
