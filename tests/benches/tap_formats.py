"""One tap in the formats of instruments and programs: numbers in rows, clocks, variables, workbooks, universal files.

Every file of it holds the same tap: a stylus of 0.12 kg at 0.2 m/s on a spring and damper, contact at 0.1 s.
"""

import io
import struct
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import h5py
import numpy as np
from nptdms import ChannelObject, TdmsWriter
from scipy.io import savemat, wavfile

from transopt.base.signals import STANDARD_GRAVITY_M_S2 as G
from transopt.base.signals import FloatArray

SPEED_M_S = 0.2
ONSET_S = 0.1
RATE_HZ = 10_000.0


def tap(rate_Hz: float = RATE_HZ, length_s: float = 0.3) -> tuple[FloatArray, FloatArray]:
    """Times (n,) [s] and acceleration (n,) [m/s^2] of a mass that meets a spring with a damper, without the hand."""
    times = np.arange(round(length_s * rate_Hz)) / rate_Hz
    after = np.maximum(times - ONSET_S, 0.0)
    # Half a period of 4 ms and what is left of the spring: the speed turns from 0.2 to -0.14 m/s.
    pulse = np.where(after < 4e-3, np.sin(np.pi * after / 4e-3), 0.0)
    noise = 0.02 * np.random.default_rng(7).standard_normal(times.size)
    return times, 0.34 * np.pi / (2 * 4e-3) * pulse * (after > 0) + noise


TIMES_S, TAP_M_S2 = tap()
PEAK_M_S2 = float(TAP_M_S2.max())


@dataclass(frozen=True)
class Brought:
    """One file.

    Attributes
    ----------
    name : of the file, with its suffix; what it is like, then the variant.
    data : its bytes.
    options : what a user states at the first try beside the speed: nothing where the file says enough.
    lacks : the setting of the one fact that the file does not say; empty where it says enough.
    right : the answer that is right, where a fact lacks.
    peak_g : what the reader has to find, in g.
    """

    name: str
    data: bytes
    lacks: str = ""
    right: Mapping[str, Any] = field(default_factory=dict)
    peak_g: float = PEAK_M_S2 / G


def rows(*columns: Any, mark: str = ",", end: str = "\n", form: str = "{:.9g}") -> str:
    """Rows of numbers or words."""
    cells = [[each if isinstance(each, str) else form.format(each) for each in column] for column in columns]
    return "".join(mark.join(row) + end for row in zip(*cells, strict=True))


def axes(up: float = 1.0) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Three axes [m/s^2] that read the tap on z with the earth's field, and a little noise."""
    random = np.random.default_rng(3)
    x, y = (0.03 * random.standard_normal(TIMES_S.size) for _ in range(2))
    return x, y + 0.4, TAP_M_S2 + up * G


def clock(form: str) -> list[str]:
    """Dates and times of day of the samples."""
    stamps = np.datetime64("2024-03-05T14:11:02.000000") + np.round(1e6 * TIMES_S).astype("m8[us]")
    found = []
    for stamp in stamps:
        day, _, hour = str(stamp).partition("T")
        year, month, number = day.split("-")
        found.append(form.format(day=day, hour=hour, y=year, m=month, d=number))
    return found


V = 0.1 / G * TAP_M_S2  # volts of an accelerometer of 100 mV/g


def mat(**variables: Any) -> bytes:
    stream: Any = io.BytesIO()
    savemat(stream, variables)
    content: bytes = stream.getvalue()
    return content


Labelled = Mapping[str, tuple[FloatArray, str]]  # name -> values and their unit, empty where none is stated


def hdf5(variables: Labelled, user_block: int = 0) -> bytes:
    """An HDF5 file; with a user block of 512 bytes as MATLAB -v7.3 writes it."""
    stream = io.BytesIO()
    with h5py.File(stream, "w", userblock_size=user_block) as file:
        for name, (values, unit) in variables.items():
            made = file.create_dataset(name, data=values)
            if unit:
                made.attrs["units"] = unit
    return stream.getvalue()


def tdms(channels: Labelled, more: Mapping[str, object] | None = None) -> bytes:
    """A LabVIEW TDMS file of one group."""
    stream = io.BytesIO()
    with TdmsWriter(stream) as writer:
        writer.write_segment(
            [
                ChannelObject("taps", name, x, {"unit_string": unit, **(more or {})})
                for name, (x, unit) in channels.items()
            ]
        )
    return stream.getvalue()


