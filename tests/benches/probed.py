"""The core looked into from tests: what a device has in it, and its own framing and check sums beside Python's."""

import ctypes
from collections.abc import Iterator
from typing import Any

from controller.firmware.core_device import Aligned, CoreDevice, core_library
from controller.protocol.capacity import Hardware
from controller.protocol.codes import EVENTS, NOTHING, STATES
from controller.protocol.packed import HASH_BYTES
from controller.protocol.wire import ENCODED_LIMIT, PAYLOAD_LIMIT
from controller.servo.interface import Fault, State


class Look(ctypes.Structure):
    """What a device has in it, beyond what it says: `td_probe_view` of replay/td_probe.h.

    Attributes
    ----------
    winding_C, housing_C : of the coil's model; 0 before there is a configuration with a coil.
    boot : number of this start.
    events : number of the next event.
    oldest_event : number of the first event that is not acknowledged; `events` if all are.
    arrived_bytes : of the image on its way.
    dropped_frames : sound ones that have arrived and were not for this session, out of order, or of no meaning.
    lost_frames : that found no room to go out.
    evidence : bits PULSE_SOUND and TRIAL_FINISHED.
    configuration_sha256, library_sha256 : zeros for what is not there.
    """

    _fields_ = (
        ("winding_C", ctypes.c_double),
        ("housing_C", ctypes.c_double),
        ("boot", ctypes.c_uint32),
        ("events", ctypes.c_uint32),
        ("oldest_event", ctypes.c_uint32),
        ("arrived_bytes", ctypes.c_uint32),
        ("dropped_frames", ctypes.c_uint32),
        ("lost_frames", ctypes.c_uint32),
        ("_state", ctypes.c_uint8),
        ("_fault", ctypes.c_uint8),
        ("evidence", ctypes.c_uint8),
        ("_configuration", ctypes.c_uint8 * HASH_BYTES),
        ("_library", ctypes.c_uint8 * HASH_BYTES),
    )
    winding_C: float
    housing_C: float
    boot: int
    events: int
    oldest_event: int
    arrived_bytes: int
    dropped_frames: int
    lost_frames: int
    evidence: int

    @property
    def state(self) -> State:
        return STATES[int(self._state)]

    @property
    def fault(self) -> Fault | None:
        """The first that tripped since the last reset."""
        return None if self._fault == NOTHING else EVENTS[self._fault]  # type: ignore[return-value]

    @property
    def configuration_sha256(self) -> bytes:
        return bytes(self._configuration)

    @property
    def library_sha256(self) -> bytes:
        return bytes(self._library)


def probe_library(flags: tuple[str, ...] = ()) -> ctypes.CDLL:
    """`core_library` with the types of the calls that look into it."""
    library = core_library(flags)
    pointer, size, number = ctypes.c_void_p, ctypes.c_size_t, ctypes.c_double
    for name in ("td_probe_decoder_size", "td_probe_decode", "td_wire_encode"):
        getattr(library, name).restype = size
    library.td_probe_decode.argtypes = [pointer, ctypes.c_char_p, size, pointer]
    library.td_probe_look.argtypes = [pointer, pointer]
    library.td_probe_image.argtypes = [pointer, pointer]
    library.td_probe_image.restype = pointer
    library.td_probe_enabled.argtypes, library.td_probe_enabled.restype = [pointer], ctypes.c_bool
    library.td_probe_coil.argtypes = [pointer, pointer]
    library.td_probe_heat.argtypes = [pointer, number, number]
    library.td_device_state.argtypes, library.td_device_state.restype = [pointer], ctypes.c_uint8
    library.td_decoder_start.argtypes = [pointer]
    library.td_wire_encode.argtypes = [ctypes.c_char_p, size, pointer]
    library.td_sha256_of.argtypes = [ctypes.c_char_p, size, pointer]
    library.td_crc32.argtypes = [ctypes.c_uint32, ctypes.c_char_p, size]
    library.td_crc32.restype = ctypes.c_uint32
    return library


def encode(payload: bytes) -> bytes:
    """`wire.encode` by the core."""
    frame = ctypes.create_string_buffer(ENCODED_LIMIT + 1)
    size = probe_library().td_wire_encode(payload, len(payload), frame)
    return frame.raw[:size]


def sha256(data: bytes) -> bytes:
    digest = ctypes.create_string_buffer(32)
    probe_library().td_sha256_of(data, len(data), digest)
    return digest.raw


def crc32(data: bytes) -> int:
    return int(probe_library().td_crc32(0, data, len(data)))


class Decoder:
    """`wire.Decoder` by the core."""

    def __init__(self) -> None:
        self._library = probe_library()
        self._decoder = Aligned(self._library.td_probe_decoder_size())
        self._library.td_decoder_start(self._decoder.at)

    def feed(self, data: bytes) -> list[bytes]:
        # A payload of a frame that began in an earlier piece may be longer than this piece.
        out = ctypes.create_string_buffer(2 * len(data) + PAYLOAD_LIMIT + 2)
        size = self._library.td_probe_decode(self._decoder.at, data, len(data), out)
        return list(_pieces(out.raw[:size]))


def _pieces(data: bytes) -> Iterator[bytes]:
    at = 0
    while at < len(data):
        size = int.from_bytes(data[at : at + 2], "little")
        yield data[at + 2 : at + 2 + size]
        at += 2 + size


class ProbedDevice(CoreDevice):
    """A device that can be looked into and heated."""

    def __init__(
        self, boot: int, hardware: Hardware | None = None, flags: tuple[str, ...] = (), **others: Any
    ) -> None:
        super().__init__(boot, hardware, flags, **others)
        probe_library(flags)

    @property
    def state(self) -> State:
        return STATES[int(self._library.td_device_state(self._device.at))]

    @property
    def enabled(self) -> bool:
        """Whether the amplifier may be on since the last step."""
        return bool(self._library.td_probe_enabled(self._device.at))

    def coil_C(self) -> tuple[float, float]:
        """Winding and housing as a port keeps them over a restart; NaN where the motor's coil is not known."""
        heat = (ctypes.c_double * 2)()
        self._library.td_probe_coil(self._device.at, heat)
        return heat[0], heat[1]

    def look(self) -> Look:
        """What is in it now."""
        view = Look()
        self._library.td_probe_look(self._device.at, ctypes.byref(view))
        return view

    def image(self) -> bytes:
        """The library in force as it was sent; empty without one."""
        size = ctypes.c_size_t()
        at = self._library.td_probe_image(self._device.at, ctypes.byref(size))
        return ctypes.string_at(at, size.value)

    def heat(self, winding_C: float, housing_C: float) -> None:
        """Make the coil so warm, as if much had been played."""
        self._library.td_probe_heat(self._device.at, winding_C, housing_C)
