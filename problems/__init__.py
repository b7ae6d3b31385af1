"""Built-in scenes, motors, and the generators of simulated recordings."""

from transopt.scene.builtin import FOLDER, scene_names, scene_path
from transopt.scene.builtin import load_scene as load

__all__ = ["FOLDER", "load", "scene_names", "scene_path"]
