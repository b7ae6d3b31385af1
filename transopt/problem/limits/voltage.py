"""|u(t)| <= U for all t: the largest voltage at the terminals of an actuator that a voltage drives.

A battery sags under load and a boost converter's capacitor empties: the supply may fall along the waveform. The bound
is then U times a share that is stated at instants from the first command on and linear between them. Between two
switching instants the input lies between its values there while the bound may fall: the lower end of every period
bounds it for all t.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Self

import numpy as np

from transopt.base.errors import InputError
from transopt.base.signals import FloatArray
from transopt.plant.state_space import VOLTAGE_INPUT
from transopt.problem.limits.input import InputLimit
from transopt.problem.limits.limit import Posed, Row, Setting

SAG = "sag"  # below `limits`: [[time in s from the first command on, share of the voltage], ...]


@dataclass(frozen=True, repr=False)
class VoltageLimit(InputLimit):
    """The limit on the terminal voltage [V], > 0, where a voltage is the input.

    Attributes
    ----------
    share : (N + 1,) of the limit that the supply has at tau_0 to tau_N, in (0, 1]; None where it does not sag.
    """

    name: ClassVar[str] = "voltage"
    label: ClassVar[str] = "voltage"
    unit: ClassVar[str] = "V"
    step_unit: ClassVar[str] = "V"
    key: ClassVar[str] = "voltage_V"
    driven_by = VOLTAGE_INPUT
    row_names: ClassVar[tuple[str, ...]] = ("voltage",)

    share: FloatArray | None = None

    @classmethod
    def posed(cls, asked: Mapping[str, Any], setting: Setting) -> Self | None:
        return cls(asked[cls.key], sagging(asked.get(SAG), setting.grid.dt_s, setting.grid.stages))

    def wider(self, factor: float) -> Self:
        return replace(self, limit=factor * self.limit)

    def rows(self, problem: Posed) -> tuple[Row, ...]:
        (row,) = super().rows(problem)
        if self.share is None:
            return (row,)
        # A command is felt over the period behind its instant, and before it the amplifier comes from the one before:
        # the least supply of both periods bounds u(tau_k) for all of them.
        ends = np.minimum(self.share[:-1], self.share[1:])
        bound = self.limit * np.minimum(ends, np.append(ends[:1], ends[:-1]))
        return (replace(row, lower=-bound, upper=bound),)

    def watched(self, problem: Posed) -> tuple[Row, ...]:
        (row,) = super().rows(problem)
        return (row,)


def sagging(course: list[list[float]] | None, dt_s: float, stages: int) -> FloatArray | None:
    """(stages + 1,) share of the voltage at the switching instants; None without a course.

    Raises
    ------
    InputError : times that do not rise, shares outside (0, 1].
    """
    if course is None:
        return None
    times, shares = np.array(course, dtype=float).reshape(-1, 2).T
    if times.size == 0 or np.any(np.diff(times) <= 0) or times[0] < 0 or not np.all((shares > 0) & (shares <= 1)):
        raise InputError("limits.sag: must be pairs of a time >= 0 [s], rising, and a share of the voltage in (0, 1]")
    return np.asarray(np.interp(dt_s * np.arange(stages + 1), times, shares))
