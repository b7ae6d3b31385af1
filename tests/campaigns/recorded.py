"""Conversations with a device as they went: what arrived and was read in each tick, what was said and commanded.

A conversation depends on nothing but itself, so a device of any make can be asked to repeat its part. Readings are
rounded to a grid before a device sees them; what is recorded then packs to a third.
"""

import struct
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from controller.firmware.core_device import DeviceEnd, counts_of
from controller.servo.interface import Output, Readings

BOOT = 1  # of every device in a conversation
GRID = 1 / 1024  # of readings, in their units
SILENT = -1  # nobody fetched what was said in this tick
ANOTHER_DEVICE = b"\xff\xff\xff\xff"  # before the first tick of each in a file for talk_main.c
NUMBERS = ("command_A", "transient_A", "feedback_A", "winding_C")
TICK = np.dtype(
    [
        ("arrived", "<u4"),  # bytes before the tick
        ("encoder_counts", "<i4"),
        ("emergency_stop", "u1"),
        ("grip_N", "<f8"),
        ("current_A", "<f8"),
        ("acceleration_m_s2", "<f8"),
        *((name, "<f8") for name in NUMBERS),
        ("state", "S7"),
        ("said", "<i4"),  # bytes fetched after the tick, or SILENT
    ]
)


@dataclass(frozen=True)
class Conversation:
    """Conversation with one device from its start on.

    Attributes
    ----------
    ticks : (N,) of dtype `TICK`.
    arrived, said : all bytes one after the other; `ticks` says how many belong to each tick.
    """

    name: str
    ticks: NDArray[Any]
    arrived: bytes
    said: bytes

    def differs(self, device: DeviceEnd) -> str:
        """The first tick in which this device, just started, does not do as recorded, in words; empty if none."""
        heard = spoken = 0
        for k, tick in enumerate(self.ticks):
            device.receive(self.arrived[heard : heard + int(tick["arrived"])])
            heard += int(tick["arrived"])
            output = device.step(readings_of(k, tick))
            numbers = [getattr(output, name) for name in NUMBERS]
            if output.state.value != tick["state"].decode() or not _same(numbers, [tick[name] for name in NUMBERS]):
                return f"{self.name}, tick {k}: {output}, recorded {tick}"
            if tick["said"] == SILENT:
                continue
            said, wanted = device.bytes_to_send(), self.said[spoken : spoken + int(tick["said"])]
            spoken += len(wanted)
            if said != wanted:
                return f"{self.name}, tick {k}: said {said.hex()}, recorded {wanted.hex()}"
        return ""

    def talk(self) -> bytes:
        """Conversation as `controller/firmware/replay/talk_main.c` reads it."""
        record, heard = bytearray(ANOTHER_DEVICE), 0
        for tick in self.ticks:
            data = self.arrived[heard : heard + int(tick["arrived"])]
            heard += len(data)
            numbers = (tick[name] for name in ("grip_N", "current_A", "acceleration_m_s2"))
            record += struct.pack("<I", len(data)) + data
            record += struct.pack("<iIddd", tick["encoder_counts"], tick["emergency_stop"], *numbers)
        return bytes(record)


def readings_of(k: int, tick: Any) -> Readings:
    """What was read in a tick of this number."""
    names = ("grip_N", "current_A", "acceleration_m_s2")
    return Readings(
        k, int(tick["encoder_counts"]), *(float(tick[name]) for name in names), bool(tick["emergency_stop"])
    )


def _same(found: list[float], wanted: list[float]) -> bool:
    """To the last bit, but that any NaN is like any other."""
    return np.array_equal(np.array(found), np.array(wanted), equal_nan=True)


def _rounded(value: float) -> float:
    return round(value / GRID) * GRID if abs(value) < 1e6 else value


@dataclass
class Overheard:
    """A `DeviceEnd` that keeps what passes through it."""

    device: DeviceEnd
    _rows: list[tuple[Any, ...]] = field(default_factory=list)
    _arrived: bytearray = field(default_factory=bytearray)
    _said: bytearray = field(default_factory=bytearray)
    _before: int = 0

    def receive(self, data: bytes) -> None:
        self._arrived += data
        self.device.receive(data)

    def step(self, readings: Readings) -> Output:
        r = readings._replace(
            tick=len(self._rows),
            encoder_counts=counts_of(readings.encoder_counts),
            grip_N=_rounded(readings.grip_N),
            current_A=_rounded(readings.current_A),
            acceleration_m_s2=_rounded(readings.acceleration_m_s2),
        )
        output = self.device.step(r)
        read = (r.encoder_counts, r.emergency_stop, r.grip_N, r.current_A, r.acceleration_m_s2)
        answer = (*(getattr(output, name) for name in NUMBERS), output.state.value.encode())
        self._rows.append((len(self._arrived) - self._before, *read, *answer, SILENT))
        self._before = len(self._arrived)
        return output

    def bytes_to_send(self) -> bytes:
        said = self.device.bytes_to_send()
        self._said += said
        if self._rows:
            self._rows[-1] = (*self._rows[-1][:-1], len(said))
        return said

    def conversation(self, name: str) -> Conversation:
        return Conversation(name, np.array(self._rows, dtype=TICK), bytes(self._arrived), bytes(self._said))


def save(path: Path, conversations: Iterable[Conversation]) -> None:
    """All of them as columns in one compressed file."""
    them = list(conversations)
    ticks = np.concatenate([one.ticks for one in them])
    arrived, said = (
        np.frombuffer(b"".join(data), np.uint8) for data in zip(*((c.arrived, c.said) for c in them), strict=True)
    )
    np.savez_compressed(
        path,
        names=np.array([one.name for one in them]),
        counts=np.array([one.ticks.size for one in them]),
        arrived_bytes=arrived,
        said_bytes=said,
        **{name: ticks[name] for name in TICK.names or ()},
    )


def load(path: Path) -> list[Conversation]:
    with np.load(path) as stored:
        ticks = np.empty(stored["state"].size, TICK)
        for name in TICK.names or ():
            ticks[name] = stored[name]
        arrived, said = stored["arrived_bytes"].tobytes(), stored["said_bytes"].tobytes()
        names, ends = stored["names"].tolist(), np.cumsum(stored["counts"])
    found, first, heard, spoken = [], 0, 0, 0
    for name, end in zip(names, ends, strict=True):
        own = ticks[first:end]
        more, told = int(own["arrived"].sum()), int(own["said"][own["said"] != SILENT].sum())
        found.append(Conversation(name, own, arrived[heard : heard + more], said[spoken : spoken + told]))
        first, heard, spoken = end, heard + more, spoken + told
    return found
