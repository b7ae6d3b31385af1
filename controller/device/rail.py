"""Readings at an end of the accelerometer's range, which say nothing of how large the acceleration was.

A port reads an input at a rail of its converter as no number (NaN). A sensor whose own range ends before the
converter's stands still there instead, at a value that looks like a reading.
"""

import math

import numpy as np

from controller.device.device_file import Accelerometer, DeviceFile
from controller.waveforms.prediction import predict
from transopt.base.signals import STANDARD_GRAVITY_M_S2, BoolArray, FloatArray, stops
from transopt.library.library import Library

RAIL_PART = 0.98  # part of the stated range from which on a reading counts as at its end: a scale may be 2 % off


def at_rail(acceleration_m_s2: FloatArray, accelerometer: Accelerometer) -> BoolArray:
    """(n,) whether each reading lies at an end of the range.

    No number does, and a reading within 2 % of `range_g`. Where no range is stated, so do the readings that stand
    still at the common extreme.

    Parameters
    ----------
    acceleration_m_s2 : (n,) as the device has calibrated it.
    """
    numbers = np.isfinite(acceleration_m_s2)
    if accelerometer.range_g is not None:
        read_m_s2 = (acceleration_m_s2 + accelerometer.rest_m_s2) / accelerometer.scale
        return ~(np.abs(read_m_s2) < RAIL_PART * accelerometer.range_g * STANDARD_GRAVITY_M_S2)
    found = ~numbers
    if numbers.any():
        places, values = np.flatnonzero(numbers), acceleration_m_s2[numbers]
        for stuck in stops(values):
            found[places[stuck]] = True
    return found


def why_at_rail(
    times_s: FloatArray, acceleration_m_s2: FloatArray, accelerometer: Accelerometer, library: Library | None = None
) -> str:
    """Reason why the readings of a tap do not count; empty if all of them lie within the accelerometer's range.

    Parameters
    ----------
    times_s, acceleration_m_s2 : (n,) from contact; the readings as the device has calibrated them.
    library : the one that was played, which tells the range that its taps need; None for a real object.
    """
    found = np.flatnonzero(at_rail(acceleration_m_s2, accelerometer))
    if not found.size:
        return ""
    first, range_g = found[0], accelerometer.range_g
    least_g = math.inf if library is None else needed_range_g(library, accelerometer)
    needed = "a wider range" if library is None else f"a range of {least_g} g or more"
    why = f"the accelerometer was at its rail at {1e3 * times_s[first]:.1f} ms"
    if range_g is not None and least_g <= range_g:
        return (
            f"{why}, though its range of {range_g:g} g holds every tap of this library: check its cable, and that "
            "the stylus meets nothing where the surface is played"
        )
    if range_g is None and np.isfinite(acceleration_m_s2[first]):
        stood = (acceleration_m_s2[first] + accelerometer.rest_m_s2) / STANDARD_GRAVITY_M_S2
        why = f"the accelerometer stood still at {stood:+.3g} g from {1e3 * times_s[first]:.1f} ms on"
        return f"{why}, as at the end of its range: use {needed}, or state accelerometer.range_g"
    return f"{why}: use one with {needed}"


def needed_range_g(library: Library, accelerometer: Accelerometer) -> int:
    """Least range [g] with which every tap of a library is read, by its predictions and the reading at rest."""
    nodes = [(float(speed), float(grip)) for speed in library.speeds_m_s for grip in library.grips_N]
    peak_m_s2 = max(float(np.abs(predict(library, *node).whole_m_s2).max()) for node in nodes)
    return math.ceil((peak_m_s2 + abs(accelerometer.rest_m_s2)) / RAIL_PART / STANDARD_GRAVITY_M_S2)


def range_in_words(device: DeviceFile, library: Library) -> str:
    """A sentence on taps of a library that go beyond the stated range of the accelerometer; empty if none does."""
    stated = device.accelerometer
    if not stated.sensor or stated.range_g is None:
        return ""
    needed = needed_range_g(library, stated)
    if needed <= stated.range_g:
        return ""
    return (
        f"accelerometer.range_g = {stated.range_g:g}: the taps of this library take {needed} g; one that goes beyond "
        "the range is played, and does not count"
    )
