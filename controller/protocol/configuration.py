"""`Settings` as a device stores them: one table of float64, and next to them what follows from them.

    header    magic u32, version u16, count u16
    values    count float64 in the order of NAMES

Whole numbers and flags (0 or 1) are float64 as well. What does not exist is 0 behind a flag of 0. The derived numbers
are read from a servo built of the same settings: a C core needs neither exp() nor linear algebra, and every one that
uses them gets the same bits. SHA-256 of the whole is the configuration's hash.
"""

import struct
from dataclasses import fields

import numpy as np

from controller.servo.servo import Servo
from controller.servo.settings import Settings
from controller.waveforms.bank import Bank, Method
from transopt.plant.amplifier import Amplifier
from transopt.plant.coil import CoilModel
from transopt.plant.wall import Wall

CONFIGURATION_MAGIC = 0x46434E54  # "TNCF"
CONFIGURATION_VERSION = 2
HEADER = struct.Struct("<IHH")
# Parts that a device may lack, by the field of Settings they stand in.
PARTS: dict[str, type] = {"amplifier": Amplifier, "wall": Wall, "coil": CoilModel}
OPTIONAL = ("slew_limit_A_per_s", "assumed_grip_N")
PLAIN = tuple(f.name for f in fields(Settings) if f.name not in PARTS and f.name not in OPTIONAL)
EMPTY = Bank(Method.BILINEAR, [1.0], [1.0], np.zeros((1, 1, 1)), [[0.0]], [[0.0]], 0.0, True, False)


def stated_numbers(settings: Settings) -> dict[str, float]:
    """The first part of the table, by name: the settings as they are."""
    values = {name: float(getattr(settings, name)) for name in PLAIN}
    for name in OPTIONAL:
        value = getattr(settings, name)
        values[f"has_{name}"], values[name] = float(value is not None), 0.0 if value is None else float(value)
    for part, kind in PARTS.items():
        there = getattr(settings, part)
        values[f"has_{part}"] = float(there is not None)
        for field in fields(kind):
            values[f"{part}_{field.name}"] = 0.0 if there is None else float(getattr(there, field.name))
    return values


def _derived(settings: Settings) -> dict[str, float]:
    """As the servo has computed them, not computed a second time."""
    servo = Servo(settings, EMPTY)
    watch, approach, trigger, guard = servo.watch, servo.approach, servo._trigger, servo.guard
    values = {
        "command_limit_A": settings.command_limit_A,
        "decay": servo._decay,
        "decay_fast": servo._fast,
        "decay_slow": servo._slow,
        "prefilter_now": servo._now,
        "prefilter_before": servo._before,
        "slew_A": 0.0 if servo._slew_A is None else servo._slew_A,
        "gain_step": servo._gain_step,
        "velocity_smoothing": servo._smoothing,
        "rearm_ticks": trigger._rearm_ticks,
        "over_current_A": watch.over_current_A,
        "no_current_ticks": watch.missing_limit,
        "stuck_ticks": watch.still_limit,
        "encoder_rate_m_s": watch._rate_m_s,
        "grip_new_part": watch._new_grip,
        "approach_rate_m_s": approach._m_s,
        **{f"approach_value_{j}": value for j, value in enumerate(approach._value)},
        **{f"approach_slope_{j}": slope for j, slope in enumerate(approach._slope)},
    }
    for name, attribute in GUARD.items():
        values[f"guard_{name}"] = 0.0 if guard is None else getattr(guard, attribute)
    return {name: float(value) for name, value in values.items()}


GUARD = {
    "ticks": "_ticks",
    "by_w": "_by_w",
    "a11": "_a11",
    "a12": "_a12",
    "a21": "_a21",
    "a22": "_a22",
    "inflow_C": "_inflow_C",
    "cold": "_cold",
    "rise_K": "_rise_K",
    "from_housing": "_from_housing",
    "limit_C": "limit_C",
    "play_limit_C": "play_limit_C",
}


def numbers(settings: Settings) -> dict[str, float]:
    """Every number of the table, by name and in order."""
    return {**stated_numbers(settings), **_derived(settings)}


NAMES = tuple(numbers(Settings(1e-4, 0.0, 1.0)))
CONFIGURATION_BYTES = HEADER.size + 8 * len(NAMES)


def configuration_of(settings: Settings) -> bytes:
    """The settings' bytes."""
    head = HEADER.pack(CONFIGURATION_MAGIC, CONFIGURATION_VERSION, len(NAMES))
    return head + np.array(list(numbers(settings).values()), dtype="<f8").tobytes()
