"""|R i + L di/dt + k_e w| <= V: the voltage that the motor takes may not pass the supply rail.

It is stated just before and just after each switching instant: between two of them R i + L di/dt goes monotonically
from the value after the one to the value before the next, through an amplifier of one pole, di/dt = w (c - i).
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Self

import numpy as np

from transopt.base.signals import FloatArray
from transopt.plant.circuit import Circuit
from transopt.problem.limits.limit import COMMAND, CURRENT, HELD, VELOCITY, Limit, Posed, Row, Setting, positive

BETWEEN_INSTANTS = 1e-3  # of the rail: within a period only the back-EMF is left to its own devices


@dataclass(frozen=True, repr=False)
class SupplyLimit(Limit):
    """The rail of one tap.

    Attributes
    ----------
    limit_V : > 0.
    circuit : terminals of the motor.
    pole_rad_s : w of di/dt = w (c - i).
    nominal_m_s : (N,) velocity of the nominal motion at tau_k; the back-EMF follows dz/dt, not dy/dt.
    """

    name: ClassVar[str] = "supply"
    label: ClassVar[str] = "supply"
    unit: ClassVar[str] = "V"
    step_unit: ClassVar[str] = "V"
    key: ClassVar[str] = "supply_V"
    row_names: ClassVar[tuple[str, ...]] = ("supply_before", "supply_after")
    of_one_device: ClassVar[bool] = True
    asks_for: ClassVar[str] = "the motor's circuit and an amplifier with a pole"
    said_without: ClassVar[str] = "the scene states no supply limit"

    limit_V: float
    circuit: Circuit
    pole_rad_s: float
    nominal_m_s: FloatArray

    def __post_init__(self) -> None:
        positive(self.key, self.limit_V)

    @property
    def stated(self) -> float:
        return self.limit_V

    @classmethod
    def posed(cls, asked: Mapping[str, Any], setting: Setting) -> Self | None:
        circuit, amplifier = setting.circuit, setting.stage.amplifier
        if circuit is None or amplifier is None:
            return None
        return cls(asked[cls.key], circuit, amplifier.rate_rad_s, setting.nominal_m_s)

    def wider(self, factor: float) -> Self:
        return replace(self, limit_V=factor * self.limit_V)

    @property
    def by_current(self) -> float:
        """dV/di at a fixed command: R - L w [ohm]."""
        return self.circuit.R_ohm - self.by_command

    @property
    def by_command(self) -> float:
        """dV/dc: L w [ohm]."""
        return self.circuit.L_H * self.pole_rad_s

    @property
    def nominal_V(self) -> FloatArray:
        """(N,) back-EMF of the nominal motion."""
        return self.circuit.emf_V_s_m * self.nominal_m_s

    def rows(self, problem: Posed) -> tuple[Row, ...]:
        common, volts = {CURRENT: self.by_current, VELOCITY: self.circuit.emf_V_s_m}, self.limit_V
        return (
            Row("supply_before", {**common, HELD: self.by_command}, -volts, volts, self.nominal_V),
            Row("supply_after", {**common, COMMAND: self.by_command}, -volts, volts, self.nominal_V),
        )

    def bound_V(self, problem: Posed) -> float:
        """Largest terminal voltage of any command inside the current and command limits."""
        current = problem.limits.current_A
        command = problem.limits.command_bound_A(ideal=problem.stage.amplifier is None)
        impulse = np.zeros(problem.grid.stages)
        impulse[0] = 1.0
        response = np.abs(problem.stage.motion(impulse).velocity_m_s)
        velocity = np.append(0.0, np.cumsum(response)[1:]) * command + np.abs(self.nominal_m_s)
        drop = abs(self.by_current) * current + self.by_command * command
        return float(drop + self.circuit.emf_V_s_m * velocity.max())

    def cannot_bind(self, problem: Posed) -> str:
        bound = self.bound_V(problem)
        if bound > self.limit_V:
            return ""
        return f"no current inside its limits takes more than {bound:.1f} V, limit {self.limit_V:g} V"

    def unavoidable(self, problem: Posed) -> str:
        # Before the first command is felt the motor already moves.
        start = abs(float(self.nominal_V[0]))
        if start <= self.limit_V + self.tolerance:
            return ""
        return (
            f"supply {start - self.limit_V:.3g} V over its {self.limit_V:g} V at "
            f"{problem.grid.switching_times_s[0] * 1e3:.1f} ms: the back-EMF of the incoming stylus alone"
        )

    @property
    def replay_tolerance(self) -> float:
        return BETWEEN_INSTANTS * self.limit_V

    def replayed(self, peak: float) -> str:
        return f"terminal voltage {peak:.4f} V, limit {self.limit_V:g} V"

    def unresolved(self, problem: Posed, command_A: FloatArray, peak: float) -> str:
        motion = problem.stage.motion(command_A)
        stated = max(float(np.abs(row.value(motion, command_A)).max()) for row in self.rows(problem))
        if stated > self.limit_V + self.replay_tolerance:
            return ""
        return (
            f"supply {peak - self.limit_V:.3g} V over its {self.limit_V:g} V within a servo period, in which the "
            f"back-EMF swings: time.dt_s = {problem.grid.dt_s:g} s"
        )
