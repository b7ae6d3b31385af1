"""What comes with the package to be solved: scenes, motors, transmissions, recordings, and the stress suite.

`transopt` does not need any of it. A scene is loaded by its name; `generators` makes simulated recordings, and
`stress` draws problems far from everyday ones.
"""

from transopt.scene.builtin import FOLDER, scene_names, scene_path
from transopt.scene.builtin import load_scene as load

__all__ = ["FOLDER", "load", "scene_names", "scene_path"]
