"""|i(t)| <= I for all t: of a motor that a current drives its transient limit (seed Eq. 8), else that of a coil.

The current of a coil with an inductance is a state of the plant. Without one it is no state but follows the voltage u
at once, i = (u - BL v) / R, with v the velocity of the moving part: a sum of command and motion like any other.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Self

import numpy as np

from transopt.base.signals import FloatArray
from transopt.plant.circuit import Circuit
from transopt.plant.state_space import CURRENT_INPUT, VOLTAGE_INPUT
from transopt.problem.limits.input import InputLimit
from transopt.problem.limits.limit import COMMAND, HELD, INPUT, VELOCITY, Limit, Posed, Row, Setting, positive
from transopt.problem.limits.output import MOST_KEPT, OutputLimit, largest_of

BEFORE = "current_before"  # row of a current that jumps with the voltage, and what a library states that has it


@dataclass(frozen=True, repr=False)
class CurrentLimit(InputLimit):
    """The limit on the total current [A], > 0, where a current is the input."""

    name: ClassVar[str] = "current"
    label: ClassVar[str] = "current"
    unit: ClassVar[str] = "A"
    step_unit: ClassVar[str] = "A"
    key: ClassVar[str] = "current_A"
    driven_by = CURRENT_INPUT
    row_names: ClassVar[tuple[str, ...]] = ("current",)


@dataclass(frozen=True, repr=False)
class CoilCurrentLimit(OutputLimit):
    """The limit on the current of a coil that a voltage drives [A], > 0: an output of the plant like any other."""

    name: ClassVar[str] = "current"
    label: ClassVar[str] = "coil current"
    unit: ClassVar[str] = "A"
    step_unit: ClassVar[str] = "A"
    key: ClassVar[str] = "current_A"
    driven_by = VOLTAGE_INPUT
    row_names: ClassVar[tuple[str, ...]] = ("current",)
    needs: ClassVar[tuple[str, ...]] = ("current",)
    of_each_device: ClassVar[bool] = True
    said_without: ClassVar[str] = "the scene states no limit on the coil's current"
    output: ClassVar[str] = "current"

    @staticmethod
    def nominal_part(setting: Setting) -> FloatArray:
        return np.zeros(setting.grid.stages)

    @classmethod
    def suits(cls, circuit: Circuit | None) -> bool:
        return circuit is None or circuit.L_H > 0


@dataclass(frozen=True, repr=False)
class FollowingCurrentLimit(Limit):
    """The limit on the current of a coil without inductance that a voltage drives [A], > 0.

    An ideal amplifier's voltage jumps at a switching instant: it is stated just before and just after each. With a
    share s of a period gone, and a share p of the way from one voltage to the next, the current is

        (1 - p) i_k + p i_(k+1) + BL / R [(p - s) (v_(k+1) - v_k) + chord of v at s - v],

    so that the last part is kept back, as far as it is not more than a twentieth of the limit.

    Attributes
    ----------
    circuit : of the coil. nominal_m_s : (N,) velocity of the nominal motion at tau_k.
    bends : of every device, the size of that part for any command within its limits, by the first and second
        differences of the velocity's response [A].
    """

    name: ClassVar[str] = CoilCurrentLimit.name
    label: ClassVar[str] = CoilCurrentLimit.label
    unit: ClassVar[str] = "A"
    step_unit: ClassVar[str] = "A"
    key: ClassVar[str] = CoilCurrentLimit.key
    driven_by = VOLTAGE_INPUT
    row_names: ClassVar[tuple[str, ...]] = (*CoilCurrentLimit.row_names, BEFORE)
    of_each_device: ClassVar[bool] = True
    said_without: ClassVar[str] = CoilCurrentLimit.said_without

    limit: float
    circuit: Circuit
    nominal_m_s: FloatArray
    bends: tuple[float, ...]

    def __post_init__(self) -> None:
        positive(self.key, self.limit)

    @classmethod
    def suits(cls, circuit: Circuit | None) -> bool:
        return circuit is not None and circuit.L_H == 0

    @classmethod
    def stored_with(cls, row: str) -> str:
        return row if row == BEFORE else super().stored_with(row)

    @classmethod
    def posed(cls, asked: Mapping[str, Any], setting: Setting) -> Self | None:
        circuit, amplifier = setting.circuit, setting.stage.amplifier
        assert circuit is not None
        largest, ahead = setting.input_limit(asked), 0.0
        if amplifier is not None:
            largest, share = amplifier.command_limit, np.linspace(0, 1, 65)
            a = amplifier.rate_rad_s * setting.grid.dt_s
            ahead = float((np.expm1(-a * share) / np.expm1(-a) - share).max())
        impulse = np.eye(1, setting.grid.stages)[0]
        velocities = [device.motion(impulse).velocity_m_s for device in setting.devices]
        moved = [ahead * np.abs(np.diff(v)).sum() + np.abs(np.diff(v, 2)).sum() / 8 for v in velocities]
        bends = tuple(float(each) * largest * circuit.emf_V_s_m / circuit.R_ohm for each in moved)
        return cls(asked[cls.key], circuit, setting.nominal_m_s, bends)

    @property
    def kept_back(self) -> float:
        return min(max(self.bends), MOST_KEPT * self.limit)

    @property
    def stated(self) -> float:
        return self.limit

    def wider(self, factor: float) -> Self:
        return replace(self, limit=factor * self.limit)

    def rows(self, problem: Posed) -> tuple[Row, ...]:
        by_voltage, by_motion = 1 / self.circuit.R_ohm, -self.circuit.emf_V_s_m / self.circuit.R_ohm
        ideal = problem.stage.amplifier is None
        voltages = dict(zip(self.row_names, (COMMAND, HELD) if ideal else (INPUT,), strict=ideal))
        offset, room = by_motion * self.nominal_m_s, self.limit - self.kept_back
        return tuple(
            Row(name, {VELOCITY: by_motion, voltage: by_voltage}, -room, room, offset).of_device(device)
            for device in range(len(problem.devices))
            for name, voltage in voltages.items()
        )

    def cannot_bind(self, problem: Posed) -> str:
        bound = largest_of(self.rows(problem), problem)
        if bound > self.limit - self.kept_back:
            return ""
        return f"no command inside its limits drives more than {bound:.4g} A, limit {self.limit:g} A"

    def unresolved(self, problem: Posed, command: FloatArray, peak: float) -> str:
        if max(self.bends) <= self.kept_back:
            return ""
        return (
            f"{self.label} {peak - self.limit:.3g} A over its {self.limit:g} A between the instants at which it is "
            f"kept: time.dt_s = {problem.grid.dt_s:g} s"
        )
