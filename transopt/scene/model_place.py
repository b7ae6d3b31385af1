"""Inserts a model file into a scene: which tables it replaces, which stay, and which grips it serves."""

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
OF_THE_FILE = ("pole_Hz", "delay_s")  # keys of [amplifier] that a file with an amplifier part replaces


def identified_table(path: Path, shown: str) -> dict[str, Any]:
    """The table `[model]` with a model file's content, so that a library does not need the file.

    Parameters
    ----------
    shown : name of the file in reports.

    Raises
    ------
    InputError : no such file, or no model file.
    """
    raw = read_model(path)
    found = parse_model(path, raw).model_dump(include=set(MODEL_PARTS), exclude_none=True)
    return {"kind": "identified", "file": shown, "sha256": hashlib.sha256(raw).hexdigest(), **found}


def put_model(content: dict[str, Any], identified: dict[str, Any]) -> None:
    """Replace a scene's own device by a model file.

    If the recordings are simulated, the scene's own [model], [tip], pole and delay move into the table `striker`: it
    makes the taps to reproduce, independently of the model used for the design.

    Parameters
    ----------
    content : tables of the scene file; modified in place.
    identified : see `identified_table`.
    """
    own, amplifier, recordings = content.get("model"), content.get("amplifier"), content.get("recordings")
    simulated = isinstance(recordings, dict) and recordings.get("simulated") is not None
    if isinstance(own, dict) and own.get("kind") != "identified" and simulated:
        # A simulated tap is not driven: of the amplifier only the delay matters, for the length of the recording.
        whole = isinstance(amplifier, dict) and all(amplifier.get(name) is not None for name in OF_THE_FILE)
        striker = {"model": own, "tip": content.get("tip"), "amplifier": amplifier if whole else "ideal"}
        content["striker"] = {name: table for name, table in striker.items() if table is not None}
    content["model"] = identified
    if "device" in identified:
        content.pop("tip", None)
    if "amplifier" in identified and isinstance(amplifier, dict):
        content["amplifier"] = {key: value for key, value in amplifier.items() if key not in OF_THE_FILE}


def served_grips(identified: dict[str, Any], grips_N: Sequence[float]) -> list[float]:
    """The given grips if the model covers them all, else those at which it was identified, without the free one.

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
    """The line by which a scene file in a folder names a model file, to be put above the scene's first table."""
    named = model if model.is_absolute() else Path(os.path.relpath(model, folder))
    return f"model_file = {json.dumps(named.as_posix())}"  # JSON strings are valid TOML strings


def on_model(text: str, model: Path, folder: Path, grips_N: Sequence[float]) -> str:
    """The text of a scene file in a folder, with a model file in place of its device, and with these grips."""
    held = _GRIPS_LINE.sub(f"grips_N = {list(grips_N)}", text, count=1)
    return f"{model_line(model, folder)}\n{held}"
