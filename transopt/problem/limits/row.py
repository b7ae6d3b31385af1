"""The rows by which a limit is stated.

A limit states rows `lower_k <= sum of coefficient * output + offset <= upper_k` at the switching instants tau_k. The
outputs are named outputs of the stage model, so a row does not depend on states, scaling or solver. The solvers'
stage data, the CasADi program, the feasibility program, the certificate and the replay all read the same rows.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from functools import lru_cache, reduce
from operator import add
from typing import Any

import numpy as np

from transopt.base.signals import FloatArray
from transopt.plant.discretise import PERIOD, Motion

# Outputs that every stage model has, all at the switching instant tau_k; it may name more (`StageModel.outputs`).
INPUT = "plant input"  # u(tau_k), a current [A] or a voltage [V]
COMMAND = "command"  # c_k, which acts from tau_k on, in the unit of the input
HELD = "held command"  # c_(k-1), which acts until tau_k
VELOCITY = "velocity"  # dy/dt of the motor mass [m/s]


@dataclass(frozen=True)
class Row:
    """One value along the horizon with a lower and an upper bound.

    Attributes
    ----------
    name : names its multipliers too, which a library stores as mu_<name>_lower and mu_<name>_upper.
    outputs : output -> its coefficient in the value.
    lower, upper : (N,) or one number for all instants; infinite where there is no bound.
    offset : (N,) or one number: the part of the value that does not depend on the command.
    condition : the case that the row covers, in words for reports, such as the copper's temperature; empty for none.
    device : index of the device, 0 for the entry's own.
    motor : index of the motor whose input, command and velocity are bounded; None for a plant with one motor.
    share : this motor's share of the limit; lower and upper include it.
    """

    name: str
    outputs: Mapping[str, float]
    lower: FloatArray | float
    upper: FloatArray | float
    offset: FloatArray | float = 0.0
    condition: str = ""
    device: int = 0
    motor: int | None = None
    share: float = 1.0

    def of_motor(self, motor: int, share: float = 1.0) -> "Row":
        """The row for one of several motors, with its own multipliers and its share of the bounds."""
        of_it = "" if share == 1 else f", which has {share:g} of it"
        said = f"{self.condition} of motor {motor + 1}{of_it}".lstrip()
        name, lower, upper = motor_row(self.name, motor), share * self.lower, share * self.upper
        return replace(self, name=name, lower=lower, upper=upper, condition=said, motor=motor, share=share)

    def of_device(self, device: int) -> "Row":
        """The row for a device of the spread, with its own multipliers; for device 0, the entry's, the row itself."""
        if device == 0:
            return self
        said = f"{self.condition} of device {device} of the spread".lstrip()
        return replace(self, name=device_row(self.name, device), condition=said, device=device)

    def value(self, motion: Motion, command: FloatArray) -> FloatArray:
        """(..., N) value under a command (..., N), or (..., m, N) with m motors, and its motion."""
        if self.motor is not None:
            motion, command = motion.of_motor(self.motor), command[..., self.motor, :]
        parts: list[Any] = [by * output_values(output, motion, command) for output, by in self.outputs.items()]
        if isinstance(self.offset, np.ndarray) or self.offset or not parts:
            parts.append(self.offset)
        return np.asarray(reduce(add, parts))

    def bounds(self, stages: int) -> tuple[FloatArray, FloatArray]:
        """(stages,) lower and (stages,) upper bound."""
        return _along(self.lower, stages), _along(self.upper, stages)

    def by_outputs(self, motion: Motion, command: FloatArray, gradient: FloatArray) -> dict[str, FloatArray]:
        """Output -> gradient (N,) by that output, for a gradient (N,) by the value."""
        return {output: coefficient * gradient for output, coefficient in self.outputs.items()}

    @property
    def linear(self) -> bool:
        """Whether the value is a linear combination of outputs."""
        return True

    def waits(self, *, ideal: bool) -> bool:
        """Whether the value of stage k does not depend on c_k; that of stage 0 then depends on no command.

        Parameters
        ----------
        ideal : whether the amplifier is, so that the plant's input is the command.
        """
        at_once = (COMMAND, INPUT) if ideal else (COMMAND,)
        return not any(name in at_once or name.endswith(PERIOD) for name in self.outputs)


def device_row(name: str, device: int) -> str:
    """Name of a row for a device of the spread; that of device 0 stays as it is."""
    return f"{name}_device_{device}" if device else name


def motor_row(name: str, motor: int) -> str:
    """Name of a row for one of several motors, counted from 1 in the name."""
    return f"{name}_motor_{motor + 1}"


def _along(value: FloatArray | float, stages: int) -> FloatArray:
    """(stages,) array of a number, or the array itself."""
    return value if isinstance(value, np.ndarray) else _constant(value, stages)


@lru_cache(maxsize=16)
def _constant(value: float, stages: int) -> FloatArray:
    constant = np.full(stages, value)
    constant.flags.writeable = False  # all callers share this array
    return constant


def output_values(name: str, motion: Motion, command: FloatArray) -> FloatArray:
    """(..., N) values of a named output under a command (..., N) and its motion."""
    if name == INPUT:
        return motion.plant_input
    if name == COMMAND:
        return command
    if name == HELD:
        held = np.zeros_like(command)
        held[..., 1:] = command[..., :-1]
        return held
    return motion.velocity_m_s if name == VELOCITY else motion.outputs[name]


def transposed(
    by_value: Iterable[tuple[Row, FloatArray]], motion: Motion, command: FloatArray, motors: int = 1
) -> tuple[Motion, FloatArray]:
    """Gradients by the motion and, directly, by the commands (..., N) for gradients (..., N) by the values of rows.

    Parameters
    ----------
    motion, command : point at which the gradients are taken; only nonlinear rows depend on it. With several motors
        the commands, and the gradient by them, are (..., m, N).
    """
    if motors > 1:
        return _transposed_by_motor(list(by_value), motion, command)
    by: dict[str, FloatArray] = {}
    nothing = np.zeros_like(command)
    for row, gradient in by_value:
        for output, part in row.by_outputs(motion, command, gradient).items():
            by[output] = by.get(output, nothing) + part
    by_command = by.pop(COMMAND, nothing)
    if (by_held := by.pop(HELD, None)) is not None:
        by_command = by_command.copy()
        by_command[..., :-1] += by_held[..., 1:]
    return Motion(nothing, by.pop(INPUT, nothing), by.pop(VELOCITY, nothing), nothing, by), by_command


def _transposed_by_motor(
    by_value: list[tuple[Row, FloatArray]], motion: Motion, command: FloatArray
) -> tuple[Motion, FloatArray]:
    parts = [
        transposed([each for each in by_value if each[0].motor == j], motion.of_motor(j), command[..., j, :])
        for j in range(command.shape[-2])
    ]
    inputs, velocities = (
        np.stack([getattr(of, name) for of, _ in parts], axis=-2) for name in ("plant_input", "velocity_m_s")
    )
    still = np.zeros_like(motion.acceleration_m_s2)
    return Motion(still, inputs, velocities, np.zeros(command.shape[-1])), np.stack([by for _, by in parts], axis=-2)
