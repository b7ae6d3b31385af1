"""The servo of a library, compiled; and what a device is given: settings, smooth pulses, a plant in a hand."""

from dataclasses import replace
from typing import Any

import numpy as np

from controller.firmware.core_servo import CoreServo
from controller.host.payload import payload_of
from controller.servo.settings import Settings
from controller.sim.plant_file import plant_bytes
from controller.sim.simulator import Simulator
from controller.sim.true_device import DEFAULT_DEVICE
from controller.sim.user import User
from controller.waveforms.bank import Bank, Method
from transopt.library.library import Library
from transopt.problem.warm_coil import currents, norms

DT_S = 1e-4
TAIL = 10  # zero commands at the end of every waveform
SETTINGS = Settings(DT_S, 3 * DT_S, 4.0, DEFAULT_DEVICE.amplifier)


def servo_of(library: Library, table: Bank | None = None, **settings: Any) -> CoreServo:
    """The servo that a device has with this library, or with waveforms of another method.

    Parameters
    ----------
    settings : other ones than by library and device, see `Settings`.
    """
    given = payload_of(library, table, **settings)
    return CoreServo(given.settings, given.image)


def plant_of(user: User, period_s: float) -> bytes:
    """The default device in the hand of a user whose motion has this period, a whole number of ticks."""
    return plant_bytes(Simulator(DEFAULT_DEVICE, user, DT_S), user, period_s)


def cooled(bank: Bank, share: float = 0.5) -> Bank:
    """A table whose cool commands are this share of the first ones, and a little later."""
    command = share * (0.9 * bank.command_A + 0.1 * np.roll(bank.command_A, 2, axis=-1))
    command[..., -TAIL:] = 0.0
    transient = norms(currents(command, SETTINGS.amplifier, DT_S), SETTINGS.amplifier, DT_S)
    return replace(bank, cool_command_A=command, cool_transient_A=transient.tolist())


def smooth_bank(speeds: int = 2, grips: int = 2, samples: int = 60, peak_A: float = 1.0) -> Bank:
    """Smooth pulses from 0.1 to 0.4 m/s and 1 to 5 N, the larger the faster and firmer."""
    shape = np.zeros(samples)
    pulse = samples - TAIL
    shape[:pulse] = np.sin(np.linspace(0, 3 * np.pi, pulse)) * np.linspace(1, 0.2, pulse)
    size = np.linspace(0.5, 1.0, speeds * grips).reshape(speeds, grips, 1)
    command = peak_A * size * shape
    transient = norms(currents(command, SETTINGS.amplifier, DT_S), SETTINGS.amplifier, DT_S)
    return Bank(
        method=Method.BILINEAR,
        speeds_m_s=np.linspace(0.1, 0.4, speeds).tolist() if speeds > 1 else [0.2],
        grips_N=np.linspace(1.0, 5.0, grips).tolist() if grips > 1 else [3.0],
        command_A=command,
        transient_A=transient.tolist(),
        feedback_A=(0.0 * transient).tolist(),
        grip_min_N=0.5,
        by_grip=True,
        nearest=False,
    )
