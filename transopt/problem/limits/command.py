"""|c_k| <= C: the command stays within the amplifier's range, a current or a voltage."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Self

from transopt.plant.state_space import CURRENT_INPUT, VOLTAGE_INPUT
from transopt.plant.time_grid import TimeGrid
from transopt.problem.limits.limit import Limit, Posed, Setting, of_motors, positive
from transopt.problem.limits.row import COMMAND, Row


@dataclass(frozen=True, repr=False)
class CommandLimit(Limit):
    """The range of a current amplifier's command [A], > 0; an ideal amplifier has no such limit."""

    name: ClassVar[str] = "command"
    unit: ClassVar[str] = "A"
    driven_by = CURRENT_INPUT
    implied: ClassVar[bool] = True
    in_every_file: ClassVar[bool] = True
    indispensable: ClassVar[bool] = True
    price_step: ClassVar[float] = 1.0
    after_the_waveform: ClassVar[bool] = True
    of_each_motor: ClassVar[bool] = True

    limit: float

    def __post_init__(self) -> None:
        positive(f"command_{self.unit}", self.limit)

    @property
    def stated(self) -> float:
        return self.limit

    @classmethod
    def posed(cls, asked: Mapping[str, Any], setting: Setting) -> Self | None:
        amplifier = setting.stage.amplifier
        return None if amplifier is None else cls(amplifier.command_limit)

    @classmethod
    def relieved_by(cls) -> Mapping[str, bool]:
        return {f"amplifier.command_limit_{cls.unit}": True}

    def wider(self, factor: float) -> Self:
        return type(self)(factor * self.limit)

    def rows(self, problem: Posed) -> tuple[Row, ...]:
        return of_motors(Row("command", {COMMAND: 1.0}, -self.limit, self.limit), problem)

    def command_bound(self, *, ideal: bool) -> float:
        return self.limit

    def reach(self, grid: TimeGrid) -> float:
        return self.limit

    def replayed(self, peak: float) -> str:
        return f"command {peak:.6f} {self.unit}, limit {self.limit:g} {self.unit}"


@dataclass(frozen=True, repr=False)
class VoltageCommandLimit(CommandLimit):
    """The range of a voltage amplifier's command [V], such as the rail of a class-D stage."""

    unit: ClassVar[str] = "V"
    driven_by = VOLTAGE_INPUT
