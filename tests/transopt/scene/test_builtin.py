"""The built-in scenes: found by their place, one truth for all who ask."""

from pathlib import Path

import pytest

import problems
from transopt.base.errors import InputError
from transopt.scene import builtin
from transopt.scene.recordings import recordings_of
from transopt.scene.scene import Scene


def test_the_folder_is_that_of_the_package_problems() -> None:
    assert Path(problems.__file__).parent == builtin.FOLDER
    assert builtin.scene_names() == sorted(path.stem for path in (builtin.FOLDER / "scenes").glob("*.toml"))
    assert "wood_on_foam" in builtin.scene_names()


def test_a_path_is_read_and_finds_built_in_motors(tmp_path: Path) -> None:
    file = tmp_path / "mine.TOML"
    file.write_text(builtin.scene_path("wood_on_foam").read_text(encoding="utf-8"), encoding="utf-8")
    assert builtin.load_scene(str(file)).motor == builtin.load_scene("wood_on_foam").motor
    assert builtin.load_scene(file).name == "mine"


def test_an_unknown_name_is_refused_with_the_known_ones() -> None:
    with pytest.raises(
        InputError,
        match=r"^wood: no built-in scene of that name \(did you mean wood_on_foam\?\); .*wood_on_foam, or give",
    ):
        builtin.load_scene("wood")


def test_recordings_are_read_or_simulated_as_the_scene_says(scene: Scene) -> None:
    assert recordings_of(scene)[0].name == "wood_on_foam_0.1_m_s_1_N_1"
    own = builtin.load_scene("own_taps")
    assert own.recordings.simulated is None
    assert all(tap.source.endswith(".csv") for tap in recordings_of(own))
