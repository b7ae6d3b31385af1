"""Limits for a single tap, in place of those that a library was solved for."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from transopt.base.errors import InputError
from transopt.base.shown import cut
from transopt.base.units import largest, unit_of
from transopt.problem.limits import KINDS
from transopt.problem.limits.temperature import TemperatureLimit
from transopt.problem.posing import Posing

AMPLIFIER = "command_A"  # the amplifier's range; a scene states it for the amplifier and not among its limits
BY_KEY = {kind.key: kind for kind in KINDS if kind.key}
NAMES = (*BY_KEY, AMPLIFIER)


def with_limits(limits: Mapping[str, float], posing: Posing) -> Posing:
    """What the problems of a library share, with these limits in place of its own.

    Parameters
    ----------
    limits : keys of a scene's `limits`, and `command_A` for the amplifier's range. `temperature_C` is only checked
        here; it belongs to the coil, see `CoilModel.limit_C`.

    Raises
    ------
    InputError : a limit is unknown, not > 0 and finite, or needs a part that the library does not have.
    """
    for name, value in limits.items():
        if name not in NAMES:
            raise InputError(f"limits.{name}: unknown; known here: {', '.join(NAMES)}")
        number = value.item() if isinstance(value, np.number) else value
        if isinstance(number, bool) or not isinstance(number, int | float):
            raise InputError(f"limits.{name} = {cut(repr(value))}: must be a number > 0")
        unit = unit_of(name)
        if not 0 < number <= largest(unit):
            most = f"at most {largest(unit):g} {unit}".rstrip()
            raise InputError(
                f"limits.{name} = {cut(f'{number!r}'.removesuffix('.0'))}: must be > 0 and finite, {most}"
            )
    if AMPLIFIER in limits:
        if posing.amplifier is None:
            raise InputError("limits.command_A: the amplifier is ideal, its command is the current: give current_A")
        posing = replace(posing, amplifier=replace(posing.amplifier, command_limit=float(limits[AMPLIFIER])))
    for name in limits:
        kind = BY_KEY.get(name)
        if kind is None:
            continue
        lacks = (
            posing.coil is None if kind is TemperatureLimit else posing.circuit is None or posing.amplifier is None
        )
        if kind.asks_for and (lacks or not kind.concerns(posing.driven_by)):
            raise InputError(f"limits.{name}: needs {kind.asks_for}, which the library's scene does not state")
    asked = {name: float(value) for name, value in limits.items() if name in BY_KEY}
    return replace(posing, asked={**posing.asked, **asked})
