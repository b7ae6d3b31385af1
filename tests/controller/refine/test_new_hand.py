"""A new user's hand from taps on the simulated device: which are asked for, and what they lead to."""

import itertools
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import transopt as to
from controller.cli.port import connected
from controller.cli.refine_taps import Taps, simulated_at
from controller.device.device_file import BUILT_IN, DeviceFile
from controller.host.payload import payload
from controller.record.recorder import Contact
from controller.refine.heard import Node
from controller.refine.new_hand import (
    Tried,
    calibrated,
    drive_of,
    judged,
    nodes_to_tap,
    record_of,
    save_model,
)
from controller.servo.interface import State
from controller.servo.settings import Settings
from controller.sim.simulator import Imperfections, Simulator
from controller.sim.true_device import device_of
from tests.benches.commands import Run, assert_refused
from tests.benches.desk import DT_S, PORT, Desk
from tests.benches.libraries import part_of, under
from transopt.base.errors import InputError
from transopt.design.another_model import built_on
from transopt.design.verify import verify_library
from transopt.identify.calibration import PlayedRecord
from transopt.library.file import load_library
from transopt.library.library import Library
from transopt.library.recorded import references_of_library
from transopt.scene.builtin import POPULATION, load_scene
from transopt.scene.keys import with_values
from transopt.scene.model_file import load_model
from transopt.scene.population import load_population
from transopt.scene.scene import Scene

SEED = 44  # of a hand that nothing was tuned on


@pytest.fixture(scope="module")
def small(library: Library) -> Library:
    """0.2 m/s, which no limit binds, at three grips."""
    return under(part_of(library, [1], [0, 1, 2]), {"grid.speeds_m_s": [0.2]})


@pytest.fixture(scope="module")
def truth(scene: Scene) -> Scene:
    """The default device in a hand of the population."""
    return scene.in_hand(load_population(POPULATION).drawn(1, SEED, scene.grid.grips_N)[0])


@pytest.fixture(scope="module")
def tapped(small: Library, truth: Scene) -> tuple[list[Contact], Settings]:
    """Three taps of that hand."""
    bench, hand = simulated_at(small, device_of(truth), Imperfections(), SEED, BUILT_IN)
    nodes, taps = nodes_to_tap(small, BUILT_IN)
    with connected(bench.port, None) as device, hand:
        contacts, settings = Taps(device, bench, hand, BUILT_IN, Path(), taps, None).contacts(small, 0, nodes)
    return list(contacts), settings


def test_the_outermost_grips_and_the_middle_one_are_tapped(library: Library) -> None:
    assert nodes_to_tap(library, BUILT_IN) == ([(1, 0), (1, 1), (1, 2)], 1)
    deaf = DeviceFile.model_validate({"grip": {"sensor": False, "assumed_grip_N": 4.6}})
    assert nodes_to_tap(library, deaf) == ([(0, 2), (2, 2), (3, 2)], 1)
    assert nodes_to_tap(part_of(library, [1], [1]), BUILT_IN) == ([(0, 0)], 3)
    assert nodes_to_tap(part_of(library, [0, 1], [0, 2]), BUILT_IN) == ([(0, 0), (0, 1)], 2)


def test_three_taps_come_near_to_who_knows_the_hand(
    tmp_path: Path, small: Library, truth: Scene, tapped: tuple[list[Contact], Settings]
) -> None:
    """Played by other equations: tests/scripts/test_changing_users.py."""
    found, complaints = calibrated(*tapped, small, load_population(POPULATION), BUILT_IN.accelerometer, [])
    assert not complaints
    model = tmp_path / "model.json"
    save_model(model, small.scene(), found.device)
    ours, as_recorded = (built_on(small, model, as_recorded=kept).library for kept in (False, True))
    known_file = tmp_path / "known.json"
    known_hand = {name: vars(truth.model.hand.line(name)) for name in type(truth.model.hand).model_fields}
    true_device = drive_of(small.scene()).model_dump() | {"hand": known_hand}
    save_model(known_file, small.scene(), type(found.device).model_validate(true_device))
    knows = built_on(small, known_file, as_recorded=True).library
    # For the same target the two designs are the same but for what three taps leave open.
    assert as_recorded.command == pytest.approx(knows.command, abs=0.05 * np.abs(knows.command).max())
    # A certified library like any other, with the recordings' sources and the new model's.
    ours.save(tmp_path / "library.npz")
    again = load_library(tmp_path / "library.npz")
    assert not any(check.shortfalls for check in verify_library(again))
    origins = [source["origin"] for source in again.meta["sources"]]
    assert origins.count("model file") == 1
    carried = [source for source in again.meta["sources"] if "in_hand" in source]
    assert len(carried) == len([source for source in small.meta["sources"] if "grid_speed_m_s" in source])
    assert references_of_library(again).speeds_m_s == (0.2,)


def test_a_library_for_a_population_becomes_one_for_what_the_taps_leave_open(
    tmp_path: Path, scene: Scene, small: Library, tapped: tuple[list[Contact], Settings]
) -> None:
    population = load_population(POPULATION)
    robust = {"population": population.model_dump(), "samples": 2}
    nodes = {"grid.speeds_m_s": [0.2], "grid.grips_N": [3.0]}
    library = to.solve(with_values(scene, {"robust": robust, **nodes}))
    assert library.spread_A.shape[:2] == (1, 2)
    found, _ = calibrated(*tapped, small, population, BUILT_IN.accelerometer, [])
    save_model(tmp_path / "model.json", library.scene(), found.device)
    made = built_on(library, tmp_path / "model.json").library
    stated = made.scene().robust
    assert (stated.population, stated.model_uncertainty) == (None, True)
    # The devices that it serves lie around the hand, nearer than those of the population lie around theirs.
    wide, near = (np.abs(each.spread_A - each.plant_A[:, None]).max() for each in (library, made))
    assert 0 < near < 0.5 * wide


