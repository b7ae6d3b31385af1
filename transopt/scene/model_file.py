"""Reading and writing of model files, in which `transopt identify` stores an identified device.

The file is JSON with `schema`, `versions` and up to four parts (`transopt.scene.model_parts`), each with its
uncertainty, its verdict and its sources. Numbers are in SI, with units in the names. Covariances are in the order of
the part's `parameters`, which exclude fixed parameters. Intervals are 95 % intervals.
"""

import json
import platform
from importlib import metadata
from pathlib import Path
from typing import Annotated, Literal, NoReturn

from pydantic import Field, ValidationError

from transopt.base.errors import InputError
from transopt.base.files import check_depth, read_file, whole_file
from transopt.base.sizes import MOST_MODEL_BYTES
from transopt.scene.fitted import complaint
from transopt.scene.model_parts import (
    MODEL_PARTS,
    AmplifierPart,
    AnyModelPart,
    CoilPart,
    DriveDevice,
    FourthOrderHand,
    ModelPartName,
    ModelParts,
    SecondOrderHand,
    StateSpaceDevice,
)

SCHEMA = 1


class ModelFile(ModelParts):
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


def parse_model(source: Path | str, content: bytes) -> ModelFile:
    """Parse a model file's bytes; `source` names it in messages.

    Raises
    ------
    InputError : one line: file, field, value, what to do.
    """
    advice = "give a file written by `transopt identify`, or identify again into another file"
    try:
        parsed = json.loads(content.decode("utf-8"), parse_constant=_refuse_constant)
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


def read_model(path: Path) -> bytes:
    """A model file's bytes, unchecked.

    Raises
    ------
    InputError : no such file, or one that cannot be read.
    """
    advice = "`transopt identify device FILES... --out MODEL.json` writes one"
    return read_file(path, MOST_MODEL_BYTES, advice)


def load_model(path: Path) -> ModelFile:
    """Read and check a model file.

    Raises
    ------
    InputError : one line: file, field, value, what to do.
    """
    return parse_model(path, read_model(path))


def save_part(path: Path, name: ModelPartName, part: AnyModelPart) -> None:
    """Write one part into a model file and keep the file's other parts.

    Raises
    ------
    InputError : an existing file that is damaged or no model file, which is not changed; a path that cannot be
        written.
    TypeError : a part that does not belong under this name.
    """
    expected = {
        "amplifier": AmplifierPart,
        "device": DriveDevice | StateSpaceDevice,
        "hand": SecondOrderHand | FourthOrderHand,
        "coil": CoilPart,
    }[name]
    if not isinstance(part, expected):
        raise TypeError(f"{name}: cannot be a {type(part).__name__}")
    content = load_model(path).model_dump(by_alias=True, mode="json") if path.exists() else {}
    content = {
        "schema": SCHEMA,
        "versions": {
            **{package: metadata.version(package) for package in ("transopt", "numpy", "scipy")},
            "python": platform.python_version(),
        },
        **{other: content[other] for other in MODEL_PARTS if content.get(other) is not None},
        name: part.model_dump(mode="json"),
    }
    text = json.dumps(content, indent=1, allow_nan=False)
    with whole_file(path) as file:
        file.write(f"{text}\n".encode())
