"""A scene as text is the same scene again."""

from pathlib import Path

import pytest

from transopt.base.toml_edit import edited
from transopt.scene.builtin import FOLDER, load_scene, scene_names, scene_path
from transopt.scene.file import read_scene
from transopt.scene.keys import with_values
from transopt.scene.written import scene_text


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
