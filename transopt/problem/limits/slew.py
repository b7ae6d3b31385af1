"""|c_k - c_(k-1)| <= slew rate times servo period: how fast the command may move."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Self

from transopt.plant.discretise import TimeGrid
from transopt.problem.limits.limit import COMMAND, HELD, Limit, Posed, Row, Setting, positive


@dataclass(frozen=True, repr=False)
class SlewLimit(Limit):
    """The rate at which the command may move [A/s], > 0, and the step per tick that follows from it."""

    name: ClassVar[str] = "slew"
    label: ClassVar[str] = "slew"
    unit: ClassVar[str] = "A/tick"
    step_unit: ClassVar[str] = "A/tick"
    key: ClassVar[str] = "slew_A_per_s"
    row_names: ClassVar[tuple[str, ...]] = ("slew",)
    said_without: ClassVar[str] = "the scene states no slew limit"

    rate_A_s: float
    dt_s: float

    def __post_init__(self) -> None:
        positive(self.key, self.rate_A_s)

    @property
    def stated(self) -> float:
        """The largest step [A/tick]."""
        return self.rate_A_s * self.dt_s

    @classmethod
    def posed(cls, asked: Mapping[str, Any], setting: Setting) -> Self | None:
        return cls(asked[cls.key], setting.grid.dt_s)

    def wider(self, factor: float) -> Self:
        return type(self)(factor * self.rate_A_s, self.dt_s)

    def rows(self, problem: Posed) -> tuple[Row, ...]:
        return (Row("slew", {COMMAND: 1.0, HELD: -1.0}, -self.stated, self.stated),)

    def reach(self, grid: TimeGrid) -> float:
        return self.stated * grid.stages

    def cannot_bind(self, problem: Posed) -> str:
        bound = problem.limits.command_bound(ideal=problem.stage.amplifier is None)
        if self.stated < 2 * bound:
            return ""
        return f"no command inside +-{bound:g} A moves by more than {2 * bound:g} A per tick, limit {self.stated:g} A"
