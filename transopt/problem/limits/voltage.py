"""|u(t)| <= U for all t: the limit on the terminal voltage of a voltage-driven actuator.

The supply may fall along the waveform: a battery sags under load, a boost converter's capacitor discharges. The limit
is then U s(t), with the share s stated at instants counted from the first command and linear between them. Between
two switching instants the input lies between its values there, while the limit may fall. So the input at an instant
is bounded by the lowest supply of the two periods around it, which bounds it for all t.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Self

import numpy as np

from transopt.base.errors import InputError
from transopt.base.signals import FloatArray
from transopt.plant.state_space import VOLTAGE_INPUT
from transopt.problem.limits.input import InputLimit
from transopt.problem.limits.limit import Posed, Setting
from transopt.problem.limits.row import Row

SAG = "sag"  # below `limits`: [[time in s from the first command on, share of the voltage], ...]


@dataclass(frozen=True, repr=False)
class VoltageLimit(InputLimit):
    """The limit on the terminal voltage [V], > 0, of a voltage-driven plant."""

    name: ClassVar[str] = "voltage"
    unit: ClassVar[str] = "V"
    key: ClassVar[str] = "voltage_V"
    driven_by = VOLTAGE_INPUT

    @classmethod
    def posed(cls, asked: Mapping[str, Any], setting: Setting) -> Self | None:
        return cls(asked[cls.key]) if asked.get(SAG) is None else None


@dataclass(frozen=True, repr=False)
class SaggingVoltageLimit(VoltageLimit):
    """The limit on the terminal voltage where the supply falls along the waveform.

    Attributes
    ----------
    share : (N + 1,) supply at tau_0 to tau_N over the limit, in (0, 1].
    """

    label: ClassVar[str] = "sagging voltage"

    share: FloatArray

    @classmethod
    def posed(cls, asked: Mapping[str, Any], setting: Setting) -> Self | None:
        course = asked.get(SAG)
        if course is None:
            return None
        return cls(asked[cls.key], _shares(course, setting.grid.dt_s, setting.grid.stages))

    def wider(self, factor: float) -> Self:
        return replace(self, limit=factor * self.limit)

    def rows(self, problem: Posed) -> tuple[Row, ...]:
        (row,) = super().rows(problem)
        ends = np.minimum(self.share[:-1], self.share[1:])
        bound = self.limit * np.minimum(ends, np.append(ends[:1], ends[:-1]))
        return (replace(row, lower=-bound, upper=bound),)

    def watched(self, problem: Posed) -> tuple[Row, ...]:
        # The replay compares with constant bounds: u <= U s is u + U (1 - s) <= U, and the lower side likewise.
        (row,) = super().rows(problem)
        lacks = self.limit * (1 - self.share)
        return (replace(row, offset=lacks), replace(row, offset=-lacks))


def _shares(course: list[list[float]], dt_s: float, stages: int) -> FloatArray:
    """(stages + 1,) share of the voltage at the switching instants."""
    times, shares = np.array(course, dtype=float).reshape(-1, 2).T
    if times.size == 0 or np.any(np.diff(times) <= 0) or times[0] < 0 or not np.all((shares > 0) & (shares <= 1)):
        raise InputError("limits.sag: must be pairs of a time >= 0 [s], rising, and a share of the voltage in (0, 1]")
    return np.asarray(np.interp(dt_s * np.arange(stages + 1), times, shares))
