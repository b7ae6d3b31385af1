"""The limit on the winding's temperature, the only limit with states of its own.

One or two thermal nodes are heated by R (1 + alpha T) i_eff^2 (seed Eqs. 6 and 7). The temperature is therefore not
linear in the outputs, and a problem with this limit is not a quadratic program. Its recursion is in
`transopt.problem.heat`, written for numpy arrays and CasADi expressions alike.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Any, ClassVar, Self

import numpy as np

from transopt.base.signals import FloatArray
from transopt.plant.amplifier import Amplifier
from transopt.plant.coil import (
    COPPER_PER_K,
    RESISTANCE_REFERENCE_C,
    CoilModel,
    effective_square,
    following_square_mean,
)
from transopt.plant.discretise import StageModel
from transopt.plant.state_space import CURRENT_INPUT
from transopt.plant.time_grid import TimeGrid
from transopt.plant.wall import HandOver
from transopt.problem.heat import Budget, HeatModel, heat_model, steady_margin_K, winding_limit_C
from transopt.problem.limits.limit import VIOLATION_TOLERANCE, Limit, Posed, Setting

ROUNDING = 1e-6  # relative rounding of the steady state where the tap period is far below the time constants
WITHIN_TOLERANCE = 1e-4  # most by which an input within its tolerance adds to the rise, relative to the rise
BETWEEN_INSTANTS_K = 1e-3  # tolerance of the replay: the problem states the limit at the switching instants only


@dataclass(frozen=True, repr=False, eq=False)
class TemperatureLimit(Limit):
    """The temperature limit of one entry; the same object for entries that share it (`temperature_limit`).

    Attributes
    ----------
    coil : thermal model with the temperatures at the start.
    budget : requirements beyond the coil's own limit.
    model : recursion of the temperature, with the headroom at every instant.
    dt_s : servo period.
    """

    name: ClassVar[str] = "temperature"
    label: ClassVar[str] = "coil"
    unit: ClassVar[str] = "C"
    step_unit: ClassVar[str] = "K"
    key: ClassVar[str] = "temperature_C"
    implied: ClassVar[bool] = True
    sides: ClassVar[tuple[str, ...]] = ("upper",)
    price_step: ClassVar[float] = 10.0
    asks_for: ClassVar[str] = "the motor whose winding it is"
    driven_by = CURRENT_INPUT
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
        budget = with_pause_current(setting.budget, setting.wall, setting.stage, setting.grid)
        return temperature_limit(setting.coil, amplifier, setting.grid, budget)

    @classmethod
    def relieved_by(cls) -> Mapping[str, bool]:
        cooler = ("start_winding_C", "start_housing_C", "ambient_C", "idle_A", "tap_rate_Hz")
        return {"thermal.headroom_K": True, **{f"thermal.{key}": False for key in cooler}}

    def wider(self, factor: float) -> Self:
        """Raise the limit by (factor - 1) times the largest headroom, which counts as at least 1 K."""
        return self.raised((factor - 1) * max(float(self.model.headroom_K.max()), 1.0))

    def raised(self, by: float) -> Self:
        return replace(self, model=replace(self.model, headroom_K=self.model.headroom_K + by))

    @property
    def linear(self) -> bool:
        return False

    @property
    def room(self) -> float:
        """Largest headroom over the unpowered course [K]."""
        headroom = self.model.headroom_K
        return float(headroom[np.isfinite(headroom)].max())

    @property
    def kept_back(self) -> float:
        """Margin for repeating taps: the steady state sums the neglected heat of currents that reverse."""
        return 0.0 if self.period_s is None else steady_margin_K(self.coil, self.budget)

    @property
    def tolerance(self) -> float:
        return VIOLATION_TOLERANCE

    @property
    def replay_tolerance(self) -> float:
        return BETWEEN_INSTANTS_K

    @cached_property
    def bounds_C(self) -> FloatArray:
        """(N,) highest permitted winding temperature at tau_1 to tau_N, infinite where there is no limit."""
        return np.asarray(self.model.headroom_K + self.model.unpowered_C)

    def temperatures_C(self, current_A: FloatArray, command: FloatArray) -> FloatArray:
        """(N,) winding temperature at tau_1 to tau_N."""
        h = self.model.heating.mean_square(current_A, command)
        return np.asarray(self.model.rise(h)[1:, 0] + self.model.unpowered_C)

    def relaxed(self) -> "TemperatureLimit":
        """A convex relaxation: every admissible command meets it, so the least J under it is a lower bound.

        The copper's resistance R (1 + alpha (T - 25)) is replaced by a lower bound of it. The temperatures are then
        sums of the heatings h_k with weights >= 0, none of them above its true value, and h_k is convex in the
        commands.

        A single tap: the copper is never colder than without current; for each step the colder of its ends counts.

        Repeating taps: let rest be the ambient temperature with two nodes and, with one node, the housing's, which is
        then fixed. Let the winding be x above rest at the hottest instant at which the limit is stated. Only the
        current heats it, so it cools no faster than

            dT_w/dt = -(T_w - T_h) / tau_w,    T_w >= T_h >= rest.

        Within a tap period it therefore keeps at least the share exp(-period / tau_w) of x. The energy balance of the
        housing over a period, mean(T_w - T_h) = R_wh / R mean(T_w - rest) with R = R_wh + R_ha for two nodes and R_wh
        for one, shows that it keeps at least the share 1 - (period / tau_w) R_wh / R as well. With `kept` the larger
        of the two, the resistance is never below R_low(x), its value at rest + kept x. At instant k the winding is
        then at least R_low(x) L_k + c_k above rest, with L_k >= 0 linear in the heatings and c_k >= 0 from the pause,
        and at most x:

            L_k <= (x - c_k) / R_low(x).

        The right side grows with x, so the inequality holds with x the whole headroom: that is the convex limit.
        """
        model, coil = self.model, self.coil
        if self.period_s is None:
            after = coil.R_ohm * (1 + COPPER_PER_K * (model.unpowered_C - RESISTANCE_REFERENCE_C))
            return replace(self, model=replace(model, gain=np.minimum(model.gain, after), copper=0.0))
        # The margin, which covers what the recursion neglects, is added back: a command whose true temperature just
        # meets the stated limit must meet the relaxed one too.
        headroom = (model.headroom_K + self.kept_back) * (1 + ROUNDING)
        lapse = self.period_s / coil.tau_w_s
        total = coil.R_wh_K_W + (coil.R_ha_K_W if coil.nodes == 2 else 0.0)
        kept = max(float(np.exp(-lapse)), 1 - lapse * coil.R_wh_K_W / total)
        coldest = model.gain + model.copper * kept * max(float(headroom.min()), 0.0)
        return replace(self, model=replace(model, gain=coldest, copper=0.0, headroom_K=headroom))

    def bound_C(self, problem: Posed) -> float:
        """Bound on the winding's temperature under any command: that of the limit current, held throughout [C]."""
        limit, grid = problem.limits.input_limit, problem.grid
        # The amplifier's delay counts too: the ripple of Eq. 7 heats before the first command acts.
        duration = (grid.stages + 1) * grid.dt_s + grid.delay_s
        if self.period_s is None:
            return self.coil.adiabatic_bound_C(limit, duration)
        heat = np.full((1, grid.stages + 1), float(effective_square(np.asarray(limit), self.coil.ripple_A)))
        steps = np.full(grid.stages + 1, duration / (grid.stages + 1))
        winding, _ = self.coil.steady_course(heat, steps, self.period_s - duration, np.array([self.budget.pause_A]))
        return float(winding.max())

    def surely_kept(self, problem: Posed) -> bool:
        """Whether every command meets it that keeps the limit on the input, up to that limit's tolerance."""
        bound = self.bound_C(problem)
        over = WITHIN_TOLERANCE * max(bound - self.coil.start_winding_C, 0.0)
        return bound + over <= min(self.limit_C - self.kept_back, float(self.bounds_C.min()))

    def cannot_bind(self, problem: Posed) -> str:
        bound = self.bound_C(problem)
        if bound > self.limit_C:
            return ""
        throughout = f"cannot pass {bound:.2f} C even if {problem.limits.input_limit:g} A flowed"
        if self.period_s is None:
            return f"{throughout} for the whole horizon and no heat left the winding, limit {self.limit_C:g} C"
        rate = self.budget.tap_rate_Hz
        return f"{throughout} throughout every tap, {rate:g} taps/s for ever, limit {self.limit_C:g} C"

    def unavoidable(self, problem: Posed) -> str:
        # Without a transient the ripple alone heats, the least heat of any command.
        nothing, tau_ms = np.zeros(problem.grid.stages), problem.grid.switching_times_s * 1e3
        excess = self.model.rise(self.model.heating.mean_square(nothing, nothing))[1:, 0] - self.model.headroom_K
        k = int(np.argmax(excess))
        if not np.isfinite(excess[k]):
            return "coil: no steady state even without a transient, thermal runaway"
        if excess[k] <= self.tolerance:
            return ""
        return f"{self.missed(float(excess[k]))} at {tau_ms[k]:.1f} ms even without a transient"

    def replayed(self, peak: float) -> str:
        return f"winding {peak:.3f} C, limit {self.limit_C:.8g} C"

    def unresolved(self, problem: Posed, command: FloatArray, peak: float) -> str:
        motion, model, dt_s = problem.stage.motion(command), self.model, problem.grid.dt_s
        hottest = float(self.temperatures_C(motion.plant_input, command).max())
        if hottest > self.limit_C + self.replay_tolerance:
            return ""
        over = self.missed(peak - self.limit_C)
        # The winding warms fastest under the limit current while no heat leaves it.
        resistance = self.coil.R_ohm * (1 + COPPER_PER_K * (self.limit_C - RESISTANCE_REFERENCE_C))
        power_W = resistance * float(effective_square(np.asarray(problem.limits.input_limit), self.coil.ripple_A))
        warming_K = power_W * self.coil.R_wh_K_W / self.coil.tau_w_s * dt_s
        if peak - hottest <= warming_K:
            may = f"in which it may warm by {warming_K:.3g} K"
            return f"{over} within a servo period, {may} at time.dt_s = {dt_s:g} s"
        if problem.stage.amplifier is None:
            return ""
        # The recursion uses |mean of i| for the mean of |i|: too little where the current changes its sign.
        decays = np.full(command.size, problem.stage.amplifier.rate_rad_s * dt_s)
        heating = following_square_mean(motion.plant_input, command, decays, self.coil.ripple_A)
        truly = float((model.rise(heating)[1:, 0] + model.unpowered_C).max())
        if not peak - truly <= warming_K:
            return ""
        return (
            f"{over}: a current that changes its sign within a servo period heats more than the problem states, here "
            f"by {truly - hottest:.3g} K at time.dt_s = {dt_s:g} s"
        )


