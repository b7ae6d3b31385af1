"""`Settings` as a device stores them: one table of float64 that holds the stated numbers only, none derived.

    header    magic u32, version u16, count u16
    values    count float64 in the order of NAMES

Whole numbers and flags (0 or 1) are float64 too. A part that does not exist has the flag 0 and zeros. Numbers derived
from these (decays of the amplifier, rows of the approach's fit, the coil's update) are computed at each end, by the
same formulas in the same order of operations. SHA-256 of the whole table is the configuration's hash.
"""

import struct
from dataclasses import fields

import numpy as np

from controller.servo.settings import PULSE_NODES, Settings
from transopt.plant.amplifier import Amplifier
from transopt.plant.coil import CoilModel
from transopt.plant.wall import Wall

CONFIGURATION_MAGIC = 0x46434E54  # "TNCF"
CONFIGURATION_VERSION = 3
HEADER = struct.Struct("<IHH")
# Optional parts: field of Settings -> type.
PARTS: dict[str, type] = {"amplifier": Amplifier, "wall": Wall, "coil": CoilModel}
# An amplifier may command voltages in general; that of a device commands currents, so its name has the unit A.
IN_AMPERES = {"amplifier_command_limit": "amplifier_command_limit_A"}
COMPILED_IN = ("coil_ripple_A",)  # a device always uses the seed's ripple; `on_a_device` allows for another one
OPTIONAL = ("slew_limit_A_per_s", "assumed_grip_N")
PREDICTION = ("pulse_grip_N", "pulse_acceleration", "pulse_path_m")  # over `pulse_nodes` grips
PLAIN = tuple(f.name for f in fields(Settings) if f.name not in (*PARTS, *OPTIONAL, *PREDICTION))


def numbers(settings: Settings) -> dict[str, float]:
    """Name -> number of the whole table, in order."""
    values = {name: float(getattr(settings, name)) for name in PLAIN}
    values["pulse_nodes"] = float(len(settings.pulse_grip_N))
    for name in PREDICTION:
        column = getattr(settings, name)
        values |= {f"{name}_{j}": float(column[j]) if j < len(column) else 0.0 for j in range(PULSE_NODES)}
    for name in OPTIONAL:
        value = getattr(settings, name)
        values[f"has_{name}"], values[name] = float(value is not None), 0.0 if value is None else float(value)
    for part, kind in PARTS.items():
        there = getattr(settings, part)
        values[f"has_{part}"] = float(there is not None)
        for field in fields(kind):
            name = f"{part}_{field.name}"
            if name in COMPILED_IN:
                continue
            values[IN_AMPERES.get(name, name)] = 0.0 if there is None else float(getattr(there, field.name))
    return values


NAMES = tuple(numbers(Settings(1e-4, 0.0, 1.0)))
CONFIGURATION_BYTES = HEADER.size + 8 * len(NAMES)


def configuration_of(settings: Settings) -> bytes:
    """The settings' bytes."""
    head = HEADER.pack(CONFIGURATION_MAGIC, CONFIGURATION_VERSION, len(NAMES))
    return head + np.array(list(numbers(settings).values()), dtype="<f8").tobytes()
