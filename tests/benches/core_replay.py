"""Recorded runs for the C core: what a Python servo was told and answered, and the same through the compiled core."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from controller.firmware.core_device import MOST_EVENTS, counts_of
from controller.firmware.core_servo import ARM, DISARM, EXCITE, GAIN, INPUT, NEGATIVE, OUTPUT, RESET, CoreServo
from controller.protocol.codes import EVENT_CODES, STATES
from controller.protocol.configuration import configuration_of
from controller.servo.interface import Output, Readings
from controller.servo.settings import Settings
from controller.waveforms.bank import Bank
from tests.benches.oracle.servo import Servo

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


class Core(CoreServo):
    """The compiled servo over whole runs."""

    def run(self, inputs: Rows) -> Rows:
        """Outputs of the ticks whose inputs these are; goes on where it left off."""
        rows, outputs = np.ascontiguousarray(inputs, dtype=INPUT), np.empty(inputs.size, dtype=OUTPUT)
        self._library.td_replay_run(self._at, rows.ctypes.data, rows.size, outputs.ctypes.data)
        return outputs


def write_runs(path: Path, runs: list[bytes]) -> None:
    """A file of runs for `replay_main.c`."""
    path.write_bytes(b"".join(runs))