def with_pause_current(budget: Budget, wall: HandOver | None, stage: StageModel, grid: TimeGrid) -> Budget:
    """The budget with the current between taps: the stated one or, if none, the wall's at the end of the window.

    The transient is over by then. The hand is assumed to lean on the wall until the next tap, which heats more than
    lifting off. The hand intends a depth z_nom, and the wall of stiffness K pushes with the current
    i = -K (z_nom + g i) / k_f, where g is the static displacement per ampere.
    """
    if budget.idle_A is not None or wall is None:
        return budget
    deep = float(wall.feedback(np.zeros(grid.stages), grid.dt_s)[-1])
    plant, law = stage.plant, wall.wall
    try:
        held_m_A = -float((plant.Ce @ np.linalg.solve(plant.A, plant.B))[0, 0])
    except np.linalg.LinAlgError:
        held_m_A = 0.0  # a free device has no static displacement
    yielded = law.stiffness_N_m * max(held_m_A, 0.0) / law.force_per_current_N_A
    return replace(budget, idle_A=deep / (1 + yielded))


@lru_cache(maxsize=64)  # the entries of a scene without a wall share one limit
def temperature_limit(
    coil: CoilModel, amplifier: Amplifier | None, grid: TimeGrid, budget: Budget
) -> TemperatureLimit:
    """The limit over one horizon: from the coil's start temperatures or, with a tap rate, of the periodic course.

    Raises
    ------
    InputError : a tap takes longer than the time between taps.
    """
    return TemperatureLimit(coil, budget, heat_model(coil, amplifier, grid, budget), grid.dt_s)
