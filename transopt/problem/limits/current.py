"""|i(t)| <= I for all t: the current of a current-driven motor (seed Eq. 8) or of a voltage-driven coil.

The current of a coil with an inductance is a state of the plant. Without an inductance it follows the voltage u
algebraically, i = (u - BL v) / R, with v the velocity of the moving part: a linear combination of outputs.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Self

import numpy as np

from transopt.base.signals import FloatArray
from transopt.plant.coil import Circuit
from transopt.plant.state_space import CURRENT_INPUT, VOLTAGE_INPUT
from transopt.problem.limits.input import InputLimit
from transopt.problem.limits.limit import Limit, Posed, Setting, positive
from transopt.problem.limits.output import MOST_KEPT, OutputLimit, largest_of
from transopt.problem.limits.row import COMMAND, HELD, INPUT, VELOCITY, Row

BEFORE = "current_before"  # row of the current just before a switching instant; a library lists it among its limits


@dataclass(frozen=True, repr=False)
class CurrentLimit(InputLimit):
    """The limit on the total current [A], > 0, of a current-driven plant."""

    name: ClassVar[str] = "current"
    unit: ClassVar[str] = "A"
    key: ClassVar[str] = "current_A"
    driven_by = CURRENT_INPUT


@dataclass(frozen=True, repr=False)
class CoilCurrentLimit(OutputLimit):
    """The limit on the current of a voltage-driven coil with an inductance [A], > 0, a plant output."""

    name: ClassVar[str] = "current"
    label: ClassVar[str] = "coil current"
    unit: ClassVar[str] = "A"
    key: ClassVar[str] = "current_A"
    driven_by = VOLTAGE_INPUT
    needs: ClassVar[tuple[str, ...]] = ("current",)
    said_without: ClassVar[str] = "the scene states no limit on the coil's current"
    output: ClassVar[str] = "current"
    straight: ClassVar[bool] = False

    @staticmethod
    def nominal_part(setting: Setting) -> FloatArray:
        return np.zeros(setting.grid.stages)

    @classmethod
    def suits(cls, circuit: Circuit | None) -> bool:
        return circuit is None or circuit.L_H > 0


@dataclass(frozen=True, repr=False)
class FollowingCurrentLimit(Limit):
    """The limit on the current of a voltage-driven coil without inductance [A], > 0.

    The voltage of an ideal amplifier jumps at the switching instants, so the limit is stated just before and just
    after each. After a share s of a period, when the voltage has gone a share p of the way to its next value, the
    current is

        (1 - p) i_k + p i_(k+1) + BL / R [(p - s) (v_(k+1) - v_k) + chord of v at s - v].

    The bracket is bounded and taken off the limit as a margin, at most a twentieth of the limit.

    Attributes
    ----------
    circuit : resistance and back-EMF constant of the coil.
    nominal_m_s : (N,) velocity of the nominal motion at tau_k.
    bends : for every device, the bound on the bracket's term under any admissible command, from the first and second
        differences of the velocity's response [A].
    """

    name: ClassVar[str] = CoilCurrentLimit.name
    label: ClassVar[str] = CoilCurrentLimit.label
    unit: ClassVar[str] = "A"
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
            f"{self.missed(peak - self.limit)} between two switching instants at time.dt_s = {problem.grid.dt_s:g} s"
        )
