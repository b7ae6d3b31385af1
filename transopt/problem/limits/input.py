"""|u(t)| <= U for all t: the transient limit on what drives the plant, a current or a voltage.

The input goes monotonically from one switching instant to the next, so a box on u(tau_k) bounds it for all t.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Self

from transopt.plant.discretise import TimeGrid
from transopt.problem.limits.limit import COMMAND, INPUT, Limit, Posed, Row, Setting, positive


@dataclass(frozen=True, repr=False)
class InputLimit(Limit):
    """The limit on the input of the plant, > 0; which of the two inputs it is on, its kind says."""

    scales_movement: ClassVar[bool] = True
    indispensable: ClassVar[bool] = True
    after_the_waveform: ClassVar[bool] = True
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
        # An ideal amplifier has no state of its own: the plant's input is the command.
        felt = COMMAND if problem.stage.amplifier is None else INPUT
        return (Row(self.row_names[0], {felt: 1.0}, -self.limit, self.limit),)

    def command_bound(self, *, ideal: bool) -> float:
        return self.limit if ideal else super().command_bound(ideal=ideal)

    def reach(self, grid: TimeGrid) -> float:
        return self.limit
