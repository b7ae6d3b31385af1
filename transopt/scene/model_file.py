"""Model files, in which `transopt identify` stores an identified device: read, written, and put into a scene.

The file is JSON with `schema`, `versions` and up to four parts (`transopt.scene.model_parts`), each with its
uncertainty, its verdict and its sources. Numbers are in SI, with units in the names. Covariances are in the order of
the part's `parameters`, which exclude fixed parameters. Intervals are 95 % intervals.
"""

import hashlib
import json
import os
import platform
import re
from collections.abc import Sequence
from importlib import metadata
from pathlib import Path
from typing import Annotated, Any, Literal, NoReturn

from pydantic import Field, ValidationError

from transopt.base.errors import InputError
from transopt.base.files import check_depth, read_file, whole_file
from transopt.base.sizes import MOST_MODEL_BYTES
from transopt.scene import model_parts
from transopt.scene.fitted import complaint

SCHEMA = 1
_GRIPS_LINE = re.compile(r"^grips_N *= *\[[^]]*\]", re.MULTILINE)
OF_THE_FILE = ("pole_Hz", "delay_s")  # keys of [amplifier] that a file with an amplifier part replaces


class ModelFile(model_parts.ModelParts):
    """The content of a model file: its parts, and the versions of the software that wrote it.

    Attributes
    ----------
    schema_ : version of the file format.
    versions : package -> version.
    """

    # The field is called `schema` in the file, but pydantic has a deprecated method of that name.
    schema_: Annotated[Literal[1], Field(alias="schema")]
    versions: dict[str, str]


def _refuse_constant(text: str) -> NoReturn:
    raise ValueError(f"{text} is not a finite number")


def _parsed(source: Path | str, content: bytes) -> ModelFile:
    """Parse a model file's bytes; `source` names it in messages."""
    advice = "give a file written by `transopt identify`, or identify again into another file"
    try:
        parsed = json.loads(content.decode("utf-8-sig"), parse_constant=_refuse_constant)
        check_depth(parsed)
    except UnicodeDecodeError:
        raise InputError(f"{source}: not a text file, so no model file; {advice}") from None
    except (ValueError, RecursionError) as error:
        raise InputError(f"{source}: damaged or no model file ({error}); {advice}") from None
    if not isinstance(parsed, dict) or "schema" not in parsed:
        raise InputError(f"{source}: no model file (schema is missing); {advice}")
    try:
        return ModelFile.model_validate(parsed)
    except ValidationError as error:
        raise InputError(f"{source}: {complaint(error)}; {advice}") from None


def _raw(path: Path) -> bytes:
    """A model file's bytes, unchecked."""
    advice = "`transopt identify device FILES... --out MODEL.json` writes one"
    return read_file(path, MOST_MODEL_BYTES, advice)


def load_model(path: Path) -> ModelFile:
    """Read and check a model file.

    Raises
    ------
    InputError : one line: file, field, value, what to do.
    """
    return _parsed(path, _raw(path))


def save_part(path: Path, name: model_parts.ModelPartName, part: model_parts.AnyModelPart) -> None:
    """Write one part into a model file and keep the file's other parts.

    Raises
    ------
    InputError : an existing file that is damaged or no model file, which is not changed; a path that cannot be
        written.
    ValidationError : a part that does not belong under this name.
    """
    content = load_model(path).model_dump(by_alias=True, mode="json") if path.exists() else {}
    content = {
        "schema": SCHEMA,
        "versions": {
            **{package: metadata.version(package) for package in ("transopt", "numpy", "scipy")},
            "python": platform.python_version(),
        },
        **{other: content[other] for other in model_parts.MODEL_PARTS if content.get(other) is not None},
        name: part.model_dump(mode="json"),
    }
    ModelFile.model_validate(content)
    text = json.dumps(content, indent=1, allow_nan=False)
    with whole_file(path) as file:
        file.write(f"{text}\n".encode())


def identified_table(path: Path, shown: str) -> dict[str, Any]:
    """The table `[model]` with a model file's content, so that a library does not need the file.

    Parameters
    ----------
    shown : name of the file in reports.

    Raises
    ------
    InputError : no such file, or no model file.
    """
    raw = _raw(path)
    found = _parsed(path, raw).model_dump(include=set(model_parts.MODEL_PARTS), exclude_none=True)
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

    These are means of what a sensor read, such as 1.00001 N, and are rounded to what it can tell, 3 digits.
    """
    moving = identified.get("device") or identified.get("hand")
    if moving is None:
        return list(grips_N)
    known: list[float] = moving["grips_N"]
    try:
        for grip_N in grips_N:
            model_parts.check_grip(known, grip_N)
    except InputError:
        return sorted({float(f"{grip_N:.3g}") for grip_N in known if grip_N > 0}) or known
    return list(grips_N)


def model_line(model: Path, folder: Path) -> str:
    """The line by which a scene file in a folder names a model file, to be put above the scene's first table."""
    named = model if model.is_absolute() else Path(os.path.relpath(model, folder))
    return f"model_file = {json.dumps(named.as_posix())}"  # JSON strings are valid TOML strings


def on_model(text: str, model: Path, folder: Path, grips_N: Sequence[float]) -> str:
    """The text of a scene file in a folder, with a model file in place of its device, and with these grips."""
    held = _GRIPS_LINE.sub(f"grips_N = {list(grips_N)}", text, count=1)
    return f"{model_line(model, folder)}\n{held}"
