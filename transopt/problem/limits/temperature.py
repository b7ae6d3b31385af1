"""The winding may not pass its temperature: the limit that has states of its own.

One or two nodes warm by R (1 + alpha T) i_eff^2 (seed Eqs. 6 and 7), so the temperature is no sum of outputs, and a
problem with it is no quadratic program. The recursion stands in `transopt.problem.heat`, written for numpy arrays and
CasADi expressions alike.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, ClassVar, Self

import numpy as np

from transopt.base.signals import FloatArray
from transopt.plant.amplifier import Amplifier
from transopt.plant.coil import COPPER_PER_K, PWM_RIPPLE_A, RESISTANCE_REFERENCE_C, CoilModel, effective_square
from transopt.plant.discretise import TimeGrid
from transopt.plant.wall import HandOver, reference_course
from transopt.problem.heat import Budget, HeatModel, heat_model, winding_limit_C
from transopt.problem.limits.limit import VIOLATION_TOLERANCE, Limit, Posed, Setting

ROUNDING = 1e-6  # relative, for the heating within one step that the recursion leaves out
BETWEEN_INSTANTS_K = 1e-3  # the problem states the temperature at the switching instants


@dataclass(frozen=True, repr=False)
class TemperatureLimit(Limit):
    """The temperature limit of one entry.

    Attributes
    ----------
    coil : with its temperatures at the start.
    budget : what is asked of it beside its own limit.
    model : the recursion of both, with the headroom at every instant.
    dt_s : servo period.
    """

    name: ClassVar[str] = "temperature"
    label: ClassVar[str] = "coil"
    unit: ClassVar[str] = "C"
    step_unit: ClassVar[str] = "K"
    key: ClassVar[str] = "temperature_C"
    implied: ClassVar[bool] = True
    row_names: ClassVar[tuple[str, ...]] = ("temperature",)
    sides: ClassVar[tuple[str, ...]] = ("upper",)
    asks_for: ClassVar[str] = "the motor whose winding it is"
    said_without: ClassVar[str] = "the scene has no motor data"

    coil: CoilModel
    budget: Budget
    model: HeatModel
    dt_s: float

    @property
    def stated(self) -> float:
        return self.limit_C

    @property
    def limit_C(self) -> float:
        return winding_limit_C(self.coil, self.budget)

    @property
    def period_s(self) -> float | None:
        """Time from tap to tap; None for a single tap."""
        return None if self.budget.tap_rate_Hz is None else 1 / self.budget.tap_rate_Hz

    @classmethod
    def posed(cls, asked: Mapping[str, Any], setting: Setting) -> "TemperatureLimit | None":
        if setting.coil is None:
            return None
        amplifier = setting.stage.amplifier
        budget = leaning(setting.budget, setting.wall, setting.grid, setting.reference_m_s2)
        return temperature_limit(setting.coil, amplifier, setting.grid, budget)

    def wider(self, factor: float) -> Self:
        """With kelvins in proportion to what is left of them."""
        rise = (factor - 1) * max(float(self.model.headroom_K.max()), 1.0)
        return replace(self, model=replace(self.model, headroom_K=self.model.headroom_K + rise))

    @property
    def linear(self) -> bool:
        return False

    @property
    def room(self) -> float:
        """Largest headroom over the unpowered course [K]."""
        headroom = self.model.headroom_K
        return float(headroom[np.isfinite(headroom)].max())

    @property
    def tolerance(self) -> float:
        return VIOLATION_TOLERANCE

    @property
    def replay_tolerance(self) -> float:
        return BETWEEN_INSTANTS_K

    def temperatures_C(self, current_A: FloatArray, command_A: FloatArray) -> FloatArray:
        """(N,) winding temperature at tau_1 to tau_N."""
        h = self.model.heating.mean_square(current_A, command_A)
        return np.asarray(self.model.rise(h)[1:, 0] + self.model.unpowered_C)

    def relaxed(self, peak_A: float) -> "TemperatureLimit":
        """A convex limit that every admissible command meets: it bounds J from below.

        Over one horizon the copper is taken at the unpowered temperature, below which it never is. Over repeated
        taps it is at the limit whenever the limit binds: by the energy balance of the period,
        mean(T) - T_ambient = R_th mean(P (1 + alpha (T - 25))), a course that stays below the limit has
        mean(P) R_th (1 + alpha (limit - 25 - ripple)) <= limit - T_ambient, with P = R i_eff^2.

        Parameters
        ----------
        peak_A : limit current, which bounds the ripple of the winding's temperature.
        """
        model, coil = self.model, self.coil
        if self.period_s is None:
            return replace(self, model=replace(model, copper=0.0))
        N, limit = model.gain.size, self.limit_C
        share = N * self.dt_s / self.period_s

        def resistance(temperature_C: float) -> float:
            return coil.R_ohm * (1 + COPPER_PER_K * (temperature_C - RESISTANCE_REFERENCE_C))

        energy = resistance(limit) * (
            (peak_A + PWM_RIPPLE_A) ** 2 * N * self.dt_s
            + (self.budget.pause_A + PWM_RIPPLE_A) ** 2 * (1 - share) * self.period_s
        )
        # What one period brings in also leaves in one period, from a winding that is nowhere above its limit.
        energy = min(energy, self.period_s * (limit - coil.ambient_C) / (coil.R_wh_K_W + coil.R_ha_K_W))
        ripple = energy * coil.R_wh_K_W / coil.tau_w_s
        allowed = (limit - coil.ambient_C) / ((coil.R_wh_K_W + coil.R_ha_K_W) * resistance(limit - ripple))
        pause = (1 - share) * (self.budget.pause_A + PWM_RIPPLE_A) ** 2
        headroom = np.full(N, np.inf)
        headroom[-1] = allowed * (1 + ROUNDING) - pause
        mean = HeatModel(
            heating=model.heating,
            M=np.eye(1),
            b=np.array([share / N]),
            gain=np.ones(N),
            copper=0.0,
            headroom_K=headroom,
            closure=None,
            unpowered_C=np.zeros(N),
        )
        return replace(self, model=mean)

    def bound_C(self, problem: Posed) -> float:
        """What the winding cannot exceed, whatever is commanded: the limit current held throughout."""
        limit, grid = problem.limits.current_A, problem.grid
        # The delay belongs to it: the ripple of Eq. 7 heats before the first command arrives.
        duration = (grid.stages + 1) * grid.dt_s + grid.delay_s
        if self.period_s is None:
            return self.coil.adiabatic_bound_C(limit, duration)
        heat = np.full((1, grid.stages + 1), float(effective_square(np.asarray(limit))))
        steps = np.full(grid.stages + 1, duration / (grid.stages + 1))
        winding, _ = self.coil.steady_course(heat, steps, self.period_s - duration, np.array([self.budget.pause_A]))
        return float(winding.max())

    def cannot_bind(self, problem: Posed) -> str:
        bound = self.bound_C(problem)
        if bound > self.limit_C:
            return ""
        throughout = f"cannot pass {bound:.2f} C even if {problem.limits.current_A:g} A flowed"
        if self.period_s is None:
            return f"{throughout} for the whole horizon and no heat left the winding, limit {self.limit_C:g} C"
        rate = self.budget.tap_rate_Hz
        return f"{throughout} throughout every tap, {rate:g} taps/s for ever, limit {self.limit_C:g} C"

    def unavoidable(self, problem: Posed) -> str:
        # No current heats less than the ripple alone.
        nothing, tau_ms = np.zeros(problem.grid.stages), problem.grid.switching_times_s * 1e3
        excess = self.model.rise(self.model.heating.mean_square(nothing, nothing))[1:, 0] - self.model.headroom_K
        k = int(np.argmax(excess))
        if not np.isfinite(excess[k]):
            return f"coil: no steady state even without a transient, thermal runaway; {self._cooler()}"
        if excess[k] <= self.tolerance:
            return ""
        return (
            f"coil {excess[k]:.2g} K over its {self.limit_C:.8g} C at {tau_ms[k]:.1f} ms even without a transient; "
            f"{self._cooler()}"
        )

    def _cooler(self) -> str:
        """What makes an idle coil cooler, in keys of the scene."""
        coil, budget = self.coil, self.budget
        if budget.tap_rate_Hz is not None:
            return f"lower thermal.idle_A ({budget.pause_A:.3g} A) or thermal.ambient_C ({coil.ambient_C:g} C)"
        if budget.headroom_K is not None:
            return (
                f"raise thermal.headroom_K ({budget.headroom_K:g} K) or cool the housing ({coil.start_housing_C:g} C)"
            )
        return (
            f"lower thermal.start_winding_C ({coil.start_winding_C:g} C), start_housing_C "
            f"({coil.start_housing_C:g} C), or ambient_C ({coil.ambient_C:g} C)"
        )

    def replayed(self, peak: float) -> str:
        return f"winding {peak:.3f} C, limit {self.limit_C:.8g} C"

    def unresolved(self, problem: Posed, command_A: FloatArray, peak: float) -> str:
        motion = problem.stage.motion(command_A)
        hottest = float(self.temperatures_C(motion.current_A, command_A).max())
        # No winding warms faster than by the limit current with no heat leaving.
        resistance = self.coil.R_ohm * (1 + COPPER_PER_K * (self.limit_C - RESISTANCE_REFERENCE_C))
        power_W = resistance * float(effective_square(np.asarray(problem.limits.current_A)))
        warming_K = power_W * self.coil.R_wh_K_W / self.coil.tau_w_s * problem.grid.dt_s
        if hottest > self.limit_C + self.replay_tolerance or peak - hottest > warming_K:
            return ""
        return (
            f"coil {peak - self.limit_C:.3g} K over its {self.limit_C:g} C within a servo period, in which it may "
            f"warm by {warming_K:.3g} K; lower time.dt_s ({problem.grid.dt_s * 1e3:g} ms)"
        )


def leaning(budget: Budget, wall: HandOver | None, grid: TimeGrid, reference_m_s2: FloatArray) -> Budget:
    """The budget with what flows between taps: what it states, or else what the wall asks for at the window's end.

    The hand leans on the wall until it comes in again, which heats more than lifting off.
    """
    if budget.idle_A is not None or wall is None:
        return budget
    return replace(budget, idle_A=float(wall.feedback(reference_course(grid, reference_m_s2), grid.dt_s)[-1]))


@lru_cache(maxsize=64)  # all entries of a scene without a wall have the same
def temperature_limit(
    coil: CoilModel, amplifier: Amplifier | None, grid: TimeGrid, budget: Budget
) -> TemperatureLimit:
    """The limit of one horizon, from the coil's start temperatures or, with a tap rate, for ever.

    Raises
    ------
    InputError : a tap takes longer than the time between taps.
    """
    return TemperatureLimit(coil, budget, heat_model(coil, amplifier, grid, budget), grid.dt_s)
