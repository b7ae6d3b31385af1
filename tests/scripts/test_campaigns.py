"""Unplugs, kills, uploads and taps on the compiled device: the scripts of these names in short."""

import os
from pathlib import Path

import pytest

from controller.record.telemetry import CSV_NAME, Telemetry
from controller.servo.interface import Output, Readings, State
from scripts import device_end_to_end as end_to_end
from scripts.campaign.unplug_cases import IMAGE, KINDS, PHASES, Case, Judged, Outcome
from scripts.campaign.unplug_processes import play
from scripts.upload_speed import LINES, Line, images, measure
from transopt.library.library import Library

pytestmark = pytest.mark.usefixtures("c_compiler")

CASES = 12


@pytest.fixture
def _terminal() -> None:
    try:
        for end in os.openpty():
            os.close(end)
    except OSError as error:
        pytest.skip(f"no pseudo-terminals here: {error}")


@pytest.fixture(scope="module")
def outcomes(tmp_path_factory: pytest.TempPathFactory) -> list[Outcome]:
    folder = tmp_path_factory.mktemp("campaign")
    kinds, phases = len(KINDS), list(PHASES)
    cases = [(phases[j % len(phases)], KINDS[(j + j // kinds) % kinds]) for j in range(CASES)]
    return [case_of(*case, folder / str(j), j).play() for j, case in enumerate(cases)]


def test_whatever_happens_the_device_is_safe_and_the_host_says_so(outcomes: list[Outcome]) -> None:
    assert [words for outcome in outcomes for words in outcome.breaches] == []


def test_the_cases_are_of_every_kind(outcomes: list[Outcome]) -> None:
    """Else they would show little."""
    assert {outcome.kind for outcome in outcomes} == set(KINDS)
    assert {outcome.phase for outcome in outcomes} == set(PHASES)
    # Some device had to give up by itself, at the very end of its lease.
    assert max(outcome.held_ms / outcome.lease_ms for outcome in outcomes) > 0.95
    assert sum(outcome.rows for outcome in outcomes) > 1000


def case_of(phase: str, kind: str, folder: Path, seed: int = 0) -> Case:
    case = Case(seed, folder)
    case.outcome.phase, case.outcome.kind = phase, kind
    return case


def test_a_device_that_goes_on_is_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """One that commands once more as its lease ends."""
    step = Judged.step

    def late(self: Judged, readings: Readings) -> Output:
        was = self.state
        output = step(self, readings)
        if was is not State.IDLE and output.state is State.IDLE:
            self._hold(readings.tick, Output(0.1, was, 0.0, 0.0, 25.0))
        return output

    monkeypatch.setattr(Judged, "step", late)
    [words] = case_of("armed", "host killed", tmp_path / "late").play().breaches
    assert "ticks after a heartbeat" in words


def test_a_host_that_arms_by_itself_is_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    case = case_of("armed", "cable", tmp_path / "arms")
    world = case._world
    connected = world.connected

    def arming() -> object:
        connected()
        case._configure()
        world.session.upload(IMAGE)
        world.until(lambda: world.session.idle, 1.0)
        case._arm()
        return world

    monkeypatch.setattr(world, "connected", arming)
    assert any("armed by itself after connecting again" in words for words in case.play().breaches)


def test_a_spoilt_recording_is_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    flush = Telemetry.flush

    def spoilt(self: Telemetry) -> None:
        self._rows = [tuple("idle" if each == "armed" else each for each in row) for row in self._rows]
        flush(self)

    monkeypatch.setattr(Telemetry, "flush", spoilt)
    breaches = case_of("playing", "cable", tmp_path / "spoilt").play().breaches
    assert any(words.startswith("recording: tick") for words in breaches)


@pytest.mark.usefixtures("_terminal")
def test_a_host_is_killed(tmp_path: Path) -> None:
    ended = play(4, tmp_path / "real", kind="host killed")
    assert ended.breaches == []
    assert ended.phase == "armed"
    assert ended.held_ms > 0.9 * ended.lease_ms
    assert (tmp_path / "real" / CSV_NAME).exists()


@pytest.mark.usefixtures("_terminal")
@pytest.mark.parametrize(
    "line", [LINES[0], Line("a tenth lost", ("--loss", "0.1"), None)], ids=lambda line: line.name
)
def test_a_large_library_arrives(line: Line) -> None:
    result = measure(line, images(2), 1)
    assert result.complete
    assert result.bytes > 400_000
    # Where frames get lost some are sent again; where none do, the host's own patience decides.
    assert result.sent > (1.05 if line.most_s is None else 0.99)


@pytest.mark.usefixtures("_terminal")
def test_a_tap_goes_over_the_line_into_a_file_and_agrees_with_its_prediction(
    library: Library, tmp_path: Path
) -> None:
    [condition] = end_to_end.recorded(library, [(0.3, 3.0)], end_to_end.IDEAL, 1, 0, tmp_path / "taps")
    assert condition.latency_rms_s < end_to_end.MOST_LATENCY_S
    assert condition.nrmse[0] < 0.01
    assert condition.taps[0].contact.speed_m_s == pytest.approx(0.3, rel=0.05)
