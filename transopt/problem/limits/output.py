"""What limits on the motion of the device have in common: a named output of the plant, between two bounds, for all t.

Such a limit is on the physical motion z = y + z_nom, the nominal motion included. It is stated at the switching
instants; what the output may do beyond them within a servo period is taken off as a margin: with the command held,

    q(tau_k + s) - [(1 - s / dt) q(tau_k) + (s / dt) q(tau_(k+1))]

is a linear function of the commands so far, whose response to one command is found from the plant itself, and the
sum of its sizes times the largest command bounds it (the L1 norm of an impulse response). The nominal motion's own
part is bounded by its curvature. Where a limit leaves but a small part of the largest command that bound says little,
and could be more than the limit: no more than a twentieth of the limit is taken off, and the replay, which follows
the output at all times, says whether that was enough.
"""

from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Self

import numpy as np

from transopt.base.signals import FloatArray
from transopt.plant.discretise import AFTER, StageModel, discretise
from transopt.problem.limits.limit import Limit, Posed, Row, Setting, positive

MOST_KEPT = 0.05  # of the limit, for the time between the switching instants
SUBSTEPS = 8  # of a servo period, at which the excursion within it is looked at


@dataclass(frozen=True, repr=False)
class OutputLimit(Limit):
    """|output + nominal| <= limit for all t.

    Attributes
    ----------
    limit : > 0.
    nominal : (N + 1,) the nominal motion's part of the output at tau_0 to tau_N.
    excursions : of every device, a bound on what it may do within a period beyond its values at its ends.
    """

    output: ClassVar[str]

    limit: float
    nominal: FloatArray
    excursions: tuple[float, ...]

    def __post_init__(self) -> None:
        positive(self.key, self.limit)

    def margin(self, device: int = 0) -> float:
        """What is taken off the limit for the time between the switching instants."""
        return min(self.excursions[device], MOST_KEPT * self.limit)

    @staticmethod
    @abstractmethod
    def nominal_part(setting: Setting) -> FloatArray:
        """(N,) what the nominal motion alone makes of the output at tau_k."""

    @classmethod
    def posed(cls, asked: Mapping[str, Any], setting: Setting) -> Self | None:
        stage, own = setting.stage, cls.nominal_part(setting)
        # To tau_N the nominal motion goes on straight.
        nominal = np.append(own, 2 * own[-1] - own[-2] if own.size > 1 else own[-1])
        largest = setting.input_limit(asked) if stage.amplifier is None else stage.amplifier.command_limit
        curved = float(np.abs(np.diff(nominal, 2)).max(initial=0.0)) / 8
        stages = setting.grid.stages
        excursions = [_excursion(device, cls.output, stages) * largest + curved for device in setting.devices]
        return cls(asked[cls.key], nominal, tuple(excursions))

    @property
    def stated(self) -> float:
        return self.limit

    def wider(self, factor: float) -> Self:
        return type(self)(factor * self.limit, self.nominal, self.excursions)

    def rows(self, problem: Posed) -> tuple[Row, ...]:
        # At tau_0 it is what it is; the commands have their say from tau_1 to tau_N.
        def of(device: int) -> Row:
            bound = self.limit - self.margin(device)
            return Row(self.name, {self.output + AFTER: 1.0}, -bound, bound, self.nominal[1:]).of_device(device)

        return tuple(of(device) for device in range(len(problem.devices)))

    def watched(self, problem: Posed) -> tuple[Row, ...]:
        own = Row(self.name, {self.output: 1.0}, -self.limit, self.limit, self.nominal)
        return tuple(own.of_device(device) for device in range(len(problem.devices)))

    @property
    def kept_back(self) -> float:
        return max(self.margin(device) for device in range(len(self.excursions)))

    def bound(self, problem: Posed) -> float:
        """What no admissible command can exceed: the sum of the response's sizes, every command at its largest."""
        largest = problem.limits.command_bound(ideal=problem.stage.amplifier is None)
        impulse = np.eye(1, problem.grid.stages)[0]
        responses = [device.motion(impulse).outputs[self.output + AFTER] for device in problem.devices]
        return float((np.cumsum(np.abs(responses), axis=1) * largest + np.abs(self.nominal[1:])).max())

    def cannot_bind(self, problem: Posed) -> str:
        bound = self.bound(problem)
        if bound > self.limit - self.kept_back:
            return ""
        return (
            f"no command inside its limits moves it beyond {bound:.4g} {self.unit}, limit {self.limit:g} {self.unit}"
        )

    def unavoidable(self, problem: Posed) -> str:
        # What the first command can do about the first period is nothing beside the motion that is there.
        reach = self._reach(problem)
        start = max(
            abs(float(self.nominal[0])), abs(float(self.nominal[1])) + float(max(self._kept(problem) - reach))
        )
        if start <= self.limit + self.tolerance:
            return ""
        return (
            f"{self.label} {start - self.limit:.3g} {self.unit} over its {self.limit:g} {self.unit} at "
            f"{problem.grid.switching_times_s[0] * 1e3:.1f} ms: the motion of the incoming stylus alone"
        )

    def _kept(self, problem: Posed) -> FloatArray:
        """(S,) margin of every device."""
        return np.array([self.margin(device) for device in range(len(problem.devices))])

    def _reach(self, problem: Posed) -> FloatArray:
        """(S,) by how much the first command can move the output of every device within its period."""
        largest = problem.limits.command_bound(ideal=problem.stage.amplifier is None)
        return np.array([largest * abs(device.output(self.output + AFTER)[1]) for device in problem.devices])

    def unresolved(self, problem: Posed, command: FloatArray, peak: float) -> str:
        if all(excursion <= self.margin(device) for device, excursion in enumerate(self.excursions)):
            return ""
        return (
            f"{self.label} {peak - self.limit:.3g} {self.unit} over its {self.limit:g} {self.unit} between the "
            f"instants at which it is kept, {MOST_KEPT:.0%} being kept back: time.dt_s = {problem.grid.dt_s:g} s"
        )

    def replayed(self, peak: float) -> str:
        return f"replayed {self.label} {peak:.6g} {self.unit}, limit {self.limit:g} {self.unit}"


def _excursion(stage: StageModel, output: str, stages: int) -> float:
    """Largest |q - its chord| within a servo period per unit of command, over all commands of at most that size."""
    row = stage.outputs[output]
    impulse = np.eye(1, stages + 1)[0]
    states, largest = stage.states(impulse), 0.0
    at = states @ row
    for j in range(1, SUBSTEPS):
        # Discretise the device over part of a period.
        part = discretise(stage.plant, stage.amplifier, stage.dt_s * j / SUBSTEPS, outputs=tuple(stage.outputs))
        inside = states[:-1] @ (row @ part.A) + impulse[:-1] * float(row @ part.B[:, 0])
        chord = (1 - j / SUBSTEPS) * at[:-1] + j / SUBSTEPS * at[1:]
        largest = max(largest, float(np.abs(inside - chord).sum()))
    return largest
