"""What comes with the package to be solved: scenes, motors, transmissions, recordings, and the stress suite.

`transopt` does not need any of it. A scene is loaded by its name; `generators` makes simulated recordings, and
`stress` draws problems far from everyday ones.
"""

from pathlib import Path
from typing import TYPE_CHECKING

from transopt.base.errors import InputError

if TYPE_CHECKING:
    from transopt.scene.scene import Scene

FOLDER = Path(__file__).parent
SCENES = FOLDER / "scenes"


def scene_names() -> list[str]:
    """Names of the built-in scenes, sorted."""
    return sorted(path.stem for path in SCENES.glob("*.toml"))


def scene_path(name: str) -> Path:
    """File of a built-in scene.

    Raises
    ------
    InputError : no scene of that name.
    """
    if name not in scene_names():
        raise InputError(
            f"{name}: no built-in scene of that name; choose one of {', '.join(scene_names())}, "
            "or give the path of a .toml file"
        )
    return SCENES / f"{name}.toml"


def load(scene: str | Path) -> "Scene":
    """A scene by its built-in name, or by the path of a .toml file, whose motor may be a built-in one.

    Raises
    ------
    InputError : there is none, or it cannot be used.
    """
    from transopt.scene.file import load_scene

    path = Path(scene) if str(scene).lower().endswith(".toml") else scene_path(str(scene))
    return load_scene(path, search=[FOLDER])
