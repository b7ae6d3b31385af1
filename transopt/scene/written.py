"""Writes a scene as the text of a file; reading it back gives the same scene."""

from transopt.base.toml import toml_key, toml_value
from transopt.plant.matrices import Matrices
from transopt.scene.scene import Scene


def scene_text(scene: Scene) -> str:
    """The TOML text of a scene, one table after the other; keys without a value are left out.

    Motor, transmission and model are written as tables, even if they were read from files, so that the scene needs no
    other files than the recordings.
    """
    content = scene.model_dump(mode="json", exclude_none=True)
    if isinstance(scene.model, Matrices):
        del content["model"]["file"]  # the matrices are written out, and may be stated only once
    plain = {key: value for key, value in content.items() if not isinstance(value, dict)}
    # Keys of the scene come first: after a table's header they would belong to that table.
    blocks = ["\n".join(f"{key} = {toml_value(value)}" for key, value in plain.items() if value != [])]
    for key, value in content.items():
        if isinstance(value, dict) and value:
            blocks.append(
                "\n".join([f"[{key}]", *(f"{toml_key(name)} = {toml_value(each)}" for name, each in value.items())])
            )
    return "\n\n".join(block for block in blocks if block) + "\n"
