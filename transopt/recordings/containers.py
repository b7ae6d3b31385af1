"""Files of spreadsheets and loggers, each opened by the library that is kept for it: the extra `formats`.

A sheet becomes the text that its program would have exported; TDMS and HDF5 become named variables. What they mean is
`transopt.recordings.formats`' business.
"""

import io
import logging
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from importlib import import_module
from types import ModuleType
from typing import Any

import numpy as np

from transopt.base.errors import InputError
from transopt.base.sizes import MOST_ROWS, MOST_UNPACKED_BYTES, megabytes
from transopt.recordings.names import quote

HDF5 = b"\x89HDF\r\n\x1a\n"
MOST_CELLS = 32 * MOST_ROWS


@dataclass(frozen=True)
class Channels:
    """What a logger's file holds.

    Attributes
    ----------
    values : name, with its unit in brackets where the file states it -> array, read when it is asked for.
    step_s, start_s : of the samples, where the file states them.
    """

    values: Mapping[str, Any]
    step_s: float | None = None
    start_s: float = 0.0


@contextmanager
def guarded(what: str, remedy: str) -> Iterator[None]:
    """Run a reader on unchecked bytes: whatever it raises or warns of, nothing but InputError comes out."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            warnings.filterwarnings("error", "Reached EOF prematurely")  # a WAV file cut short
            yield
    except Exception as error:
        raise InputError(f"{what} ({quote(str(error) or type(error).__name__)}); {remedy}") from error


def _library(module: str, package: str, what: str) -> ModuleType:
    """The library that reads a format.

    Raises
    ------
    InputError : it is not installed.
    """
    try:
        return import_module(module)
    except ImportError:
        raise InputError(
            f"{what} is read by {package}, which is not installed: pip install 'transopt[formats]', or export the "
            "file as CSV"
        ) from None


def sheet_as_text(data: bytes) -> bytes:
    """The fullest sheet of a workbook (.xlsx, .xls, .ods) as text between tabs.

    Raises
    ------
    InputError : no workbook, none with rows, or the library is missing.
    """
    calamine = _library("python_calamine", "python-calamine", "a spreadsheet")
    with guarded("not a readable workbook", "export the sheet as CSV"):
        book = calamine.CalamineWorkbook.from_filelike(io.BytesIO(data))
        sheets = [book.get_sheet_by_name(name) for name in book.sheet_names]
        if sum(sheet.total_height * sheet.total_width for sheet in sheets) > MOST_CELLS:
            raise ValueError(f"more than {MOST_CELLS} cells")
        rows = max((sheet.to_python() for sheet in sheets), key=len, default=[])
    return "\n".join("\t".join(map(_cell, row)) for row in rows).encode()


def _cell(value: object) -> str:
    return repr(value) if isinstance(value, float) else " ".join(str(value).split())


def tdms_channels(data: bytes) -> Channels:
    """The channels of a LabVIEW TDMS file, with the step of its waveforms.

    Raises
    ------
    InputError : not of the format, or the library is missing.
    """
    nptdms = _library("nptdms", "npTDMS", "a TDMS file")
    logging.getLogger("nptdms").setLevel(logging.CRITICAL)
    with guarded("not a readable TDMS file", "export it as CSV"):
        channels = [channel for group in nptdms.TdmsFile(io.BytesIO(data)).groups() for channel in group.channels()]
        values = {_labelled(each.name, each.properties.get("unit_string")): each[:] for each in channels}
        steps = {float(step) for each in channels if (step := each.properties.get("wf_increment"))}
        starts = {float(each.properties.get("wf_start_offset", 0.0)) for each in channels}
    # Channels of several rates have lengths of their own, which are refused where they are compared.
    return Channels(values, min(steps, default=None), min(starts, default=0.0))


def hdf5_datasets(data: bytes) -> Channels:
    """The numeric arrays of an HDF5 file, as MATLAB -v7.3 and loggers write it, by path.

    Raises
    ------
    InputError : not of the format, too large unpacked, or the library is missing.
    """
    h5py = _library("h5py", "h5py", "an HDF5 file (also MAT -v7.3)")
    found: dict[str, Any] = {}
    room = MOST_UNPACKED_BYTES

    def take(path: str, node: object) -> None:
        nonlocal room
        if isinstance(node, h5py.Dataset) and node.dtype.kind in "iuf":
            room -= node.size * node.dtype.itemsize
            if room < 0:
                raise ValueError(f"it unpacks to more than {megabytes(MOST_UNPACKED_BYTES)}")
            unit = next((node.attrs[key] for key in ("unit", "units", "Unit", "Units") if key in node.attrs), None)
            found[_labelled(path.replace("/", "."), unit)] = np.squeeze(node[()])

    with guarded("not a readable HDF5 file", "export it as CSV"), h5py.File(io.BytesIO(data), "r") as file:
        file.visititems(take)
    return Channels(found)


def _labelled(name: str, unit: object) -> str:
    unit = unit.decode("utf-8", "replace") if isinstance(unit, bytes) else unit
    return f"{name} [{unit}]" if isinstance(unit, str) and unit.strip() else name
