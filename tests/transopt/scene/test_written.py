"""A scene as text is the same scene again."""

from pathlib import Path

import pytest

from transopt.scene.builtin import load_scene, scene_names
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