def workbook(*sheets: list[tuple[object, ...]], merged: str = "") -> bytes:
    """A workbook of sheets named tap1, tap2 and so on: the least that the format demands (ECMA-376).

    `merged`: ranges of cells that are merged, such as "A1:D1 B3:D3".
    """
    head, kind = '<?xml version="1.0"?>', "http://schemas.openxmlformats.org"
    office = f"{kind}/officeDocument/2006/relationships"
    numbers = range(1, len(sheets) + 1)

    def cells(rows: list[tuple[object, ...]]) -> str:
        return "".join(
            "<row>"
            + "".join(
                f"<c><v>{cell!r}</v></c>"
                if isinstance(cell, float)
                else f'<c t="inlineStr"><is><t>{cell}</t></is></c>'
                for cell in row
            )
            + "</row>"
            for row in rows
        )

    ranges = "".join(f'<mergeCell ref="{each}"/>' for each in merged.split())
    named = "".join(f'<sheet name="tap{k}" sheetId="{k}" r:id="r{k}"/>' for k in numbers)
    related = "".join(
        f'<Relationship Id="r{k}" Type="{office}/worksheet" Target="worksheets/sheet{k}.xml"/>' for k in numbers
    )
    parts = {
        "[Content_Types].xml": f'<Types xmlns="{kind}/package/2006/content-types">'
        '<Default Extension="xml" ContentType="application/xml"/></Types>',
        "_rels/.rels": f'<Relationships xmlns="{kind}/package/2006/relationships">'
        f'<Relationship Id="r1" Type="{office}/officeDocument" Target="xl/workbook.xml"/></Relationships>',
        "xl/workbook.xml": f'<workbook xmlns="{kind}/spreadsheetml/2006/main" xmlns:r="{office}">'
        f"<sheets>{named}</sheets></workbook>",
        "xl/_rels/workbook.xml.rels": f'<Relationships xmlns="{kind}/package/2006/relationships">'
        f"{related}</Relationships>",
        **{
            f"xl/worksheets/sheet{k}.xml": f'<worksheet xmlns="{kind}/spreadsheetml/2006/main">'
            f"<sheetData>{cells(rows)}</sheetData>{ranges and f'<mergeCells>{ranges}</mergeCells>'}</worksheet>"
            for k, rows in zip(numbers, sheets, strict=True)
        },
    }
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, part in parts.items():
            archive.writestr(name, head + part)
    return stream.getvalue()


def universal(*functions: tuple[str, str], values: FloatArray = TAP_M_S2, binary: bool = False) -> bytes:
    """A universal file of time responses, each with its label and its number of an ordinate's type."""
    found = b""
    for k, (label, kind) in enumerate(functions, 1):
        head = "\n".join(
            [
                f"tap {k}",
                *["NONE"] * 4,
                f"{1:5d}{k:10d}{1:5d}{0:10d} {'stylus':10s}{k:10d}{3:4d} {'NONE':10s}{0:10d}{0:4d}",
                f"{4:10d}{values.size:10d}{1:10d}{0.0:13.5E}{1 / RATE_HZ:13.5E}{0.0:13.5E}",
                f"{17:10d}{0:5d}{0:5d}{0:5d} {'Time':20s} {'s':20s}",
                f"{kind:>10s}{0:5d}{0:5d}{0:5d} {'Acceleration':20s} {label:20s}",
                *[f"{0:10d}{0:5d}{0:5d}{0:5d} {'NONE':20s} {'NONE':20s}"] * 2,
            ]
        )
        if binary:
            packed = values.astype("<f8").tobytes()
            first = f"    58b{1:6d}{2:6d}{11:12d}{len(packed):12d}{0:6d}{0:6d}{0:12d}{0:12d}"
            found += f"    -1\n{first}\n{head}\n".encode() + packed + b"\n    -1\n"
        else:
            cells = [f"{value:20.12E}" for value in values]
            lines = "\n".join("".join(cells[at : at + 4]) for at in range(0, len(cells), 4))
            found += f"    -1\n    58\n{head}\n{lines}\n    -1\n".encode()
    return found


def wave(samples: FloatArray, kind: str) -> bytes:
    stream = io.BytesIO()
    if kind == "i3":  # of 24 bits, as Audacity writes it
        whole = np.round(samples * (2**23 - 1)).astype("<i4")
        packed = whole.view("u1").reshape(-1, 4)[:, :3].tobytes()
        head = struct.pack("<IHHIIHH", 16, 1, 1, int(RATE_HZ), int(RATE_HZ) * 3, 3, 24)
        return (
            b"RIFF"
            + struct.pack("<I", 36 + len(packed))
            + b"WAVEfmt "
            + head
            + b"data"
            + struct.pack("<I", len(packed))
            + packed
        )
    scale = {"i2": 2**15 - 1, "f4": 1.0}[kind]
    wavfile.write(stream, int(RATE_HZ), (samples * scale).astype(kind))
    return stream.getvalue()
