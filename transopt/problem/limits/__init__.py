"""The limits of the optimal-control problem, one file each, all of the interface in `limit`.

`KINDS` is the one list of them: scene keys, multipliers, the arrays of a library, columns of reports and studies
follow from it.
"""

from collections.abc import Mapping
from typing import Any

from transopt.problem.limits.command import CommandLimit
from transopt.problem.limits.current import CurrentLimit
from transopt.problem.limits.limit import Limit, Limits, Setting
from transopt.problem.limits.own import LawOf, OwnLimit, outputs_needed, own_limits
from transopt.problem.limits.slew import SlewLimit
from transopt.problem.limits.stroke import StrokeLimit
from transopt.problem.limits.supply import SupplyLimit
from transopt.problem.limits.temperature import TemperatureLimit
from transopt.problem.limits.velocity import VelocityLimit

KINDS: tuple[type[Limit], ...] = (
    CurrentLimit,
    CommandLimit,
    SlewLimit,
    SupplyLimit,
    StrokeLimit,
    VelocityLimit,
    TemperatureLimit,
)


def posed(asked: Mapping[str, Any], setting: Setting, law_of: LawOf | None = None) -> Limits:
    """The limits of one tap: what a scene asks for, each made by its own kind.

    Parameters
    ----------
    asked : key below the scene's `limits` -> number, or None where it is not asked for; below `own` the tables of the
        user's own limits.
    law_of : what makes a law of the text of an expression that is not linear.

    Raises
    ------
    InputError : a number that is no limit.
    """
    made = (kind.posed(asked, setting) for kind in KINDS if kind.implied or asked.get(kind.key) is not None)
    tables = asked.get(OwnLimit.key)
    own = own_limits(tables, setting, law_of) if tables else ()
    return Limits((*(limit for limit in made if limit is not None), *own))


def limits_of(*limits: Limit | None) -> Limits:
    """These limits, in the order of `KINDS`; None stands for none."""
    order = {kind.name: j for j, kind in enumerate(KINDS)}
    given = [each for each in limits if each is not None]
    return Limits(tuple(sorted(given, key=lambda limit: order.get(limit.name, len(order)))))


def needed_outputs(asked: Mapping[str, Any]) -> tuple[str, ...]:
    """Outputs that a stage has to name for the limits that a scene asks for."""
    needed = [name for kind in KINDS if asked.get(kind.key) is not None for name in kind.needs]
    tables = asked.get(OwnLimit.key)
    return tuple(dict.fromkeys([*needed, *(outputs_needed(tables) if tables else ())]))
