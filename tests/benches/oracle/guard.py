"""The coil's temperature as the servo estimates it, and how much of a transient it allows (seed Eqs. 6 and 7)."""

import math

from transopt.plant.coil import COPPER_PER_K, PWM_RIPPLE_A, RESISTANCE_REFERENCE_C, CoilModel
from transopt.problem.warm_coil import WarmCoil

CEILING_C = 1000.0  # nothing is hotter; an estimate that ran off to infinity could not be cooled down again
DYING_TICKS = 4.0  # of the present current: until the answer to a reading is felt, and what is left then
UPDATE_S = 0.01  # at 10 kHz the rise per tick of a slow node is lost in single precision


class Guard:
    """Two thermal nodes, fed with i_eff^2 every tick and moved on every 10 ms.

    One implicit midpoint step of the coil's equations per update; `CoilModel.simulate` takes them exactly.

    Attributes
    ----------
    winding_C, housing_C : estimate; starts at the coil's start temperatures.
    """

    def __init__(self, coil: CoilModel, dt_s: float, withhold_K: float, least_scale: float) -> None:
        self._coil = coil
        self._ticks = max(round(UPDATE_S / dt_s), 1)
        half = self._ticks * dt_s / 2
        C_w = coil.tau_w_s / coil.R_wh_K_W
        housing_moves = 1.0 if coil.nodes == 2 else 0.0
        self._by_w = half / C_w
        by_h = half / (coil.tau_h_s / coil.R_ha_K_W) * housing_moves
        g_w, g_h = 1 / coil.R_wh_K_W, 1 / coil.R_ha_K_W
        self._a11, self._a12 = 1 + self._by_w * g_w, -self._by_w * g_w
        self._a21, self._a22 = -by_h * g_w, 1 + by_h * (g_w + g_h)
        self._inflow_C = by_h * g_h * coil.ambient_C
        self._cold = 1 - COPPER_PER_K * RESISTANCE_REFERENCE_C
        self._warm = WarmCoil.of(coil, dt_s, withhold_K, least_scale)
        self.limit_C, self.play_limit_C = coil.limit_C, self._warm.play_limit_C
        self.winding_C, self.housing_C = coil.start_winding_C, coil.start_housing_C
        self._sum, self._square, self._count = 0.0, 0.0, 0

    def step(self, current_A: float) -> None:
        """One tick's current; the caller has seen to it that it is a number."""
        effective = abs(current_A) + PWM_RIPPLE_A
        self._square = effective * effective
        self._sum += self._square
        self._count += 1
        if self._count >= self._ticks:
            self._update(self._coil.R_ohm * (self._sum / self._count))
            self._sum, self._count = 0.0, 0

    def _update(self, power_W: float) -> None:
        """Implicit midpoint: T_m = T + h/2 f(T_m) is linear in both temperatures, then T + 2 (T_m - T)."""
        a11 = self._a11 - self._by_w * COPPER_PER_K * power_W
        b1 = self.winding_C + self._by_w * power_W * self._cold
        b2 = self.housing_C + self._inflow_C
        determinant = a11 * self._a22 - self._a12 * self._a21
        winding = 2 * (b1 * self._a22 - self._a12 * b2) / determinant - self.winding_C
        housing = 2 * (a11 * b2 - self._a21 * b1) / determinant - self.housing_C
        # Copper that doubles its resistance within one update is beyond the midpoint rule, and beyond any coil.
        sound = a11 > 0.5
        self.winding_C = winding if sound and winding <= CEILING_C else CEILING_C
        self.housing_C = housing if sound and housing <= CEILING_C else CEILING_C

    @property
    def too_hot(self) -> bool:
        """Whether the winding may pass its limit before a command of zero is felt.

        Heat since the last update counts: at 4 A that is 0.1 K.
        """
        coming_K = self._warm.rise_K * (self._sum + DYING_TICKS * self._square)
        # Written so that a NaN is too hot.
        return not (self.winding_C + coming_K <= self.limit_C)

    def rise_K(self, transient_A: float, feedback_A: float, ticks: int, scale: float) -> float:
        """Bound on the winding's rise over a transient played now at `scale`, see `WarmCoil.rise`."""
        return self._warm.rise(self.winding_C, self.housing_C, transient_A, feedback_A, ticks, scale)

    def scale(self, transient_A: float, feedback_A: float, ticks: int) -> float:
        """Largest scale <= 1 that keeps the winding at or below `play_limit_C`; 0 if not even the least one does."""
        return self.allowed(transient_A, math.inf, feedback_A, ticks)[0]

    def allowed(self, transient_A: float, cool_A: float, feedback_A: float, ticks: int) -> tuple[float, float]:
        """Scale, and part of the cool command in what is scaled, see `WarmCoil.allowed`."""
        return self._warm.allowed(self.winding_C, self.housing_C, transient_A, cool_A, feedback_A, ticks)
