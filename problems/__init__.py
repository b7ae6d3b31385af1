"""Problems that come with the package: scenes, motors, transmissions, recordings, and the stress suite.

`transopt` does not depend on them. Scenes are loaded by name, `generators` simulates recordings, and `stress` draws
extreme problems.
"""

from transopt.scene.builtin import FOLDER, scene_names, scene_path
from transopt.scene.builtin import load_scene as load

__all__ = ["FOLDER", "load", "scene_names", "scene_path"]
