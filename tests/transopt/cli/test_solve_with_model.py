"""From a model file to a library in one command, and what a model file does not change in a scene."""

import json
from pathlib import Path

import numpy as np
import pytest

from tests.benches.commands import Run, assert_refused
from tests.benches.model_parts import POLE, WOOD, amplifier_part, drive_device, hand_part, state_space_device
from transopt.cli.identified import next_step
from transopt.library.file import load_library
from transopt.scene.builtin import load_scene
from transopt.scene.model_file import save_part
from transopt.scene.recordings import recordings_of

MODEL = Path("MODEL.json")


def heavier(factor: float = 1.1) -> None:
    """Another device than the scene's own, with another amplifier, into MODEL.json."""
    known = drive_device()
    save_part(MODEL, "device", known.model_copy(update={"moving_mass_kg": factor * known.moving_mass_kg}))
    save_part(MODEL, "amplifier", amplifier_part(900.0, 250e-6))


def quick(path: str, line: str = "") -> Path:
    text = WOOD.replace("[0.1, 0.2, 0.3, 0.4]", "[0.2]").replace("[1.0, 3.0, 5.0]", "[3.0]")
    Path(path).write_text(line + text)
    return Path(path)


class TestOneCommand:
    def test_solve_takes_device_and_amplifier_from_the_file(self, run: Run) -> None:
        heavier()
        outcome = run("solve", quick("mine.toml"), "--model", MODEL, "--no-figures")
        assert outcome.code == 0, outcome.err
        library = load_library(Path("out/mine/library.npz"))
        assert library.amplifier().pole_Hz == 900.0
        assert {source["origin"] for source in library.meta["sources"]} >= {"model file"}

    def test_an_amplifier_that_is_the_scenes_is_said_to_be_uncounted(self, run: Run) -> None:
        save_part(MODEL, "device", drive_device())
        words = ("solve", quick("mine.toml"), "--model", MODEL, "--no-figures")
        assert "; not counted: the amplifier, which is the scene's and not identified" in run(*words).out
        save_part(MODEL, "amplifier", amplifier_part(900.0, 250e-6))
        assert "not counted" not in run(*words).out

    def test_the_printed_line_works_where_all_else_stays(self, run: Run) -> None:
        heavier()
        line = next_step(MODEL).splitlines()[-1]
        by_line = load_scene(quick("pasted.toml", f"{line}\n"))
        by_option = load_scene(quick("plain.toml"), model=MODEL)
        assert by_line.model == by_option.model
        assert by_line.amplifier_model() == by_option.amplifier_model()
        assert run("solve", "pasted.toml", "--no-figures").code == 0

    def test_a_scene_of_a_users_own_in_another_folder(self, run: Run) -> None:
        heavier()
        Path("sub").mkdir()
        assert run("scene", "new", "sub/mine.toml", "--model", MODEL).code == 0
        assert Path("sub/mine.toml").read_text().startswith('model_file = "../MODEL.json"\n')
        scene = load_scene("sub/mine.toml")
        assert scene.model == load_scene("wood_on_foam", model=str(MODEL)).model.model_copy(
            update={"file": "../MODEL.json"}
        )

    def test_a_built_in_scene_takes_the_grips_of_the_file(self, run: Run) -> None:
        save_part(MODEL, "device", drive_device(grips_N=[0.0, 2.00001, 3.99998]))
        outcome = run("solve", "--model", MODEL, "--no-figures")
        assert outcome.code == 0, outcome.err
        assert "grips 2, 4 N: those of MODEL.json" in outcome.out
        assert load_library(Path("out/wood_on_foam/library.npz")).grips_N.tolist() == [2.0, 4.0]
        assert run("scene", "new", "mine.toml", "--model", MODEL).code == 0
        assert load_scene("mine.toml").grid.grips_N == [2.0, 4.0]
        Path("stated.toml").write_text(WOOD)
        assert_refused(run("solve", "stated.toml", "--model", MODEL), "grid.grips_N: 1 N", "2 to 4 N")

    def test_what_cannot_be_used_leaves_no_scene_behind(self, run: Run) -> None:
        assert_refused(run("scene", "new", "mine.toml", "--model", "none.json"), "none.json", "no such file")
        assert_refused(run("solve", "--model", "none.json"), "none.json", "no such file")
        assert not Path("mine.toml").exists()


