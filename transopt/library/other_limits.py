"""Limits of a single tap in place of those that a library was solved for."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from transopt.base.errors import InputError
from transopt.plant.circuit import Circuit
from transopt.problem.posing import Posing

CURRENT = ("current_A", "command_A", "slew_A_per_s")  # of the drive: fields of `Limits`
NAMES = (*CURRENT, "supply_V", "temperature_C")


def with_limits(limits: Mapping[str, float], posing: Posing, meta: dict[str, Any]) -> Posing:
    """What the problems of a library share, with these limits in place of its own.

    Parameters
    ----------
    limits : some of `current_A`, `command_A`, `slew_A_per_s`, `supply_V` and `temperature_C`. The last one is checked
        here and is the coil's, see `CoilModel.limit_C`.
    meta : of the library, which knows the motor's circuit even where no supply limits it.

    Raises
    ------
    InputError : an unknown limit, one that is not > 0 and finite, or one of a part that the library does not have.
    """
    for name, value in limits.items():
        if name not in NAMES:
            raise InputError(f"limits.{name}: unknown; known here: {', '.join(NAMES)}")
        if isinstance(value, bool) or not isinstance(value, int | float | np.number):
            raise InputError(f"limits.{name} = {value!r}: must be a number > 0")
        if not 0 < value < np.inf:
            raise InputError(f"limits.{name} = {value:g}: must be > 0 and finite")
    if "command_A" in limits and posing.amplifier is None:
        raise InputError("limits.command_A: the amplifier is ideal, its command is the current: give current_A")
    own = {name: float(limits[name]) for name in CURRENT if name in limits}
    posing = replace(posing, limits=replace(posing.limits, **own))
    if "supply_V" in limits:
        if meta["circuit"] is None or posing.amplifier is None:
            raise InputError(
                "limits.supply_V: needs the motor's circuit and an amplifier with a pole, which the library's scene "
                "does not state"
            )
        if meta["weights"]["spread"] is not None:
            raise InputError("limits.supply_V: depends on the motion of one device, and the library serves a spread")
        posing = replace(posing, supply=(float(limits["supply_V"]), Circuit(**meta["circuit"])))
    if "temperature_C" in limits and meta["thermal"] is None:
        raise InputError("limits.temperature_C: the library's scene states no motor, whose winding it would be")
    return posing
