"""|R i + L di/dt + k_e w| <= V: the motor's terminal voltage stays within the supply rail.

The amplifier has one pole, di/dt = w (c - i), so R i + L di/dt is monotonic between two switching instants. The limit
is therefore stated just before and just after each instant.

R grows with the copper's temperature by 0.39 % per kelvin. The voltage is affine in R, so the limit holds at every
temperature if it holds for the coldest and for the hottest copper that an entry may have. Both are needed: under a
steady current hot copper needs the higher voltage. While the current falls steeply, R i and L di/dt have opposite
signs, and cold copper needs the higher one.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Self

import numpy as np

from transopt.base.signals import FloatArray
from transopt.plant.coil import Circuit, CoilModel
from transopt.plant.state_space import CURRENT_INPUT
from transopt.problem.heat import Budget, winding_limit_C
from transopt.problem.limits.limit import Limit, Posed, Setting, positive
from transopt.problem.limits.row import COMMAND, HELD, INPUT, VELOCITY, Row

# Tolerance of the replay as a share of the rail: between the instants the rows do not bound the back-EMF's change.
BETWEEN_INSTANTS = 1e-3
COLD, HOT = "supply", "supply_hot"  # prefixes of the names of the rows for the coldest and the hottest copper


@dataclass(frozen=True)
class CopperEnd:
    """The motor's circuit at one end of the range of the copper's temperature.

    Attributes
    ----------
    rows : prefix of the names of its rows, `COLD` or `HOT`.
    circuit : circuit with the resistance at that temperature.
    winding_C : the temperature; None where it is unknown and R is taken as stated.
    """

    rows: str
    circuit: Circuit
    winding_C: float | None

    @property
    def in_words(self) -> str:
        """The temperature in words; empty where it is unknown."""
        return "" if self.winding_C is None else f"with the copper at {self.winding_C:.6g} C"


def coldest_and_hottest_C(coil: CoilModel, budget: Budget) -> tuple[float, float]:
    """Lowest and highest temperature of the winding during a tap [C].

    It cannot cool below the coldest of winding, housing and ambient at the start, and may not exceed its limit.
    """
    coldest = min(coil.start_winding_C, coil.start_housing_C, coil.ambient_C)
    return coldest, winding_limit_C(coil, budget)


@dataclass(frozen=True, repr=False)
class SupplyLimit(Limit):
    """The limit of the supply rail during one tap.

    Attributes
    ----------
    limit_V : > 0.
    ends : the motor's circuit with the coldest and with the hottest copper; only one where R is taken as stated, or
        where the other cannot bind.
    pole_rad_s : w of di/dt = w (c - i).
    nominal_m_s : (N,) velocity of the nominal motion at tau_k; the back-EMF follows dz/dt, not dy/dt.
    """

    name: ClassVar[str] = "supply"
    unit: ClassVar[str] = "V"
    key: ClassVar[str] = "supply_V"
    row_names: ClassVar[tuple[str, ...]] = tuple(
        f"{end}_{side}" for end in (COLD, HOT) for side in ("before", "after")
    )
    of_each_device: ClassVar[bool] = True
    price_step: ClassVar[float] = 1.0
    asks_for: ClassVar[str] = "the motor's circuit and an amplifier with a pole"
    driven_by = CURRENT_INPUT
    said_without: ClassVar[str] = "the scene states no supply limit"

    limit_V: float
    ends: tuple[CopperEnd, ...]
    pole_rad_s: float
    nominal_m_s: FloatArray

    def __post_init__(self) -> None:
        positive(self.key, self.limit_V)

    @property
    def stated(self) -> float:
        return self.limit_V

    @classmethod
    def posed(cls, asked: Mapping[str, Any], setting: Setting) -> Self | None:
        circuit, amplifier, coil = setting.circuit, setting.stage.amplifier, setting.coil
        if circuit is None or amplifier is None:
            return None
        ends: tuple[CopperEnd, ...] = (CopperEnd(COLD, circuit, None),)
        if coil is not None:
            cold_C, hot_C = coldest_and_hottest_C(coil, setting.budget)
            ends = (CopperEnd(COLD, circuit.at(cold_C), cold_C),)
            if hot_C > cold_C:
                ends = (*ends, CopperEnd(HOT, circuit.at(hot_C), hot_C))
        return cls(asked[cls.key], ends, amplifier.rate_rad_s, setting.nominal_m_s)

    def wider(self, factor: float) -> Self:
        return replace(self, limit_V=factor * self.limit_V)

    @property
    def copper_C(self) -> list[float] | None:
        """Temperatures of the copper for which the limit is stated; None where R is taken as stated."""
        found = [end.winding_C for end in self.ends if end.winding_C is not None]
        return found or None

    def _by_current(self, end: CopperEnd) -> float:
        """dV/di at a fixed command: R - L w [ohm]."""
        return end.circuit.R_ohm - self._by_command(end)

    def _by_command(self, end: CopperEnd) -> float:
        """dV/dc: L w [ohm]."""
        return end.circuit.L_H * self.pole_rad_s

    @property
    def emf_V_s_m(self) -> float:
        """Back-EMF per m/s of the stylus; independent of the copper's temperature."""
        return self.ends[0].circuit.emf_V_s_m

    @property
    def nominal_V(self) -> FloatArray:
        """(N,) back-EMF of the nominal motion."""
        return self.emf_V_s_m * self.nominal_m_s

    def rows(self, problem: Posed) -> tuple[Row, ...]:
        found, volts, nominal = list[Row](), self.limit_V, self.nominal_V
        for end in self.ends:
            common, by_command = {INPUT: self._by_current(end), VELOCITY: self.emf_V_s_m}, self._by_command(end)
            for side, command in (("before", HELD), ("after", COMMAND)):
                outputs = {**common, command: by_command}
                found.append(Row(f"{end.rows}_{side}", outputs, -volts, volts, nominal, end.in_words))
        return tuple(row.of_device(device) for device in range(len(problem.devices)) for row in found)

    def bounds_V(self, problem: Posed) -> list[float]:
        """Bound on the terminal voltage, at each end, under any command inside the current and command limits."""
        current = problem.limits.input_limit
        command = problem.limits.command_bound(ideal=problem.stage.amplifier is None)
        impulse = np.zeros(problem.grid.stages)
        impulse[0] = 1.0
        responses = np.abs([device.motion(impulse).velocity_m_s for device in problem.devices])
        responses[:, 0] = 0.0
        emf = self.emf_V_s_m * (np.cumsum(responses, axis=1) * command + np.abs(self.nominal_m_s)).max()
        return [
            float(abs(self._by_current(end)) * current + self._by_command(end) * command + emf) for end in self.ends
        ]

    def cannot_bind(self, problem: Posed) -> str:
        bound = max(self.bounds_V(problem))
        if bound > self.limit_V:
            return ""
        return f"no current inside its limits takes more than {bound:.1f} V, limit {self.limit_V:g} V"

    def needed(self, problem: Posed) -> tuple[Self, dict[str, str]]:
        found, reasons = list[CopperEnd](), dict[str, str]()
        for end, bound in zip(self.ends, self.bounds_V(problem), strict=True):
            if bound > self.limit_V or end.winding_C is None:
                found.append(end)
                continue
            reasons[f"supply {end.in_words}"] = (
                f"no current inside its limits reaches the rail then: at most {bound:.1f} V of {self.limit_V:g} V"
            )
        return (replace(self, ends=tuple(found)) if reasons else self), reasons

    def unavoidable(self, problem: Posed) -> str:
        # The motor already moves before the first command acts.
        start = abs(float(self.nominal_V[0]))
        if start <= self.limit_V + self.tolerance:
            return ""
        return (
            f"{self.missed(start - self.limit_V)} at "
            f"{problem.grid.switching_times_s[0] * 1e3:.1f} ms by the back-EMF of the incoming stylus alone"
        )

    @property
    def replay_tolerance(self) -> float:
        return BETWEEN_INSTANTS * self.limit_V

    def replayed(self, peak: float) -> str:
        return f"terminal voltage {peak:.4f} V, limit {self.limit_V:g} V"

    def unresolved(self, problem: Posed, command: FloatArray, peak: float) -> str:
        motions = [device.motion(command) for device in problem.devices]
        stated = max(float(np.abs(row.value(motions[row.device], command)).max()) for row in self.rows(problem))
        if stated > self.limit_V + self.replay_tolerance:
            return ""
        return (
            f"{self.missed(peak - self.limit_V)} within a servo period, by the "
            f"back-EMF's swing at time.dt_s = {problem.grid.dt_s:g} s"
        )
