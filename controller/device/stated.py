"""Fields of `controller.servo.settings.Settings` from a device file.

Thresholds of lengths and impulses scale with the encoder's count, and windows are times, so that servos of 1 to
20 kHz and encoders of 1 to 100 um behave alike.
"""

import math
from typing import Any

import numpy as np

from controller.device.device_file import DeviceFile
from controller.servo.settings import Settings
from transopt.base.errors import InputError
from transopt.library.library import Library

TOUCH_COUNTS = 4  # height in counts above which the surface is left: the size of a tremor
REARM_M, REARM_TOUCHES = Settings.rearm_height_m, 2.0  # heights that no trembling hand on the surface reaches
WINDOW_S = 10e-3  # part of the approach that the parabola is fitted to
LEAST_WINDOW = 6  # least readings in it, since a parabola has three coefficients
USUAL_COUNT_M = Settings.count_m


def servo_numbers(device: DeviceFile, dt_s: float) -> dict[str, Any]:
    """Fields of `Settings` that depend on the device only.

    Notes
    -----
    At the turning point of a tap, with acceleration a, the stylus stays within one count for 2 sqrt(2 count / a).
    The impulse that may pass there without a count, `stuck_A_s`, therefore grows with the root of the count.
    """
    encoder, grip, accelerometer, amplifier = device.encoder, device.grip, device.accelerometer, device.amplifier
    count_m = encoder.count_m
    touch_m = TOUCH_COUNTS * count_m
    coarse = max(1.0, math.sqrt(count_m / USUAL_COUNT_M))
    return {
        "count_m": count_m,
        "surface_counts": encoder.surface_counts,
        "encoder_direction": encoder.direction,
        "acceleration_scale": accelerometer.scale,
        "acceleration_rest_m_s2": accelerometer.rest_m_s2,
        "has_accelerometer": accelerometer.sensor,
        "grip_scale": grip.scale,
        "grip_zero_N": grip.zero_N,
        "monitor_scale": amplifier.monitor_scale,
        "amplifier_scale": amplifier.scale,
        "touch_height_m": touch_m,
        "rearm_height_m": max(REARM_M, REARM_TOUCHES * touch_m),
        "window_ticks": max(round(WINDOW_S / dt_s), LEAST_WINDOW),
        "stuck_A_s": coarse * Settings.stuck_A_s,
    }


def assumed_grip_N(device: DeviceFile, grips_N: Any) -> float | None:
    """The grip assumed without a sensor, clipped to the range of a library's grips; None with a sensor.

    Parameters
    ----------
    grips_N : (n,) nodes of a library, or empty.
    """
    nodes = np.asarray(grips_N, dtype=float)
    if nodes.size and nodes[0] == 0:
        return 0.0  # a library of the free device, which nobody holds
    if device.grip.sensor:
        return None
    assumed = device.grip.assumed_grip_N
    return float(np.clip(assumed, nodes[0], nodes[-1])) if nodes.size else assumed


def library_numbers(device: DeviceFile, library: Library) -> dict[str, Any]:
    """Fields of `Settings` for a library on this device, which override those of the library.

    Raises
    ------
    InputError : the library is for another servo period, or needs more current than the hardware allows.
    """
    dt_s, limits = library.dt_s, library.posing().asked
    if device.servo.dt_s is not None and abs(device.servo.dt_s / dt_s - 1) > 1e-6:
        raise InputError(
            f"device file: servo.dt_s = {device.servo.dt_s:g}, the library is for {dt_s:g} s: solve it with "
            f"time.dt_s = {device.servo.dt_s:g}, or correct the device file"
        )
    stated_A, part = device.hardware.current_A, device.amplifier.part
    if stated_A is not None and limits["current_A"] > stated_A * part * (1 + 1e-9):
        scaled = "" if part == 1 else f", amplifier.scale = {device.amplifier.scale:g}"
        raise InputError(
            f"library: up to {limits['current_A']:g} A, device file: hardware.current_A = {stated_A:g}{scaled}: "
            f"solve it with limits.current_A = {stated_A * part:g}, or correct the device file"
        )
    numbers = servo_numbers(device, dt_s)
    assumed = assumed_grip_N(device, library.grips_N)
    if assumed is not None:
        numbers["assumed_grip_N"] = assumed
    return numbers


def grip_in_words(device: DeviceFile, library: Library) -> str:
    """A sentence on the grip that a library is played for on a device without a grip sensor; empty with a sensor."""
    nodes = library.grips_N
    if device.grip.sensor or nodes[0] == 0:
        return ""
    taken, asked = assumed_grip_N(device, nodes), device.grip.assumed_grip_N
    words = f"no grip sensor: every tap is played for {taken:g} N"
    if taken != asked:
        words += f", the nearest to {asked:g} N that the library has ({nodes[0]:g} to {nodes[-1]:g} N)"
    return words
