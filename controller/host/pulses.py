"""Response of a held stylus to small pulses of current, predicted by a library's model or measured.

A pulse of 0.1 A is felt as a tremble and is harmless with either sign. Two quantities are compared: the current over
the second half of the pulse, when the amplifier has settled, and the mean acceleration over the first 5 ms, before
the hand's springs push back; it depends on the motor's force and on the masses, and little on the grip.
"""

from typing import Any

import numpy as np

from controller.device.device_file import DeviceFile
from controller.record.played import through_pole
from controller.servo.settings import PULSE_NODES, Settings
from transopt.base.errors import InputError
from transopt.library.library import Library
from transopt.plant.discretise import discretise

FINER = 20  # steps of the simulation per servo period
SINGLE_PRECISION = 1e-6  # relative; above the rounding of a float32
PULSE_A = 0.1
# If there is an accelerometer, a pulse is only as long as the acceleration and the settled current need; the encoder
# has been compared with the accelerometer before. Without one the path must be long and averaged over more pulses,
# since a hand's tremor is as large.
PULSE_S, PAIRS = 10e-3, 8
BLIND_PULSE_S, BLIND_PAIRS = 20e-3, 30
NO_PATH_M = 1e-9  # path per ampere that turns off its judgement, since it is shorter than five counts of any encoder


def pairs_of(device: DeviceFile) -> int:
    """Number of pairs of pulses that averages out a hand's tremor."""
    return PAIRS if device.accelerometer.sensor else BLIND_PAIRS


def most_pulse_A(device: DeviceFile) -> float:
    """Largest test pulse within the hardware's limit, both as a current and as the command to the amplifier."""
    scale = abs(device.amplifier.scale)
    # The device stores the scale in single precision, and its limit is exact.
    return min(device.hardware.pulse_A or PULSE_A, PULSE_A) * (1.0 if scale >= 1 else scale * (1 - SINGLE_PRECISION))


def pulse_numbers(device: DeviceFile, library: Library) -> dict[str, Any]:
    """Fields of `Settings`: the test pulse, and its response predicted by the library's model at up to four grips.

    The motion is exact, from rest, and filtered by the accelerometer's pole.

    Raises
    ------
    InputError : the model has the wrong sign.
    """
    dt_s = library.dt_s
    sensed = device.accelerometer.sensor
    ticks = round((PULSE_S if sensed else BLIND_PULSE_S) / dt_s)
    asked = Settings.of(library, pulse_A=min(most_pulse_A(device), library.input_limit), pulse_ticks=ticks)
    grips = library.grips_N
    nodes = grips if grips.size <= PULSE_NODES else np.linspace(grips[0], grips[-1], PULSE_NODES)
    found = [_pushed(library, asked, float(grip_N), device.accelerometer.bandwidth_Hz) for grip_N in nodes]
    return {
        "pulse_A": asked.pulse_A,
        "pulse_ticks": ticks,
        "pulse_grip_N": tuple(map(float, nodes)),
        "pulse_acceleration": tuple(acceleration for acceleration, _ in found),
        "pulse_path_m": tuple(NO_PATH_M if sensed else max(path, NO_PATH_M) for _, path in found),
    }


def measured_numbers(device: DeviceFile, dt_s: float, acceleration_m_s2: float) -> dict[str, Any]:
    """Fields of `Settings` for a device without a model: the measured acceleration per ampere, for any grip."""
    return {
        "pulse_A": most_pulse_A(device),
        "pulse_ticks": round(PULSE_S / dt_s),
        "pulse_grip_N": (0.0,),
        "pulse_acceleration": (acceleration_m_s2,),
        "pulse_path_m": (NO_PATH_M,),
    }


def _pushed(library: Library, s: Settings, grip_N: float, accelerometer_Hz: float) -> tuple[float, float]:
    """Response per ampere: mean acceleration over the compared readings, and encoder's path at the pulse's end."""
    dt_s, amplifier, duration_s = s.dt_s, s.amplifier, s.pulse_ticks * s.dt_s
    delay_s = 0.0 if amplifier is None else amplifier.delay_s
    fine_s = dt_s / FINER
    plant = library.scene().plant(grip_N)
    steps = round((duration_s + delay_s + dt_s) / fine_s)
    command = np.ones(steps)
    command[round(duration_s / fine_s) :] = 0.0
    motion = discretise(plant, amplifier, fine_s, position=True).motion(command)
    times = delay_s + fine_s * np.arange(steps)
    felt = through_pole(motion.acceleration_m_s2, fine_s, accelerometer_Hz)
    ticks = dt_s * np.arange(s.pulse_skip_ticks, s.pulse_skip_ticks + s.pulse_push_ticks)
    acceleration = float(np.interp(ticks, times, felt, left=0.0).mean())
    if not acceleration > 0:
        raise InputError(
            f"library: at {grip_N:g} N its model goes inwards by a current outwards: check its sign, and identify "
            "the device anew"
        )
    return acceleration, float(np.interp(duration_s, times, motion.encoder_m, left=0.0))
