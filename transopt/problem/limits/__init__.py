"""The limits of the optimal-control problem. Each has its own file and implements the interface in `limit`.

`KINDS` is the only list of them: scene keys, multipliers, a library's arrays, and the columns of reports and studies
are derived from it.
"""

from collections.abc import Mapping
from functools import lru_cache
from typing import Any

from transopt.plant.coil import Circuit
from transopt.plant.state_space import CURRENT_INPUT, Input
from transopt.problem.limits.command import CommandLimit, VoltageCommandLimit
from transopt.problem.limits.current import CoilCurrentLimit, CurrentLimit, FollowingCurrentLimit
from transopt.problem.limits.limit import Limit, Limits, Setting
from transopt.problem.limits.output import OutputLimit, StrokeLimit, VelocityLimit
from transopt.problem.limits.own import LawOf, OwnLimit, outputs_needed, own_limits
from transopt.problem.limits.slew import SlewLimit, VoltageSlewLimit
from transopt.problem.limits.supply import SupplyLimit
from transopt.problem.limits.temperature import TemperatureLimit
from transopt.problem.limits.voltage import SaggingVoltageLimit, VoltageLimit

KINDS: tuple[type[Limit], ...] = (
    CurrentLimit,
    VoltageLimit,
    SaggingVoltageLimit,
    CommandLimit,
    VoltageCommandLimit,
    SlewLimit,
    VoltageSlewLimit,
    CoilCurrentLimit,
    FollowingCurrentLimit,
    SupplyLimit,
    StrokeLimit,
    VelocityLimit,
    TemperatureLimit,
)

OF_OUTPUTS = tuple(
    kind for kind in KINDS if issubclass(kind, OutputLimit)
)  # limits that can be stated within a period


@lru_cache
def kinds_of(driven_by: Input) -> tuple[type[Limit], ...]:
    """The kinds of limit that apply to plants with this input."""
    return tuple(kind for kind in KINDS if kind.concerns(driven_by))


def kinds_for(driven_by: Input, circuit: Circuit | None) -> list[type[Limit]]:
    """The kinds of limit that apply to a plant with this input and this circuit at its terminals."""
    return [kind for kind in kinds_of(driven_by) if kind.suits(circuit)]


def posed(asked: Mapping[str, Any], setting: Setting, law_of: LawOf | None = None) -> Limits:
    """The limits of one tap's problem that a scene states.

    Parameters
    ----------
    asked : key in the scene's table `limits` -> number, or None where the scene states none; key `own` -> the tables
        of the user's own limits.
    law_of : makes a `Law` of the text of a nonlinear expression.

    Raises
    ------
    InputError : a number that is not a valid limit.
    """
    kinds = kinds_for(setting.stage.plant.driven_by, setting.circuit)
    made = (kind.posed(asked, setting) for kind in kinds if kind.implied or asked.get(kind.key) is not None)
    tables = asked.get(OwnLimit.key)
    own = own_limits(tables, setting, law_of) if tables else ()
    return Limits((*(limit for limit in made if limit is not None), *own))


def limits_of(*limits: Limit | None) -> Limits:
    """These limits in the order of `KINDS`, None skipped."""
    order: dict[str, int] = {}
    for j, kind in enumerate(KINDS):
        order.setdefault(kind.name, j)
    given = [each for each in limits if each is not None]
    return Limits(tuple(sorted(given, key=lambda limit: order.get(limit.name, len(order)))))


def needed_outputs(
    asked: Mapping[str, Any], driven_by: Input = CURRENT_INPUT, circuit: Circuit | None = None
) -> tuple[str, ...]:
    """Names of the outputs that a stage model must provide for the limits that a scene states."""
    kinds = kinds_for(driven_by, circuit)
    needed = [name for kind in kinds if asked.get(kind.key) is not None for name in kind.needs]
    tables = asked.get(OwnLimit.key)
    return tuple(dict.fromkeys([*needed, *(outputs_needed(tables, driven_by) if tables else ())]))
