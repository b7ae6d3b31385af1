"""No number of a scene is beyond what its unit can have, and no name leads out of the folder of the results."""

from typing import Any

import pytest
from pydantic import ValidationError

import problems
from transopt.base.errors import InputError
from transopt.base.units import LARGEST, LARGEST_PLAIN, beyond, largest, unit_of
from transopt.scene.builtin import scene_names
from transopt.scene.keys import keys, with_values
from transopt.scene.scene import Scene


def test_every_number_of_a_scene_has_an_upper_bound(scene: Scene) -> None:
    for key in keys(scene):
        assert not key.number or "<" in key.bounds or "one of" in key.bounds or key.unit == "", key.path


@pytest.mark.parametrize(
    ("path", "value", "words"),
    [
        ("limits.current_A", 1e6, "must be finite and at most 10000 A"),
        ("time.dt_s", 1e-9, "must be greater than or equal to 0.000001"),
        ("time.stages", 10**6, "must be less than or equal to 20000"),
        ("model.hand.arm_stiffness_N_m.per_newton", 1e20, "at most 1e+10 N/m"),
        ("model.hand.mass_kg.constant", -1e9, "at most 100000 kg in size"),
        ("recordings.simulated.repeats", 10**9, "less than or equal to 100"),
        ("amplifier.delay_s", 10.0, "less than or equal to 1"),
    ],
)
def test_beyond_it_the_line_says_so(scene: Scene, path: str, value: Any, words: str) -> None:
    with pytest.raises(InputError) as caught:
        with_values(scene, {path: value})
    assert words in str(caught.value)
    assert str(caught.value).isprintable()


def test_a_long_horizon_and_a_large_library(scene: Scene) -> None:
    with pytest.raises(InputError, match=r"20000 stages of 0\.001 s are 20 s: must be at most 10 s"):
        with_values(scene, {"time.stages": 20_000, "time.dt_s": 1e-3})
    speeds = [0.1 + 1e-3 * j for j in range(400)]
    with pytest.raises(InputError, match="24000000 commands, at most 2000000"):
        with_values(scene, {"grid.speeds_m_s": speeds, "time.stages": 20_000})


@pytest.mark.parametrize("name", ["../../x", "a/b", "a\\b", "..", "", " ", "a\nb", "\x1b[31m", "n" * 101])
def test_a_name_is_that_of_a_folder(scene: Scene, name: str) -> None:
    with pytest.raises(ValidationError, match="name"):
        Scene.model_validate({**scene.model_dump(), "name": name})


def test_words_may_have_lines_but_no_control_characters(scene: Scene) -> None:
    content = scene.model_dump()
    assert Scene.model_validate({**content, "description": "two\n\tlines, é"}).description == "two\n\tlines, é"
    with pytest.raises(ValidationError, match="control character"):
        Scene.model_validate({**content, "description": "\x1b]0;owned\x07"})


def test_units() -> None:
    assert largest(unit_of("a.hand.mass_kg.per_newton")) == LARGEST["kg"]
    assert largest(unit_of("weights.rho")) == LARGEST_PLAIN
    assert beyond("x_A", [1.0, {"a": [1e9]}])
    assert beyond("x_A", float("nan"))
    assert not beyond("x_A", [True, "1e9", None, -1e4])
    assert not beyond("A", [[1e6]]), "a matrix has no unit"


@pytest.mark.parametrize("name", scene_names())
def test_built_in_scenes_are_far_from_their_bounds(name: str) -> None:
    assert problems.load(name).name == name
