"""The limits of the optimal-control problem, one file each, all of the interface in `limit`.

`KINDS` is the one list of them: scene keys, multipliers, the arrays of a library, columns of reports and studies
follow from it.
"""

from collections.abc import Iterable, Mapping
from typing import Any

from transopt.problem.limits.command import CommandLimit
from transopt.problem.limits.current import CurrentLimit
from transopt.problem.limits.limit import Limit, Limits, Setting
from transopt.problem.limits.slew import SlewLimit
from transopt.problem.limits.supply import SupplyLimit
from transopt.problem.limits.temperature import TemperatureLimit

KINDS: tuple[type[Limit], ...] = (
    CurrentLimit,
    CommandLimit,
    SlewLimit,
    SupplyLimit,
    TemperatureLimit,
)


def posed(asked: Mapping[str, Any], setting: Setting) -> Limits:
    """The limits of one tap: what a scene asks for, each made by its own kind.

    Parameters
    ----------
    asked : key below the scene's `limits` -> number, or None where it is not asked for.

    Raises
    ------
    InputError : a number that is no limit.
    """
    made = (kind.posed(asked, setting) for kind in KINDS)
    return Limits(tuple(limit for limit in made if limit is not None))


def limits_of(*limits: Limit | None) -> Limits:
    """These limits, in the order of `KINDS`; None stands for none."""
    order = {kind.name: j for j, kind in enumerate(KINDS)}
    return Limits(tuple(sorted((each for each in limits if each is not None), key=lambda limit: order[limit.name])))


def needed_outputs(asked: Mapping[str, Any]) -> tuple[str, ...]:
    """Outputs that a stage has to name for the limits that a scene asks for."""
    return _unique(name for kind in KINDS if asked.get(kind.key) is not None for name in kind.needs)


def _unique(names: Iterable[str]) -> tuple[str, ...]:
    return tuple(dict.fromkeys(names))
