"""The scene that a library carries in its `meta`."""

from typing import Any

from pydantic import ValidationError

from transopt.base.errors import InputError
from transopt.scene.file import explain
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
        raise InputError(f"{explain('meta.scene', error, meta['scene'])}; solve the scene again") from None
