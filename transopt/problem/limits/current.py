"""|i(t)| <= I for all t (seed Eq. 8): the transient limit of the motor.

The current goes monotonically from one switching instant to the next, so a box on i(tau_k) bounds it for all t.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Self

from transopt.plant.discretise import TimeGrid
from transopt.problem.limits.limit import COMMAND, CURRENT, Limit, Posed, Row, Setting, positive


@dataclass(frozen=True, repr=False)
class CurrentLimit(Limit):
    """The limit on the total current [A], > 0."""

    name: ClassVar[str] = "current"
    label: ClassVar[str] = "current"
    unit: ClassVar[str] = "A"
    step_unit: ClassVar[str] = "A"
    key: ClassVar[str] = "current_A"
    row_names: ClassVar[tuple[str, ...]] = ("current",)
    in_every_file: ClassVar[bool] = True
    after_the_waveform: ClassVar[bool] = True
    scales_movement: ClassVar[bool] = True
    indispensable: ClassVar[bool] = True
    price_step: ClassVar[float] = 1.0

    limit: float

    def __post_init__(self) -> None:
        positive(self.key, self.limit)

    @property
    def stated(self) -> float:
        return self.limit

    @classmethod
    def posed(cls, asked: Mapping[str, Any], setting: Setting) -> Self | None:
        return cls(asked[cls.key])

    def wider(self, factor: float) -> Self:
        return type(self)(factor * self.limit)

    def rows(self, problem: Posed) -> tuple[Row, ...]:
        # An ideal amplifier has no state of its own: its current is the command.
        flows = COMMAND if problem.stage.amplifier is None else CURRENT
        return (Row("current", {flows: 1.0}, -self.limit, self.limit),)

    def command_bound(self, *, ideal: bool) -> float:
        return self.limit if ideal else super().command_bound(ideal=ideal)

    def reach(self, grid: TimeGrid) -> float:
        return self.limit
