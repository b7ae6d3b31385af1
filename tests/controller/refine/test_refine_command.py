"""`transopt-play refine` from end to end: on a simulator, over the protocol, and where it must not."""

from pathlib import Path

import pytest

from controller.host.payload import payload
from controller.servo.interface import State
from controller.sim.sensors import SEED_SENSORS
from controller.sim.simulator import Imperfections, Simulator, true_device
from controller.sim.true_device import device_of
from tests.benches.commands import Run, assert_refused
from tests.benches.desk import DT_S, PORT, Desk
from tests.benches.libraries import part_of
from transopt.design.verify import verify_library
from transopt.library.file import load_library
from transopt.library.library import Library


def test_on_a_mismatched_simulator(play: Run, library: Library) -> None:
    part_of(library, [2], [1]).save(Path("library.npz"))
    arguments = ("--mismatch", 0.2, "--seed", 4, "--rounds", 1, "--taps", 3, "--out", "better")
    outcome = play("refine", "library.npz", "--simulate", *arguments)
    assert outcome.code == 0, outcome.out + outcome.err
    refined = load_library(Path("better/library.npz"))
    assert [check.shortfalls for check in verify_library(refined)] == [[]]
    told = refined.meta["refinement"]
    before, after = (one["playback_error"][0][0] for one in (told["rounds"][0], told["confirmed"]))
    assert before > 0.05
    assert after < 0.8 * before  # what is slow counts little in J, and is not learnt
    assert told["rounds"][1]["sure_factor"][0][0] < 1
    assert max(one["peak_current_A"][0][0] for one in told["rounds"]) <= 4 + 5 * SEED_SENSORS.current_noise_A
    assert "mismatch 0.2, seed 4" in told["source"]
    assert "1 of 1 node refined, confirmed by new taps" in outcome.out
    assert Path("better/refinement.png").exists()
    # What is played is what was refined.
    shown = play("tap", "better/library.npz", "--simulate", "--mismatch", 0.2, "--seed", 4)
    assert shown.code == 0


def test_on_a_device(play: Run, ready: Desk, library: Library) -> None:
    """The whole way over the protocol: the hand taps while the device is armed, three times a round."""
    one = part_of(library, [1], [1])
    one.save(Path("library.npz"))
    device = true_device(device_of(library.scene()), Imperfections(mismatch=0.2), 4)
    ready.plant = Simulator(device, ready.hand, DT_S, seed=4, steps=1)
    ready.ticks = 0
    given = payload(Path("library.npz"))
    ready.pass_check(given.configuration)
    next_s = 0.0

    def look() -> None:
        nonlocal next_s
        if ready.end.state is State.ARMED and ready.now_s() >= next_s:
            next_s = ready.now_s() + 1.2
            ready.hand.tap(ready.now_s() + 0.05, 0.2)

    ready.each_ms = look
    arguments = ("--rounds", 1, "--taps", 3, "--out", "better", "--for", 10)
    outcome = play("refine", "library.npz", *PORT, *arguments)
    assert outcome.code == 0, outcome.out + outcome.err
    assert "round 0: tap 3 times at each of 1 nodes: 0.2 m/s at 3 N x 3" in outcome.out
    assert "counts for 0.2 m/s at 3 N; missing: none" in outcome.out
    told = load_library(Path("better/library.npz")).meta["refinement"]
    before, after = (one["playback_error"][0][0] for one in (told["rounds"][0], told["confirmed"]))
    assert after < before / 2
    assert sorted(path.name for path in Path("better/round_1").glob("tap_*.csv")) == [
        "tap_001.csv",
        "tap_002.csv",
        "tap_003.csv",
    ]


def test_a_device_that_has_not_passed_its_check(play: Run, library: Library, monkeypatch: pytest.MonkeyPatch) -> None:
    Desk(library, simulated=False).put(monkeypatch)
    assert_refused(play("refine", "library.npz", *PORT, "--out", "x"), "no sound test pulse", "run `check`")


def test_never_over_the_library_itself(play: Run) -> None:
    outcome = play("refine", "library.npz", "--simulate", "--out", ".")
    assert_refused(outcome, "--out .: holds the library that is refined")