class TestTheTargetStays:
    @pytest.mark.parametrize("part", [drive_device(), state_space_device()])
    def test_simulated_taps_are_those_of_the_scenes_own_device(self, run: Run, part: object) -> None:
        save_part(MODEL, "device", part)  # type: ignore[arg-type]
        heavier() if part == drive_device() else save_part(MODEL, "amplifier", amplifier_part(900.0, 250e-6))
        own, other = recordings_of(load_scene("wood_on_foam")), recordings_of(load_scene("wood_on_foam", model=MODEL))
        assert len(own) == len(other)
        for a, b in zip(own, other, strict=True):
            np.testing.assert_array_equal(a.acceleration.values, b.acceleration.values)

    def test_also_where_the_scene_leaves_pole_and_delay_to_the_file(self, run: Run) -> None:
        heavier()
        Path("bare.toml").write_text(WOOD.replace(POLE, ""))
        short = recordings_of(load_scene("bare.toml", model=MODEL))
        save_part(MODEL, "amplifier", amplifier_part(900.0, 800e-6))
        for a, b in zip(short, recordings_of(load_scene("bare.toml", model=MODEL)), strict=True):
            np.testing.assert_array_equal(a.acceleration.values, b.acceleration.values)

    def test_a_scene_without_a_device_of_its_own_is_told_that_its_taps_move(self, run: Run) -> None:
        heavier()
        bare = WOOD.replace(WOOD[WOOD.index("[model]") : WOOD.index("[amplifier]")], "").replace(POLE, "")
        bare = bare.replace("[0.1, 0.2, 0.3, 0.4]", "[0.2]").replace("[1.0, 3.0, 5.0]", "[3.0]")
        Path("bare.toml").write_text(f'model = "MODEL.json"\n{bare}')
        said = "simulated taps are struck by the device of MODEL.json and change with it"
        assert said in run("solve", "bare.toml", "--no-figures").out
        assert said not in run("solve", quick("mine.toml"), "--model", MODEL, "--no-figures").out


class TestNotFit:
    @pytest.fixture
    def unfit(self, run: Run) -> None:
        poor = drive_device().model_copy(update={"shortfalls": ["3 N: held-out NRMSE 30 %, limit 5 %"]})
        save_part(MODEL, "device", poor)

    @pytest.mark.usefixtures("unfit")
    def test_ends_solve(self, run: Run) -> None:
        scene = quick("mine.toml")
        outcome = run("solve", scene, "--model", MODEL)
        assert_refused(outcome, "MODEL.json is not fit to design with: device: 3 N: held-out", "--accept-unfit-model")
        assert not Path("out/mine/library.npz").exists()

    @pytest.mark.usefixtures("unfit")
    def test_but_for_who_accepts_it_and_stands_in_the_last_lines(self, run: Run) -> None:
        outcome = run("solve", quick("mine.toml"), "--model", MODEL, "--no-figures", "--accept-unfit-model")
        assert outcome.code == 0, outcome.err
        assert any("not fit to design with" in line for line in outcome.out.splitlines()[-5:])
        assert "not fit to design with" in Path("out/mine/report.md").read_text()

    def test_a_part_that_the_design_does_not_take_does_not_matter(self, run: Run) -> None:
        save_part(MODEL, "device", drive_device())
        save_part(MODEL, "hand", hand_part().model_copy(update={"shortfalls": ["too few taps"]}))
        assert run("solve", quick("mine.toml"), "--model", MODEL, "--no-figures").code == 0


def test_two_lines_that_name_a_file_and_one_that_is_no_path(run: Run) -> None:
    heavier()
    bare = WOOD.replace(WOOD[WOOD.index("[model]") : WOOD.index("[amplifier]")], "")
    Path("two.toml").write_text(f'model = "MODEL.json"\nmodel_file = "MODEL.json"\n{bare}')
    assert_refused(run("solve", "two.toml"), "model and model_file both name a model file")
    assert_refused(run("solve", quick("odd.toml", "model_file = 3\n")), "model_file = 3", "must be the path")
    clash = quick("clash.toml", 'model = "MODEL.json"\n')
    assert_refused(run("solve", clash), "write model_file = ... in that line")
    clash.write_text(clash.read_text().replace("model =", "model_file =", 1))
    assert load_scene(clash).model.kind == "identified"
    assert json.loads(MODEL.read_text())["device"]["kind"] == "drive"
