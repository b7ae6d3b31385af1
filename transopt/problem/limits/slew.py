"""|c_k - c_(k-1)| <= slew rate times servo period: the limit on the command's rate of change."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Self

from transopt.plant.state_space import CURRENT_INPUT, VOLTAGE_INPUT
from transopt.plant.time_grid import TimeGrid
from transopt.problem.limits.limit import Limit, Posed, Setting, of_motors, positive
from transopt.problem.limits.row import COMMAND, HELD, Row


@dataclass(frozen=True, repr=False)
class SlewLimit(Limit):
    """The slew limit of a current amplifier's command [A/s], > 0, applied to its step per tick."""

    name: ClassVar[str] = "slew"
    unit: ClassVar[str] = "A/tick"
    key: ClassVar[str] = "slew_A_per_s"
    driven_by = CURRENT_INPUT
    of_each_motor: ClassVar[bool] = True
    said_without: ClassVar[str] = "the scene states no slew limit"

    rate: float
    dt_s: float

    def __post_init__(self) -> None:
        positive(self.key, self.rate)

    @property
    def stated(self) -> float:
        """The largest step per tick."""
        return self.rate * self.dt_s

    @property
    def key_scale(self) -> float:
        return 1 / self.dt_s

    @classmethod
    def posed(cls, asked: Mapping[str, Any], setting: Setting) -> Self | None:
        return cls(asked[cls.key], setting.grid.dt_s)

    def wider(self, factor: float) -> Self:
        return type(self)(factor * self.rate, self.dt_s)

    def rows(self, problem: Posed) -> tuple[Row, ...]:
        row = Row(self.row_names[0], {COMMAND: 1.0, HELD: -1.0}, -self.stated, self.stated)
        return of_motors(row, problem)

    def reach(self, grid: TimeGrid) -> float:
        return self.stated * grid.stages

    def cannot_bind(self, problem: Posed) -> str:
        bound = problem.limits.command_bound(ideal=problem.stage.amplifier is None)
        if self.stated < 2 * bound:
            return ""
        return (
            f"no command inside +-{bound:g} {self.base_unit()} changes faster than "
            f"{2 * bound * self.key_scale:g} {self.key_unit()}, limit {self.rate:g} {self.key_unit()}"
        )


@dataclass(frozen=True, repr=False)
class VoltageSlewLimit(SlewLimit):
    """The slew limit of a voltage amplifier's command [V/s], > 0."""

    name: ClassVar[str] = "voltage_slew"
    label: ClassVar[str] = SlewLimit.label
    unit: ClassVar[str] = "V/tick"
    key: ClassVar[str] = "slew_V_per_s"
    driven_by = VOLTAGE_INPUT
