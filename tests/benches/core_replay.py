"""Recorded runs for the C core: what a Python servo was told and answered, and the same through the compiled core."""

import ctypes
import functools
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from controller.firmware.build import CORE, build, sources
from controller.firmware.core_device import MOST_EVENTS, REPLAY, counts_of
from controller.protocol.codes import EVENT_CODES, STATES
from controller.protocol.configuration import configuration_of
from controller.servo.interface import Output, Readings
from controller.servo.servo import Servo
from controller.servo.settings import Settings
from controller.waveforms.bank import Bank
from transopt.base.signals import FloatArray

RESET, DISARM, GAIN, ARM, EXCITE = 1, 2, 4, 8, 16  # wishes, carried out before a tick in this order
NEGATIVE = 32  # the excitation with the other sign
# Types as td_replay.h has them.
INPUT = np.dtype(
    [
        ("wishes", "u1"),
        ("emergency_stop", "u1"),
        ("zero", "<u2"),
        ("encoder_counts", "<i4"),
        ("gain", "<f8"),
        ("grip_N", "<f8"),
        ("current_A", "<f8"),
        ("acceleration_m_s2", "<f8"),
    ]
)
OUTPUT = np.dtype(
    [
        ("command_A", "<f8"),
        ("transient_A", "<f8"),
        ("feedback_A", "<f8"),
        ("winding_C", "<f8"),
        ("speed_m_s", "<f8"),
        ("grip_N", "<f8"),
        ("state", "u1"),
        ("answers", "u1"),
        ("events", "u1"),
        ("what", "u1", (MOST_EVENTS,)),
        ("zero", "u1", (7,)),
    ]
)
Rows = NDArray[Any]


@dataclass
class Recorder:
    """A servo whose inputs and outputs are kept.

    Attributes
    ----------
    image : of the bank it plays, which must be what `image.bank_of` makes of it.
    """

    settings: Settings
    table: Bank
    image: bytes
    servo: Servo = field(init=False)
    inputs: list[tuple[Any, ...]] = field(init=False, default_factory=list)
    outputs: list[tuple[Any, ...]] = field(init=False, default_factory=list)

    def __post_init__(self) -> None:
        self.servo = Servo(self.settings, self.table)

    def step(self, readings: Readings, wishes: int = 0, gain: float = 0.0) -> Output:
        """One tick, after what the host wishes."""
        servo, r, answers = self.servo, readings, 0
        if wishes & RESET and servo.reset():
            answers |= RESET
        if wishes & DISARM:
            servo.disarm()
        if wishes & GAIN:
            servo.set_gain(gain)
        if wishes & ARM and servo.arm():
            answers |= ARM
        if wishes & EXCITE and servo.excite(negative=bool(wishes & NEGATIVE)):
            answers |= EXCITE
        output = servo.step(readings)
        counts = counts_of(r.encoder_counts)
        self.inputs.append((wishes, r.emergency_stop, 0, counts, gain, r.grip_N, r.current_A, r.acceleration_m_s2))
        first = output.events[0] if output.events else None
        what = [EVENT_CODES[event.what] for event in output.events]
        self.outputs.append(
            (
                output.command_A,
                output.transient_A,
                output.feedback_A,
                output.winding_C,
                np.nan if first is None else first.speed_m_s,
                np.nan if first is None else first.grip_N,
                STATES.index(output.state),
                answers,
                len(what),
                tuple(what + [0] * (MOST_EVENTS - len(what))),
                (0,) * 7,
            )
        )
        return output

    def input_rows(self) -> Rows:
        return np.array(self.inputs, dtype=INPUT)

    def output_rows(self) -> Rows:
        return np.array(self.outputs, dtype=OUTPUT)

    def run_bytes(self) -> bytes:
        """The run as `replay_main.c` reads it."""
        configuration = configuration_of(self.settings)
        head = np.array([len(configuration), len(self.image), len(self.inputs)], dtype="<u4").tobytes()
        return head + configuration + self.image + self.input_rows().tobytes()


@functools.cache
def _library(flags: tuple[str, ...]) -> ctypes.CDLL:
    files = [*sources(CORE), REPLAY / "td_replay.c"]
    library = ctypes.CDLL(str(build("replay", files, flags=flags, shared=True)))
    library.td_replay_size.restype = ctypes.c_size_t
    library.td_replay_start.restype = ctypes.c_bool
    library.td_replay_start.argtypes = [
        ctypes.c_void_p,
        ctypes.c_char_p,
        ctypes.c_size_t,
        ctypes.c_char_p,
        ctypes.c_size_t,
    ]
    library.td_replay_run.argtypes = [ctypes.c_void_p, ctypes.c_void_p, ctypes.c_size_t, ctypes.c_void_p]
    library.td_replay_heat.argtypes = [
        ctypes.c_void_p,
        ctypes.c_void_p,
        ctypes.c_size_t,
        ctypes.c_size_t,
        ctypes.c_void_p,
    ]
    return library


class Core:
    """The compiled core with one configuration and one image; single precision with flag -DTD_REAL_FLOAT.

    Raises
    ------
    ValueError : the core refuses configuration or image.
    NoCompilerError : it cannot be compiled here.
    """

    def __init__(self, settings: Settings, image: bytes, flags: tuple[str, ...] = ()) -> None:
        self._library, self._image = _library(flags), image
        self._memory = ctypes.create_string_buffer(self._library.td_replay_size() + 16)
        self._at = (ctypes.addressof(self._memory) + 15) & ~15
        configuration = configuration_of(settings)
        given = (configuration, len(configuration), image, len(image))
        if not self._library.td_replay_start(self._at, *given):
            raise ValueError("the core refuses this configuration or image")

    def run(self, inputs: Rows) -> Rows:
        """Outputs of the ticks whose inputs these are; goes on where it left off."""
        rows, outputs = np.ascontiguousarray(inputs, dtype=INPUT), np.empty(inputs.size, dtype=OUTPUT)
        self._library.td_replay_run(self._at, rows.ctypes.data, rows.size, outputs.ctypes.data)
        return outputs

    def heat(self, size_A: FloatArray, every: int) -> FloatArray:
        """Winding temperatures after each `every` of the ticks with these currents [C]."""
        currents, winding = np.ascontiguousarray(size_A, dtype=float), np.empty(size_A.size // every)
        self._library.td_replay_heat(self._at, currents.ctypes.data, currents.size, every, winding.ctypes.data)
        return winding


def write_runs(path: Path, runs: list[bytes]) -> None:
    """A file of runs for `replay_main.c`."""
    path.write_bytes(b"".join(runs))
