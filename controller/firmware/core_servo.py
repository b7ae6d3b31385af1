"""The compiled servo alone, without the device and the link around it: readings in, command and events out."""

import ctypes
from collections.abc import Sequence

import numpy as np

from controller.firmware.core_device import MOST_EVENTS, Aligned, core_library, counts_of
from controller.protocol.codes import EVENTS, STATES
from controller.protocol.configuration import configuration_of
from controller.servo.interface import Event, Output, Readings
from controller.servo.settings import Settings
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


class CoreServo:
    """The core's servo under one configuration, with one image.

    Parameters
    ----------
    image : of the library it plays (`protocol.image`).
    flags : of the compiler; -DTD_REAL_FLOAT for single precision.

    Raises
    ------
    ValueError : the core refuses configuration or image.
    NoCompilerError : it can neither be compiled here nor was it when the package was built.
    """

    def __init__(self, settings: Settings, image: bytes, flags: tuple[str, ...] = ()) -> None:
        self._library, self._image = core_library(flags), image
        self._memory = Aligned(self._library.td_replay_size())
        self._at = self._memory.at
        configuration = configuration_of(settings)
        if not self._library.td_replay_start(self._at, configuration, len(configuration), image, len(image)):
            raise ValueError("the core refuses this configuration or image")
        self._in, self._out = np.zeros(1, dtype=INPUT), np.zeros(1, dtype=OUTPUT)
        self._wishes = 0

    def arm(self) -> None:
        """From IDLE, before the coming tick; in FAULT nothing happens."""
        self._wishes |= ARM

    def reset(self) -> None:
        """Out of FAULT to IDLE before the coming tick, and before it is armed, if no cause remains."""
        self._wishes |= RESET

    def step(self, readings: Readings) -> Output:
        """One servo period: the command that answers one tick's readings, to be held until the next tick.

        Speed and grip stand with the first of its events alone, its scale with none.
        """
        r = readings
        self._in[0] = (
            self._wishes,
            r.emergency_stop,
            0,
            counts_of(r.encoder_counts),
            0.0,
            r.grip_N,
            r.current_A,
            r.acceleration_m_s2,
        )
        self._wishes = 0
        self._library.td_replay_run(self._at, self._in.ctypes.data, 1, self._out.ctypes.data)
        command, transient, feedback, winding, speed, grip, state, _, events, what, _ = self._out[0].item()
        told = tuple(
            Event(r.tick, EVENTS[code], *((speed, grip) if j == 0 else ()))  # type: ignore[arg-type]
            for j, code in enumerate(what[:events])
        )
        return Output(command, STATES[state], transient, feedback, winding, told)

    def heat(self, current_A: Sequence[float] | FloatArray, every: int) -> FloatArray:
        """Let the coil alone pass ticks with these currents; its winding after each `every` of them [C]."""
        currents = np.ascontiguousarray(current_A, dtype=float)
        winding = np.empty(currents.size // every)
        self._library.td_replay_heat(self._at, currents.ctypes.data, currents.size, every, winding.ctypes.data)
        return winding

    def coil_C(self) -> tuple[float, float]:
        """Winding and housing as they are estimated."""
        heat = (ctypes.c_double * 2)()
        self._library.td_replay_coil(self._at, heat)
        return heat[0], heat[1]
