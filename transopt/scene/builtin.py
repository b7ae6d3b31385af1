"""The built-in scenes: their folder, their names, and loading one by name.

They are data of the package `problems`, which lies beside this package in a checkout and in site-packages. The folder
is located by that path and not by `import problems`, which would import a user's own `problems.py` if one lies beside
the user's script.
"""

from pathlib import Path
from typing import TYPE_CHECKING

from transopt.base.errors import InputError, did_you_mean
from transopt.base.files import is_file

if TYPE_CHECKING:
    from transopt.scene.scene import Scene

FOLDER = Path(__file__).parents[2] / "problems"
SCENES = FOLDER / "scenes"
POPULATION = FOLDER / "populations" / "stylus_grip.toml"


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
        if is_file(Path(f"{name}.toml")):
            raise InputError(f"{name}: no built-in scene of that name (did you mean {name}.toml?)")
        if is_file(Path(name)):
            words = f"`transopt show {name}` shows a library, `transopt taps {name} --scene mine.toml` begins a scene"
            raise InputError(f"{name}: no scene, which is a .toml file; {words}")
        raise InputError(
            f"{name}: no built-in scene of that name{did_you_mean(name, scene_names())}; choose one of "
            f"{', '.join(scene_names())}, or give the path of a .toml file"
        )
    return SCENES / f"{name}.toml"


def load_scene(scene: str | Path, *, model: str | Path | None = None, accept: bool = False) -> "Scene":
    """Load a scene by its built-in name, or by the path of a .toml file, which may name a built-in motor.

    Parameters
    ----------
    model : a model file that replaces the scene's own device. The grips of a built-in scene are replaced too, if the
        model was not identified at all of them.
    accept : whether to accept implausible numbers, as `implausible = "accept"` in the scene does.

    Raises
    ------
    InputError : no such scene, or an invalid one; one line with file, key, value and limit.
    """
    from transopt.scene.file import read_scene  # loads pydantic, which listing the names does not need

    path = Path(scene) if str(scene).lower().endswith(".toml") else scene_path(str(scene))
    file = None if model is None else Path(model)
    return read_scene(path, search=[FOLDER], model=file, model_grips=path.parent == SCENES, accept=accept)
