"""The place of a model file in a scene: what the file replaces, what stays, and which grips it serves."""

import hashlib
import json
import os
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from transopt.base.errors import InputError
from transopt.scene.model_file import parse_model, read_model
from transopt.scene.model_parts import MODEL_PARTS, check_grip

_GRIPS_LINE = re.compile(r"^grips_N *= *\[[^]]*\]", re.MULTILINE)
OF_THE_FILE = ("pole_Hz", "delay_s")  # of the amplifier, where the file has that part


def identified_table(path: Path, shown: str) -> dict[str, Any]:
    """The table that stands for a model file: all that it holds, so that a library does not need the file.

    Parameters
    ----------
    shown : what reports call the file.

    Raises
    ------
    InputError : no such file, or no model file.
    """
    raw = read_model(path)
    found = parse_model(path, raw).model_dump(include=set(MODEL_PARTS), exclude_none=True)
    return {"kind": "identified", "file": shown, "sha256": hashlib.sha256(raw).hexdigest(), **found}


def put_model(content: dict[str, Any], identified: dict[str, Any]) -> None:
    """Put a model file in the place of a scene's own device.

    What the scene states of the device, its [model], [tip], pole and delay, goes into the table `striker` if the
    recordings are simulated: the taps that shall be reproduced are made with it, whatever the design's model is.

    Parameters
    ----------
    content : tables of the scene, as its file states them; changed.
    identified : see `identified_table`.
    """
    own, amplifier, recordings = content.get("model"), content.get("amplifier"), content.get("recordings")
    simulated = isinstance(recordings, dict) and recordings.get("simulated") is not None
    if isinstance(own, dict) and own.get("kind") != "identified" and simulated:
        # Only the delay matters to a tap that nobody drives, and it only to how long the recording is.
        whole = isinstance(amplifier, dict) and all(amplifier.get(name) is not None for name in OF_THE_FILE)
        striker = {"model": own, "tip": content.get("tip"), "amplifier": amplifier if whole else "ideal"}
        content["striker"] = {name: table for name, table in striker.items() if table is not None}
    content["model"] = identified
    if "device" in identified:
        content.pop("tip", None)
    if "amplifier" in identified and isinstance(amplifier, dict):
        content["amplifier"] = {key: value for key, value in amplifier.items() if key not in OF_THE_FILE}


def served_grips(identified: dict[str, Any], grips_N: Sequence[float]) -> list[float]:
    """The grips if a model knows them all, else those that it was identified at (the free one apart).

    Parameters
    ----------
    identified : see `identified_table`.
    """
    moving = identified.get("device") or identified.get("hand")
    if moving is None:
        return list(grips_N)
    known: list[float] = moving["grips_N"]
    try:
        for grip_N in grips_N:
            check_grip(known, grip_N)
    except InputError:
        return [grip_N for grip_N in known if grip_N > 0] or known
    return list(grips_N)


def model_line(model: Path, folder: Path) -> str:
    """The line by which a scene file in a folder names a model file; it stands above the scene's first table."""
    named = model if model.is_absolute() else Path(os.path.relpath(model, folder))
    return f"model_file = {json.dumps(named.as_posix())}"  # JSON and TOML spell a string alike


def on_model(text: str, model: Path, folder: Path, grips_N: Sequence[float]) -> str:
    """The text of a scene file in a folder, with a model file in the place of its device and the grid's grips."""
    held = _GRIPS_LINE.sub(f"grips_N = {list(grips_N)}", text, count=1)
    return f"{model_line(model, folder)}\n{held}"
