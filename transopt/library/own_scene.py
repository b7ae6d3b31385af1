"""The scene that a library carries in its `meta`."""

from typing import Any

from pydantic import ValidationError

from transopt.base.errors import InputError
from transopt.scene.scene import Scene


def scene_in(meta: dict[str, Any]) -> Scene:
    """The scene of a library's `meta`.

    Raises
    ------
    InputError : a scene of another version, or changed by hand.
    """
    try:
        return Scene.model_validate(meta["scene"])
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join(str(part) for part in first["loc"])
        message = first["msg"].removeprefix("Value error, ")
        where = f"meta.scene: {key}" if key else "meta.scene"
        raise InputError(f"{where}: {message}; solve the scene again") from None
