"""A separate program: reads an HDF5 file from standard input, writes its numeric arrays as NPZ to standard output.

The HDF5 library crashes or hangs on some damaged files. `transopt.files.containers` therefore runs it in this
process of its own, with a time limit.
"""

import io
import sys
from typing import Any

import h5py
import numpy as np

UNITS = ("unit", "units", "Unit", "Units")


def arrays(data: bytes, most_bytes: int) -> dict[str, Any]:
    """Numeric datasets by path, separated by dots, with the unit in brackets if an attribute states it.

    Raises
    ------
    ValueError : the arrays exceed this number of bytes.
    """
    found: dict[str, Any] = {}
    room = most_bytes

    def take(path: str, node: object) -> None:
        nonlocal room
        if isinstance(node, h5py.Dataset) and node.dtype.kind in "iuf":
            room -= node.size * node.dtype.itemsize
            if room < 0:
                raise ValueError(f"it unpacks to more than {most_bytes / 1e6:.0f} MB")
            unit = next((node.attrs[key] for key in UNITS if key in node.attrs), "")
            unit = unit.decode("utf-8", "replace") if isinstance(unit, bytes) else unit
            name = path.replace("/", ".")
            found[f"{name} [{unit}]" if isinstance(unit, str) and unit.strip() else name] = np.squeeze(node[()])

    with h5py.File(io.BytesIO(data), "r") as file:
        file.visititems(take)
    return found


if __name__ == "__main__":
    try:
        np.savez(sys.stdout.buffer, **arrays(sys.stdin.buffer.read(), int(sys.argv[1])))
    except Exception as error:
        sys.exit(str(error) or type(error).__name__)
