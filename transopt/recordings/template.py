"""A recording to fill in: remarks, names with units, and an invented tap in place of the user's own."""

import numpy as np

from transopt.base.signals import STANDARD_GRAVITY_M_S2

RATE_HZ = 10_000
BEFORE_S, AFTER_S = 0.05, 0.1  # before and after contact: enough to find speed, offset and ringing
SPEED_M_S, PULSE_S = 0.2, 4e-3
BACK = 0.2  # of the incoming speed: speed with which the stylus is thrown back
REMARKS = """\
# One tap on a real object, for `transopt taps` and `transopt solve`. Lines with # are remarks, but for these two:
# speed_m_s: {speed:g}
# grip_N: 3
# The first is the incoming speed. With position_m recorded it may be left out; without an encoder state it, and leave
# the column position_m out. The second is the grip force; leave it out where nobody measured it.
# Columns in any order, each with its unit: time_s or time_ms, acceleration_g or acceleration_m_s2, position_m or
# position_mm, force_N, current_A. Time and acceleration are needed. The rows below are an invented tap: put yours
# in their place.
"""


def template() -> str:
    """Text of a CSV file that can be read unchanged: a half sine of 4 ms between an approach and a return."""
    t = np.arange(round((BEFORE_S + AFTER_S) * RATE_HZ)) / RATE_HZ - BEFORE_S
    touching = np.clip(t / PULSE_S, 0.0, 1.0)
    peak = (1 + BACK) * SPEED_M_S * np.pi / (2 * PULSE_S)
    # z is the double integral of a from the approach on; the sensor reads +1 g where its axis points up.
    a = np.where((t > 0) & (t < PULSE_S), peak * np.sin(np.pi * touching), 0.0)
    swing = PULSE_S / np.pi * (touching * PULSE_S - PULSE_S / np.pi * np.sin(np.pi * touching))
    z = -SPEED_M_S * t + peak * (swing + 2 * PULSE_S / np.pi * np.maximum(t - PULSE_S, 0.0))
    rows = (f"{s:.4f},{x / STANDARD_GRAVITY_M_S2 + 1:.4f},{y:.7f}" for s, x, y in zip(t, a, z, strict=True))
    return "\n".join([REMARKS.format(speed=SPEED_M_S) + "time_s,acceleration_g,position_m", *rows, ""])
