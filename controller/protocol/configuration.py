"""`Settings` as a device stores them: one table of float64, and next to them what follows from them.

    header    magic u32, version u16, count u16
    values    count float64 in the order of NAMES

Whole numbers and flags (0 or 1) are float64 as well. What does not exist is 0 behind a flag of 0. The derived numbers
are read from a servo built of the same settings: a C core needs neither exp() nor linear algebra, and every one that
uses them gets the same bits. SHA-256 of the whole is the configuration's hash.
"""

import hashlib
import math
import struct
from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any

import numpy as np
from scipy import signal

from controller.protocol.capacity import ENCODER_MOST_COUNTS, LONGEST_S, Capacity, Hardware
from controller.protocol.codes import Reason
from controller.servo.servo import Servo
from controller.servo.settings import Settings
from controller.waveforms.bank import Bank, Method
from transopt.base.errors import InputError
from transopt.base.signals import FloatArray
from transopt.plant.amplifier import Amplifier
from transopt.plant.coil import CoilModel
from transopt.plant.wall import Wall

CONFIGURATION_MAGIC = 0x46434E54  # "TNCF"
CONFIGURATION_VERSION = 2
HEADER = struct.Struct("<IHH")
AGREEMENT = 1e-9  # relative: two libraries' exp() and inverses differ by less, two sets of settings by more
# Parts that a device may lack, by the field of Settings they stand in.
PARTS: dict[str, type] = {"amplifier": Amplifier, "wall": Wall, "coil": CoilModel}
FLAGS = ("host_starts",)
OPTIONAL = ("slew_limit_A_per_s", "assumed_grip_N")
WHOLE = ("window_ticks", "encoder_limit_counts", "latency_ticks", "nodes")
WHOLE_NAMES = ("window_ticks", "encoder_limit_counts", "wall_latency_ticks", "coil_nodes")  # in the table
PLAIN = tuple(f.name for f in fields(Settings) if f.name not in PARTS and f.name not in OPTIONAL)
EMPTY = Bank(Method.BILINEAR, [1.0], [1.0], np.zeros((1, 1, 1)), [[0.0]], [[0.0]], 0.0, True, False)


class ConfigurationError(ValueError):
    """Settings that may not be used; `value` is the number that offends, NaN if there is none."""

    def __init__(self, reason: Reason, value: float = np.nan) -> None:
        super().__init__(f"{reason.value} ({value:g})")
        self.reason, self.value = reason, value


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


@dataclass(frozen=True)
class Configuration:
    """Settings as they came over the wire, with the hash of their bytes."""

    settings: Settings
    sha256: bytes

    @cached_property
    def decay(self) -> float:
        amplifier = self.settings.amplifier
        return 0.0 if amplifier is None else math.exp(-amplifier.rate_rad_s * self.settings.dt_s)

    def currents(self, command_A: FloatArray) -> FloatArray:
        """(..., N) currents at the switching instants that commands (..., N) make from rest."""
        return np.asarray(signal.lfilter([1 - self.decay], [1.0, -self.decay], command_A, axis=-1))


def _values(data: bytes) -> dict[str, float]:
    """The table's numbers, each one a number of its kind."""
    head = HEADER.unpack_from(data) if len(data) == CONFIGURATION_BYTES else None
    if head != (CONFIGURATION_MAGIC, CONFIGURATION_VERSION, len(NAMES)):
        raise ConfigurationError(Reason.BAD_FORMAT, len(data))
    values = dict(zip(NAMES, np.frombuffer(data, dtype="<f8", offset=HEADER.size).tolist(), strict=True))
    for name, value in values.items():
        flag, whole = name.startswith("has_") or name in FLAGS, name in WHOLE_NAMES
        if not np.isfinite(value) or (flag and value not in (0.0, 1.0)) or (whole and not value.is_integer()):
            raise ConfigurationError(Reason.BAD_VALUE, value)
    return values


def _settings(values: dict[str, float]) -> Settings:
    """The stated numbers as settings, if they hold."""

    def number(name: str, value: float) -> float | int | bool:
        return int(value) if name in WHOLE else bool(value) if name in FLAGS else value

    arguments: dict[str, Any] = {name: number(name, values[name]) for name in PLAIN}
    for name in OPTIONAL:
        arguments[name] = values[name] if values[f"has_{name}"] else None
    try:
        for part, kind in PARTS.items():
            given = {f.name: number(f.name, values[f"{part}_{f.name}"]) for f in fields(kind)}
            arguments[part] = kind(**given) if values[f"has_{part}"] else None
        settings = Settings(**arguments)
    except InputError as error:
        raise ConfigurationError(Reason.BAD_CONFIGURATION) from error
    a = settings.amplifier
    if a is not None and not (a.pole_Hz > 0 and a.delay_s >= 0 and a.command_limit_A > 0):
        raise ConfigurationError(Reason.BAD_CONFIGURATION)
    return settings


def _compare(values: dict[str, float], settings: Settings) -> None:
    """Whether the whole table is what a host makes of these settings."""
    try:
        with np.errstate(all="ignore"):
            again = np.array(list(numbers(settings).values()))
    except (ArithmeticError, np.linalg.LinAlgError) as error:
        raise ConfigurationError(Reason.BAD_CONFIGURATION) from error
    if not np.all(np.isfinite(again)):
        raise ConfigurationError(Reason.BAD_CONFIGURATION)
    came = np.array(list(values.values()))
    with np.errstate(over="ignore"):
        off = ~(np.abs(came - again) <= AGREEMENT * np.abs(again))
    if np.any(off):
        raise ConfigurationError(Reason.BAD_CONFIGURATION, float(came[off][0]))


def accept(data: bytes, capacity: Capacity, hardware: Hardware) -> Configuration:
    """What CONFIGURE_COMMIT asks before a configuration is in force.

    Raises
    ------
    ConfigurationError : not a configuration of this version; settings that are refused; derived numbers that do not
        follow from the stated ones; more than this device can do.
    """
    values = _values(data)
    settings = _settings(values)
    # Before anything is made that could be too large to be made.
    if settings.dt_s != hardware.dt_s:
        raise ConfigurationError(Reason.BAD_TIMING, settings.dt_s)
    asked = (
        (settings.window_ticks, capacity.approach_ticks),
        (settings.encoder_limit_counts, ENCODER_MOST_COUNTS),
        (0 if settings.wall is None else settings.wall.latency_ticks, capacity.latency_ticks),
        (settings.rearm_s, LONGEST_S),
        (settings.no_current_s, LONGEST_S),
        (settings.stuck_s, LONGEST_S),
        (settings.current_limit_A, hardware.current_A),
        (settings.command_limit_A, hardware.command_A),
    )
    for value, most in asked:
        if not value <= most:
            raise ConfigurationError(Reason.BEYOND_HARDWARE, value)
    _compare(values, settings)
    return Configuration(settings, hashlib.sha256(data).digest())
