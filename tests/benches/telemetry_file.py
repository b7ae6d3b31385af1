"""Telemetry as a user reads it, of a running or killed run too."""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from controller.record.telemetry import COLUMNS, KINDS


def read_csv(path: Path) -> dict[str, NDArray[Any]]:
    """The columns of a telemetry CSV; an incomplete last line is left out."""
    text = path.read_bytes().decode("ascii")
    head, *lines = text[: text.rfind("\n") + 1].splitlines()
    assert head == ",".join(COLUMNS)
    by_column = list(zip(*(line.split(",") for line in lines), strict=True)) or [()] * len(COLUMNS)
    return {
        name: np.array(values, dtype=np.str_ if KINDS.get(name, "S")[0] == "S" else KINDS[name])
        for name, values in zip(COLUMNS, by_column, strict=True)
    }
