"""`transopt-play zero` and drift: the surface in the device file and in the device, which may refuse to move it."""

from pathlib import Path
from types import SimpleNamespace

import pytest

from controller.cli.port import _follow
from controller.device.reading import read_device, restate
from controller.host.driver import RefusedError
from controller.host.kept import surface_is_old
from controller.host.surface import Drift
from controller.protocol.codes import Reason
from controller.servo.interface import State
from tests.benches.commands import Run, assert_refused
from tests.benches.desk import PORT, START_M, Desk

COUNT_M = 24.5e-6
OTHER_START = "the surface was measured at another start"


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


def test_a_surface_of_another_start_is_named_by_the_check(play: Run, touching: Desk) -> None:
    """An encoder counts from where it starts: here 5 mm above where it did when the surface was measured."""
    Path("mine.toml").write_text("[encoder]\nsurface_counts = 500.0\n")
    check = ("check", "library.npz", *PORT, "--device", "mine.toml", "--step", "current-offset")
    assert play("zero", *PORT, "--device", "mine.toml").code == 0
    touching.obeys["hold"]()
    touching.hand.back(touching.now_s())
    assert OTHER_START not in play(*check).out
    touching.restart()
    touching.wrong = lambda seen: seen._replace(encoder_counts=seen.encoder_counts - round(5e-3 / COUNT_M))
    outcome = play(*check)
    assert f"mine.toml: {OTHER_START}" in outcome.out
    assert "transopt-play zero --port desk --device mine.toml" in outcome.out
    restate(Path("mine.toml"), "encoder.surface_counts", 0.5)  # by hand: it may hold at every start
    assert OTHER_START not in play(*check).out


def test_without_a_file_or_without_touches_nothing_is_stored(play: Run, desk: Desk) -> None:
    assert_refused(play("zero", *PORT), "no device file to store the surface in", "device new")
    desk.obeys["touch"] = lambda: None
    Path("mine.toml").write_text("[encoder]\nsurface_counts = 500.0\n")
    assert_refused(
        play("zero", *PORT, "--device", "mine.toml", "--patience", 1), "no 3 touches at one place within 1 s"
    )
    assert read_device(Path("mine.toml")).device.encoder.surface_counts == pytest.approx(500)


def test_drift_between_taps_moves_the_surface(play: Run, ready: Desk) -> None:
    """After each tap the hand lays the stylus down 0.3 mm above where the file has the surface."""
    Path("mine.toml").write_text("[encoder]\nsurface_counts = 0.0  # mine\n")
    next_s = [0.0]

    def look() -> None:
        if ready.end.state is State.ARMED and ready.now_s() >= next_s[0]:
            hand = ready.hand
            hand.tap(ready.now_s() + 0.05, 0.2)
            way = hand.place_m - 0.3e-3
            hand.go(ready.now_s(), (0.1, -0.018), (way / 0.018 - 0.1, -0.018), (0.1, 0.0), (0.4, 0.0))
            hand.go(ready.now_s(), (0.05, 0.2), (0.05, 0.2), (0.05, 0.0), (0.1, 0.0))
            next_s[0] = hand.free_s

    ready.each_ms = look
    outcome = play("tap", "library.npz", *PORT, "--device", "mine.toml", "--taps", 4)
    assert outcome.code == 0, outcome.out + outcome.err
    assert "the counts have drifted: three rests in a row at +1" in outcome.out
    assert "stored in mine.toml" in outcome.out
    moved = read_device(Path("mine.toml")).device.encoder.surface_counts
    assert moved == pytest.approx(0.3e-3 / COUNT_M, abs=3)
    assert "# mine" in Path("mine.toml").read_text()
    boot = ready.end.look().boot
    assert [surface_is_old(Path("mine.toml"), moved, start) for start in (boot, boot + 1)] == [False, True]


def followed(drift: Drift, reason: Reason) -> float:
    """The surface of the recording, behind a device that refuses for this reason."""

    def surface(counts: float) -> None:
        assert counts == pytest.approx(1007.5)
        raise RefusedError(reason.value, reason)

    recorder = SimpleNamespace(surface_counts=1000.0)
    _follow(drift, SimpleNamespace(surface=surface), recorder, SimpleNamespace(), None)  # type: ignore[arg-type]
    return recorder.surface_counts


@pytest.fixture
def drift(monkeypatch: pytest.MonkeyPatch) -> Drift:
    monkeypatch.setattr(Drift, "moved", 7.5)
    return Drift(1e-4, 24.5e-6, 1000.0)


@pytest.mark.parametrize("reason", [Reason.WALL_PUSHES, Reason.STILL_PLAYING])
def test_a_surface_that_was_touched_meanwhile_stays_until_the_next_rest(drift: Drift, reason: Reason) -> None:
    assert (followed(drift, reason), drift.surface_counts) == (1000.0, 1000.0)


def test_any_other_refusal_is_told(drift: Drift) -> None:
    with pytest.raises(RefusedError, match="fault"):
        followed(drift, Reason.FAULT_LATCHED)
