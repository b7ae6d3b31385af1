"""Built-in scenes, motors, and the generators of simulated recordings."""

from pathlib import Path

from transopt.errors import InputError

FOLDER = Path(__file__).parent


def scene_names() -> list[str]:
    """Names of the built-in scenes, sorted."""
    return sorted(path.stem for path in FOLDER.glob("*.toml"))


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
    return FOLDER / f"{name}.toml"
