"""A scene as text is the same scene again."""

from pathlib import Path

import pytest

from transopt.scene.builtin import FOLDER, load_scene, scene_names, scene_path
from transopt.scene.file import read_scene
from transopt.scene.keys import with_values
from transopt.scene.written import edited, scene_text


@pytest.mark.parametrize("name", scene_names())
def test_every_scene_comes_back(name: str, tmp_path: Path) -> None:
    scene = load_scene(name)
    (tmp_path / f"{name}.toml").write_text(scene_text(scene), encoding="utf-8")
    assert read_scene(tmp_path / f"{name}.toml") == scene


def test_words_are_escaped(tmp_path: Path) -> None:
    said = 'a "quote", a \\ and a\ttab\nand é'
    scene = with_values(load_scene("lra_click"), {"description": said})
    (tmp_path / "scene.toml").write_text(scene_text(scene), encoding="utf-8")
    assert read_scene(tmp_path / "scene.toml").description == said


CHANGES = {"weights.rho": 2e-3, "thermal.headroom_K": None, "limits.stroke_m": 0.02, "robust.relative": None}


@pytest.mark.parametrize("name", [name for name in scene_names() if load_scene(name).model.kind != "arm"])
def test_an_edited_file_states_what_was_asked_for_and_keeps_its_comments(name: str, tmp_path: Path) -> None:
    text = scene_path(name).read_text(encoding="utf-8")
    found = edited(text, {**CHANGES, "name": name})
    (tmp_path / "other.toml").write_text(found, encoding="utf-8")
    scene = read_scene(tmp_path / "other.toml", search=[FOLDER])
    asked = {**CHANGES, "recordings.folder": scene.recordings.folder}
    del asked["robust.relative"]
    assert scene == with_values(load_scene(name), asked)
    kept = {line for line in found.splitlines() if line.startswith("#")}
    assert {line for line in text.splitlines() if line.startswith("#")} <= kept


def test_a_changed_line_says_what_stood_there() -> None:
    text = '# a\n[limits]\nbeta = 3.2  # wide\nwords = "a # b"\nmany = [1,\n  2]  # two\n\n[grid]\nspeeds = [1.0]\n'
    found = edited(text, {"limits.beta": 2.0, "limits.words": "c", "limits.many": [3], "grid.speeds": None, "x.y": 1})
    assert 'beta = 2.0  # wide (was 3.2)\nwords = "c"  # (was "a # b")\nmany = [3]' in found
    assert "# speeds = [1.0]" in found
    assert found.endswith("[x]\ny = 1\n")


def test_a_table_takes_the_place_of_another_with_all_that_is_in_it() -> None:
    text = "[a]\nx = 1\n# said\n[a.b]\ny = 2\n[c]\nz = 3\n"
    assert edited(text, {"a": {"w": "v"}}) == '[a]\nw = "v"\n# said\n[c]\nz = 3\n'
    assert edited(text, {"d": {"w": 1.0}}) == f"{text}\n[d]\nw = 1.0\n"


@pytest.mark.parametrize("text", ["", "limits = { beta = 3.2 }\n", "limits.beta = 3.2\n", "no text"])
def test_what_is_not_stated_line_by_line_is_not_edited(text: str) -> None:
    assert edited(text, {"limits.beta": 2.0}) is None
