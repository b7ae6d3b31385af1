"""|u(t)| <= U for all t: the transient limit on the plant's input, a current or a voltage.

Between two switching instants the input is monotonic, so a box on u(tau_k) bounds it for all t.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar, Final, Self

from transopt.base.errors import InputError
from transopt.plant.time_grid import TimeGrid
from transopt.problem.limits.limit import Limit, Posed, Setting, of_motors, positive
from transopt.problem.limits.row import COMMAND, INPUT, Row

SHARES: Final = "motor_shares"  # scene key of each motor's share of the limit


@dataclass(frozen=True, repr=False)
class InputLimit(Limit):
    """The limit on the plant's input, > 0; the subclass says whether that is a current or a voltage.

    Attributes
    ----------
    limit : that of the strongest motor.
    shares : (m,) limit of each motor over `limit`, in (0, 1]; empty if all motors have the same.
    """

    scales_movement: ClassVar[bool] = True
    indispensable: ClassVar[bool] = True
    after_the_waveform: ClassVar[bool] = True
    price_step: ClassVar[float] = 1.0

    of_each_motor: ClassVar[bool] = True

    limit: float
    shares: tuple[float, ...] = field(default=(), kw_only=True)

    def __post_init__(self) -> None:
        positive(self.key, self.limit)
        for j, share in enumerate(self.shares):
            if not 0 < share <= 1:
                raise InputError(
                    f"limits: share {share:g} of {self.key} for motor {j + 1}: must be > 0 and at most 1"
                )

    @property
    def stated(self) -> float:
        return self.limit

    @classmethod
    def posed(cls, asked: Mapping[str, Any], setting: Setting) -> Self | None:
        return cls(asked[cls.key], shares=tuple(asked.get(SHARES) or ()))

    def wider(self, factor: float) -> Self:
        return replace(self, limit=factor * self.limit)

    def rows(self, problem: Posed) -> tuple[Row, ...]:
        # An ideal amplifier has no state: the plant's input is the command.
        felt = COMMAND if problem.stage.amplifier is None else INPUT
        return of_motors(Row(self.row_names[0], {felt: 1.0}, -self.limit, self.limit), problem, self.shares)

    def command_bound(self, *, ideal: bool) -> float:
        return self.limit if ideal else super().command_bound(ideal=ideal)

    def reach(self, grid: TimeGrid) -> float:
        return self.limit
