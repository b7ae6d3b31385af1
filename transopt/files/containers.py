"""Opens spreadsheets and loggers' files, each by its own library: the extra `formats`.

A sheet becomes the text that its program would have exported; TDMS and HDF5 become named variables.
`transopt.files.formats` interprets them.
"""

import io
import logging
import subprocess
import sys
import warnings
import zipfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import date, datetime, time
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any

from transopt.base.errors import InputError
from transopt.base.npz import Archive
from transopt.base.sizes import MOST_ROWS, MOST_UNPACKED_BYTES, megabytes
from transopt.files.names import labelled, quote
from transopt.files.raw_table import MIN_SAMPLES
from transopt.files.statements import Rate

HDF5_TIME_S = 8.0  # the largest valid file, 268 MB, took 1.3 s
HDF5 = b"\x89HDF\r\n\x1a\n"
MOST_CELLS = 32 * MOST_ROWS


@dataclass(frozen=True)
class Channels:
    """Variables of a logger's file.

    Attributes
    ----------
    values : name, with the unit in brackets where the file states it -> array, read on access.
    rate : sample rate, if the file states it.
    place : names the place of a sample index for the user.
    """

    values: Mapping[str, Any]
    rate: Rate | None = None
    place: Callable[[int], str] = "sample {}".format


@contextmanager
def guarded(what: str, remedy: str) -> Iterator[None]:
    """Run a reader on unchecked bytes: every exception or warning it raises becomes an InputError."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            warnings.filterwarnings("error", "Reached EOF prematurely")  # a WAV file cut short
            yield
    except Exception as error:
        raise InputError(f"{what} ({quote(str(error) or type(error).__name__)}); {remedy}") from error


def _library(module: str, package: str, what: str) -> ModuleType:
    """Import the library that reads a format."""
    try:
        return import_module(module)
    except ImportError:
        raise InputError(
            f"{what} is read by {package}, which is not installed: pip install 'transopt[formats]', or export the "
            "file as CSV"
        ) from None


def sheet_as_text(data: bytes, notes: list[str]) -> bytes:
    """The longest sheet of a workbook (.xlsx, .xls, .ods) as text with semicolons between cells.

    Parameters
    ----------
    notes : receives a sentence that names the sheet if others could have been meant.

    Raises
    ------
    InputError : the file is no workbook, has no rows or too many cells, or the library is missing.
    """
    calamine = _library("python_calamine", "python-calamine", "a spreadsheet")
    with guarded("not a readable workbook", "export the sheet as CSV"):
        if zipfile.is_zipfile(io.BytesIO(data)):
            with zipfile.ZipFile(io.BytesIO(data)) as packed:
                if sum(member.file_size for member in packed.infolist()) > MOST_UNPACKED_BYTES:
                    raise ValueError(f"it unpacks to more than {megabytes(MOST_UNPACKED_BYTES)}")
        book = calamine.CalamineWorkbook.from_filelike(io.BytesIO(data))
        sheets = [book.get_sheet_by_name(name) for name in book.sheet_names]
        if sum(sheet.total_height * sheet.total_width for sheet in sheets) > MOST_CELLS:
            raise ValueError(f"more than {MOST_CELLS} cells")
        rows_of = {sheet.name: _filled(sheet) for sheet in sheets}
    name = max(rows_of, key=lambda each: len(rows_of[each]), default="")
    rows = rows_of.get(name, [])
    long = sum(len(each) >= MIN_SAMPLES for each in rows_of.values())
    if long > 1:
        notes.append(f"of {long} sheets the longest, {quote(name)}, is read; save each as a file to use the others")
    return "\n".join(";".join(map(_cell, row)) for row in rows).encode()


def _filled(sheet: Any) -> list[list[object]]:
    """The rows of a sheet; a cell merged over several columns is in each of them, as a unit that they share.

    A cell merged over all columns is a title and stays in the first.
    """
    rows: list[list[object]] = sheet.to_python()
    (top, left) = sheet.start or (0, 0)
    for (row, first), (_, last) in sheet.merged_cell_ranges or ():
        cells = rows[row - top] if 0 <= row - top < len(rows) else []
        if last - first + 1 < len(cells):
            cells[first - left : last - left + 1] = [cells[first - left]] * (last - first + 1)
    return rows


def _cell(value: object) -> str:
    if type(value) is date:  # an instant at midnight
        value = datetime.combine(value, time())
    return repr(value) if isinstance(value, float) else " ".join(str(value).replace(";", ",").split())


def tdms_channels(data: bytes) -> Channels:
    """The channels of a LabVIEW TDMS file, with the time step of its waveforms.

    Raises
    ------
    InputError : the file is not TDMS, or the library is missing.
    """
    nptdms = _library("nptdms", "npTDMS", "a TDMS file")
    log_manager = _library("nptdms.log", "npTDMS", "a TDMS file").log_manager
    log_manager.set_level(logging.CRITICAL)  # otherwise it logs every damaged byte
    with guarded("not a readable TDMS file", "export it as CSV"):
        channels = [channel for group in nptdms.TdmsFile(io.BytesIO(data)).groups() for channel in group.channels()]
        values = {labelled(each.name, each.properties.get("unit_string")): each[:] for each in channels}
        steps = {float(step) for each in channels if (step := each.properties.get("wf_increment"))}
        starts = {float(each.properties.get("wf_start_offset", 0.0)) for each in channels}
    # Channels of different rates differ in length; `RawTable.rows` refuses them.
    return Channels(values, Rate(min(steps), min(starts, default=0.0)) if steps else None)


def hdf5_datasets(data: bytes) -> Channels:
    """The numeric arrays of an HDF5 file, as MATLAB -v7.3 and loggers write it, by their paths.

    Raises
    ------
    InputError : the file is not HDF5, unpacks to too much, is damaged, or the library is missing.
    """
    _library("h5py", "h5py", "an HDF5 file (also MAT -v7.3)")
    command = [sys.executable, "-I", str(Path(__file__).with_name("hdf5_variables.py")), str(MOST_UNPACKED_BYTES)]
    with guarded("not a readable HDF5 file", "export it as CSV"):
        read = subprocess.run(command, input=data, capture_output=True, timeout=HDF5_TIME_S, check=False)
        if read.returncode:
            last = read.stderr.decode("utf-8", "replace").strip().splitlines()
            raise ValueError(last[-1] if last else "the library cannot go on")
        archive = Archive(read.stdout)
    return Channels(archive)
