"""Unplugs, resets, kills and hangs at random instants of a session with the compiled device.

    python -m pytest -m long -n 0 tests/campaigns/test_unplug_campaign.py
        --campaign="[--cases 1000] [--processes 12] [--seed 0]"

In virtual time (`unplug_cases`), and with real processes, killed by SIGKILL, on pseudo-terminals and sockets
(`unplug_processes`). Of each case is asked: the command is zero within the lease after the last heartbeat that
arrived, by the device's own ticks; the host says so within 1 s (where it was still connecting, and nothing but
silence tells it, at the end of the time it connects for); nothing hangs; nothing arms again by itself, also not after
connecting again; each line of the recording is what the device did in that tick. It fails if anything is off.
"""

import sys
import tempfile
import time
from collections import Counter, defaultdict
from collections.abc import Iterable
from pathlib import Path
from typing import Annotated

import numpy as np
import pytest

from controller.record.telemetry import CSV_NAME, Telemetry
from controller.servo.interface import Output, Readings, State
from tests.campaigns.harness import Seed, at_least, long_form
from tests.campaigns.unplug_cases import IMAGE, KINDS, PHASES, Case, Judged, Outcome
from tests.campaigns.unplug_processes import KINDS as PROCESS_KINDS
from tests.campaigns.unplug_processes import Ended, play


def virtual(cases: int, seed: int, folder: Path) -> list[Outcome]:
    """So many cases, each of its own seed."""
    return [Case(1_000_000 * seed + j, folder / f"virtual{j}").play() for j in range(cases)]


def real(cases: int, seed: int, folder: Path) -> list[Ended]:
    """So many with real processes: every kind in turn, every third round on a socket.

    Raises
    ------
    InputError : no compiler, no pseudo-terminal, no host.
    """
    kinds = len(PROCESS_KINDS)
    return [
        play(1_000_000 * seed + j, folder / f"real{j}", listen=j // kinds % 3 == 2, kind=PROCESS_KINDS[j % kinds])
        for j in range(cases)
    ]


def worst(values: Iterable[float]) -> str:
    """The largest of those that are numbers."""
    known = [value for value in values if not np.isnan(value)]
    return f"{np.max(known):8.3f}" if known else "       -"


def summarise(outcomes: list[Outcome] | list[Ended], phases: Iterable[str]) -> None:
    """Counts by kind and phase, and the worst times."""
    kinds: dict[str, list[Outcome | Ended]] = defaultdict(list)
    for outcome in outcomes:
        kinds[outcome.kind].append(outcome)
    phases = tuple(phases)
    print(f"{'':14s}{''.join(f'{phase:>14s}' for phase in phases)}   report s  connecting s  held/lease  lines kept")
    for kind, those in kinds.items():
        counts = Counter(outcome.phase for outcome in those)
        told = worst(o.report_s for o in those if o.phase != "connect")
        connecting = worst(o.report_s for o in those if o.phase == "connect")
        held = max(o.held_ms / o.lease_ms for o in those)
        print(
            f"{kind:14s}{''.join(f'{counts[phase]:14d}' for phase in phases)} {told:>10s} {connecting:>13s} "
            f"{held:11.4f} {sum(o.rows for o in those):11d}"
        )


def main(
    cases: Annotated[int, at_least(0, "in virtual time")] = 1000,
    processes: Annotated[int, at_least(0, "with real processes")] = 12,
    seed: Seed = 0,
) -> int:
    with tempfile.TemporaryDirectory(prefix="transopt-") as folder:
        began_s = time.monotonic()
        played = virtual(cases, seed, Path(folder))
        print(f"{cases} cases in virtual time, {time.monotonic() - began_s:.0f} s")
        summarise(played, PHASES)
        missing = sorted(set(KINDS) - {case.kind for case in played})
        if cases and missing:
            print(f"kinds that did not come: {', '.join(missing)}")
        sys.stdout.flush()
        began_s = time.monotonic()
        ended = real(processes, seed, Path(folder))
        print(f"{processes} cases with real processes, {time.monotonic() - began_s:.0f} s")
        summarise(ended, dict.fromkeys(case.phase for case in ended))
    named = {"case": played, "processes": ended}
    breaches = [
        f"{name} {j}, {outcome.phase}, {outcome.kind}: {words}"
        for name, outcomes in named.items()
        for j, outcome in enumerate(outcomes)
        for words in outcome.breaches
    ]
    for words in breaches[:20]:
        print(f"  BREACH {words}"[:300])
    print(f"{len(breaches)} breaches")
    return 1 if breaches else 0


test_long_form = long_form(main)


pytestmark = pytest.mark.usefixtures("c_compiler")

CASES = 12


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


@pytest.mark.usefixtures("pseudo_terminal")
def test_a_host_is_killed(tmp_path: Path) -> None:
    ended = play(4, tmp_path / "real", kind="host killed")
    assert ended.breaches == []
    assert ended.phase == "armed"
    assert ended.held_ms > 0.9 * ended.lease_ms
    assert (tmp_path / "real" / CSV_NAME).exists()