def test_what_is_no_whole_tap_does_not_count(small: Library, tapped: tuple[list[Contact], Settings]) -> None:
    [first, *_], settings = tapped
    assert isinstance(record_of(first, small, settings, BUILT_IN.accelerometer), PlayedRecord)
    for wrong, words in (
        ({"missed": 3}, "3 records were lost"),
        ({"command_A": 0 * first.command_A}, "nothing was played"),
        ({"acceleration_m_s2": 0 * first.acceleration_m_s2}, "the accelerometer reads nothing"),
        ({"tick": int(first.ticks[-1])}, "not all of it was recorded"),
    ):
        said = record_of(replace(first, **wrong), small, settings, BUILT_IN.accelerometer)
        assert isinstance(said, str)
        assert said.startswith(words)


@pytest.mark.parametrize(
    ("before", "after", "words", "good"),
    [
        ((0.30, 0.10), (0.20, 0.03), "better than the library that was played: tap error 30.0 -> 20.0 %", True),
        ((0.20, 0.04), (0.199, 0.04), "no better than the library that was played", True),
        ((0.20, 0.04), (0.23, 0.04), "worse than the library that was played", False),
        ((0.20, 0.09), (0.215, 0.03), "better", True),  # tap error for three times as much of felt error
        ((np.nan, np.nan), (0.2, 0.03), "no node was played with both libraries", False),
    ],
)
def test_the_verdict(before: tuple[float, float], after: tuple[float, float], words: str, good: bool) -> None:
    node: Node = (0, 0)
    said, may_be_taken = judged([Tried(node, before, after)])
    assert said.startswith(words)
    assert may_be_taken is good


class TestCommand:
    @pytest.fixture
    def file(self, small: Library, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
        monkeypatch.chdir(tmp_path)
        small.save(tmp_path / "small.npz")
        return tmp_path / "small.npz"

    def test_from_taps_to_a_library(self, play: Run, file: Path) -> None:
        outcome = play("calibrate", file, "--simulate", "--user", 5, "--out", "hand")
        assert (outcome.code, outcome.err) == (0, "")
        for words in ("the hand by 3 taps", "skin_stiffness_N_m", "better than the library that was played"):
            assert words in outcome.out
        device = load_model(Path("hand/model.json")).device
        assert "on a drive that is taken as known" in device.verdict
        assert device.sources[0].file == "small.npz"
        made = load_library(Path("hand/library.npz"))
        assert made.scene().striker is None
        assert "refinement" not in made.meta or made.meta["refinement"] is None

    def test_on_a_device(self, play: Run, ready: Desk, file: Path, truth: Scene) -> None:
        """The whole way over the protocol: the hand taps at the three grips in turn while the device is armed."""
        ready.plant = Simulator(device_of(truth), ready.hand, DT_S, seed=4, steps=1)
        ready.ticks = 0
        ready.pass_check(payload(file).configuration)
        next_s, grips = 0.0, itertools.cycle((1.0, 3.0, 5.0))

        def look() -> None:
            nonlocal next_s
            if ready.end.state is State.ARMED and ready.now_s() >= next_s:
                next_s = ready.now_s() + 1.2
                ready.hand.held_N = next(grips)
                ready.hand.tap(ready.now_s() + 0.05, 0.2)

        ready.each_ms = look
        outcome = play("calibrate", file, *PORT, "--out", "hand", "--for", 10)
        assert outcome.code == 0, outcome.out + outcome.err
        assert "round 0: tap 1 times at each of 3 nodes" in outcome.out
        assert "better than the library that was played" in outcome.out
        assert Path("hand/round_1/tap_003.csv").exists()

    def test_what_cannot_be_calibrated_is_refused_before_a_tap(self, play: Run, file: Path, tmp_path: Path) -> None:
        with_port = ("calibrate", file, "--simulate", "--out")
        assert_refused(play("calibrate", file, "--out", "hand"), "name one device")
        assert_refused(play(*with_port, "hand", "--user", 21), "--user 21: must be 0 to 20")
        assert_refused(play(*with_port, "hand", "--population", "none.toml"), "none.toml")
        file.rename(tmp_path / "library.npz")
        again = ("calibrate", tmp_path / "library.npz", "--simulate", "--out", tmp_path)
        assert_refused(play(*again), "holds the library that is played; choose another folder")
        (tmp_path / "deaf.toml").write_text('name = "deaf"\n\n[accelerometer]\nsensor = false\n')
        assert_refused(play(*again[:-1], "hand", "--device", "deaf.toml"), "accelerometer.sensor = false")
        assert not Path("hand").exists()

    @pytest.mark.parametrize(
        ("name", "words"), [("second_order", "kind = second_order"), ("free_stylus", "which nobody holds")]
    )
    def test_a_device_that_is_no_drive_in_a_hand_is_refused(self, name: str, words: str) -> None:
        with pytest.raises(InputError, match=words):
            drive_of(load_scene(name))
