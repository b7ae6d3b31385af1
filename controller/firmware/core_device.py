"""The device: its compiled core as an object in this process, sans-IO, without a clock and without a port.

The same C files run on a microcontroller and in the program behind `transopt-device`. Here they are a shared library,
compiled on first use or when the package was built, so that a host, a line and a device can run in one process in
virtual time.
"""

import ctypes
import functools
import math
import os
from dataclasses import astuple
from pathlib import Path
from typing import Protocol

from controller.firmware.build import CORE, FIRMWARE, NoCompilerError, build, sources
from controller.protocol.capacity import Hardware
from controller.protocol.codes import EVENTS, STATES
from controller.protocol.messages import NO_COUNTS
from controller.servo.interface import Event, Fault, Output, Readings

REPLAY = FIRMWARE / "replay"
MOST_EVENTS = len(Fault)
NO_EVENTS = bytes(MOST_EVENTS)
INSTALLED = FIRMWARE / ("_core.pyd" if os.name == "nt" else "_core.so")


def counts_of(encoder_counts: float) -> int:
    """What an encoder that gives 32 bits says instead: no number stays none, what is too large stays too large."""
    if not -(2**31) < encoder_counts < 2**31:
        return NO_COUNTS
    return int(encoder_counts)


class DeviceEnd(Protocol):
    """A device's end of the link. Not thread-safe: one thread makes all three calls."""

    def receive(self, data: bytes) -> None:
        """Take whatever came over the link since the last call, in pieces of any size."""

    def step(self, readings: Readings) -> Output:
        """One servo period: the command that answers one tick's readings, to be held until the next tick."""

    def bytes_to_send(self) -> bytes:
        """What goes out since the last call."""


def _compiled(flags: tuple[str, ...]) -> Path:
    """The shared library: compiled here where there is a compiler, else the one that was installed, of usual size.

    A compiler comes first, because only what is compiled here is sure to be of the sources that are here.

    Raises
    ------
    NoCompilerError : no compiler, and none was installed or flags are asked for.
    """
    try:
        own = [REPLAY / "td_probe.c", REPLAY / "td_replay.c"]
        return build("probe", [*sources(CORE), *own], flags=flags, shared=True)
    except NoCompilerError:
        if flags or not INSTALLED.exists():
            raise
        return INSTALLED


@functools.cache
def core_library(flags: tuple[str, ...] = ()) -> ctypes.CDLL:
    """The core and what drives it from here, with the types of all calls.

    Raises
    ------
    NoCompilerError : it can neither be compiled here nor was it when the package was built.
    """
    library = ctypes.CDLL(str(_compiled(flags)))
    pointer, size = ctypes.c_void_p, ctypes.c_size_t
    for name in ("td_probe_device_size", "td_device_send", "td_replay_size"):
        getattr(library, name).restype = size
    library.td_probe_step.restype = ctypes.c_uint8
    library.td_probe_start.argtypes = [pointer, ctypes.c_uint32, pointer, pointer, ctypes.c_bool]
    library.td_probe_step.argtypes = [pointer, ctypes.c_uint64, ctypes.c_int32, ctypes.c_uint8, *4 * (pointer,)]
    library.td_device_receive.argtypes = [pointer, ctypes.c_char_p, size]
    library.td_device_send.argtypes = [pointer, pointer, size]
    library.td_replay_start.argtypes = [pointer, ctypes.c_char_p, size, ctypes.c_char_p, size]
    library.td_replay_start.restype = ctypes.c_bool
    library.td_replay_run.argtypes = [pointer, pointer, size, pointer]
    library.td_replay_heat.argtypes = [pointer, pointer, size, size, pointer]
    library.td_replay_coil.argtypes = [pointer, pointer]
    return library


class Aligned:
    """Zeroed memory for one struct."""

    def __init__(self, size: int) -> None:
        self._memory = ctypes.create_string_buffer(size + 16)
        self.at = (ctypes.addressof(self._memory) + 15) & ~15


class CoreDevice:
    """A `DeviceEnd`: one device from one start to the next.

    Parameters
    ----------
    boot : another number at every start.
    hardware : what the amplifier behind the device is good for; the default's without it.
    simulated : nothing is wired that could be wired wrong, so that it arms without evidence.
    heat_C : winding and housing as they were kept over the restart; None where they were not, so that they start at
        their hottest.
    flags : of the compiler, such as capacities (`-DTD_MAX_LIBRARY_SAMPLES=3000`) or -DTD_REAL_FLOAT.

    Raises
    ------
    NoCompilerError : it can neither be compiled here nor was it when the package was built.
    """

    ROOM_BYTES = 1 << 17

    def __init__(
        self,
        boot: int,
        hardware: Hardware | None = None,
        flags: tuple[str, ...] = (),
        *,
        simulated: bool = False,
        heat_C: tuple[float, float] | None = (25.0, 25.0),
    ) -> None:
        self._library, self.tick = core_library(flags), 0
        self._device = Aligned(self._library.td_probe_device_size())
        limits = Hardware() if hardware is None else hardware
        stated = [float(value) for value in astuple(limits)]
        numbers, heat = (ctypes.c_double * len(stated))(*stated), (ctypes.c_double * 2)(*(heat_C or 2 * (math.nan,)))
        self._library.td_probe_start(self._device.at, boot, numbers, heat, simulated)
        self._out = ctypes.create_string_buffer(self.ROOM_BYTES)
        self._in, self._answer = (ctypes.c_double * 3)(), (ctypes.c_double * 4)()
        self._events = ctypes.create_string_buffer(MOST_EVENTS)
        self._contacts = (ctypes.c_double * (4 * MOST_EVENTS))()
        of = ctypes.addressof
        self._at = of(self._in), of(self._answer), of(self._events), of(self._contacts)

    def receive(self, data: bytes) -> None:
        self._library.td_device_receive(self._device.at, data, len(data))

    def bytes_to_send(self) -> bytes:
        size = self._library.td_device_send(self._device.at, self._out, self.ROOM_BYTES)
        return ctypes.string_at(self._out, size) if size else b""

    def step(self, readings: Readings) -> Output:
        r, self.tick = readings, readings.tick
        self._in[:] = [r.grip_N, r.current_A, r.acceleration_m_s2]
        counts, stops = counts_of(r.encoder_counts), r.emergency_stop | r.late << 1
        state = self._library.td_probe_step(self._device.at, r.tick, counts, stops, *self._at)
        events: tuple[Event, ...] = ()
        happened = self._events.raw
        if happened != NO_EVENTS:  # a step in a thousand
            events = tuple(
                Event(r.tick, EVENTS[code], *self._contacts[4 * j : 4 * j + 4])  # type: ignore[arg-type]
                for j, code in enumerate(happened)
                if code
            )
        command, transient, feedback, winding = self._answer
        return Output(command, STATES[state], transient, feedback, winding, events)
