"""A scene as the text of its file: what is read back from it is the same scene."""

import json
import math
from typing import Any

from transopt.plant.matrices import Matrices
from transopt.scene.scene import Scene


def scene_text(scene: Scene) -> str:
    """The TOML file of a scene, one table after the other; what is not stated is left out.

    Motor, transmission and model stand in it as tables, wherever they were read from, so that the file needs no other
    but the recordings.
    """
    content = scene.model_dump(mode="json", exclude_none=True)
    if isinstance(scene.model, Matrices):
        del content["model"]["file"]  # the matrices stand here, and in one place only
    plain = {key: value for key, value in content.items() if not isinstance(value, dict)}
    # A line that would come after a table would belong to it.
    blocks = ["\n".join(f"{key} = {_value(value)}" for key, value in plain.items() if value != [])]
    for key, value in content.items():
        if isinstance(value, dict) and value:
            blocks.append(
                "\n".join([f"[{key}]", *(f"{_key(name)} = {_value(each)}" for name, each in value.items())])
            )
    return "\n\n".join(block for block in blocks if block) + "\n"


def _key(name: str) -> str:
    """A key as it stands before the equals sign; quoted where it is more than letters, digits and dashes."""
    bare = name.isascii() and name.replace("_", "").replace("-", "").isalnum()
    return name if bare else _text(name)


def _text(text: str) -> str:
    """A basic string; TOML and JSON escape alike, but TOML also the delete character."""
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")


def _value(value: Any) -> str:
    """A value on one line, tables within tables as inline ones."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return _text(value)
    if isinstance(value, float):
        if not math.isfinite(value):
            return "nan" if math.isnan(value) else "inf" if value > 0 else "-inf"
        text = repr(value)
        return text if "." in text or "e" in text else f"{text}.0"
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{_key(name)} = {_value(each)}" for name, each in value.items()) + " }"
    if isinstance(value, list):
        return "[" + ", ".join(map(_value, value)) + "]"
    return str(value)
