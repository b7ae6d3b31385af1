"""Coil temperature: winding over housing over ambient (seed Eqs. 6-7).

Seed Eq. 6 has one node and is printed with (1 + exp(-dt / tau)) where (1 - exp(-dt / tau)) is meant: as printed, one
tick of 1 A would heat the coil by 75 K. This model has two nodes, because during a tap only the winding warms.
"""

from dataclasses import dataclass, replace

import numpy as np

from transopt.base.errors import InputError
from transopt.base.recursions import forwards, heated, square_means
from transopt.base.signals import FloatArray

COPPER_PER_K = 0.0039  # temperature coefficient of resistance
RESISTANCE_REFERENCE_C = 25.0  # temperature at which datasheets state R
PWM_RIPPLE_A = 0.02  # seed Eq. 7: i_eff = i + 0.02 sign(i)
WINDING_C, HOUSING_C = (-40.0, 260.0), (-40.0, 200.0)  # a reading beyond these is a sensor's fault
PAUSE_STEPS = 100  # into which the pause between two taps is divided


def effective_square(current_A: FloatArray, ripple_A: float = PWM_RIPPLE_A) -> FloatArray:
    """i_eff^2 = (|i| + ripple)^2 of seed Eq. 7: the PWM ripple heats even around zero current [A^2]."""
    return np.asarray((np.abs(current_A) + ripple_A) ** 2)


def following_square_mean(
    before_A: FloatArray, command_A: FloatArray, decays: FloatArray, ripple_A: float = PWM_RIPPLE_A
) -> FloatArray:
    """Mean of i_eff^2 over steps in which the current follows a held command through one pole [A^2].

    The current is i(t) = c + (i_0 - c) exp(-w t), and i_eff = |i| + `ripple_A` (seed Eq. 7). The mean is exact for
    any pole, also where the current changes its sign within the step.

    Parameters
    ----------
    before_A : (..., K) i_0, current at the start of each step.
    command_A : (..., K) c, held over the step.
    decays : (K,) w times the length of the step, >= 0.

    Returns
    -------
    (..., K) means.
    """
    x = np.maximum(decays, np.finfo(float).tiny)
    factors = np.stack([x, np.exp(-x), -np.expm1(-x) / x, -np.expm1(-2 * x) / (2 * x)])
    compiled = square_means(factors, ripple_A, before_A, command_A)
    if compiled is not None:
        return compiled
    _, left, of_mean, of_square = factors
    away = before_A - command_A
    mean = command_A + away * of_mean
    square = command_A * (2 * mean - command_A) + away**2 * of_square
    turns = before_A * (command_A + away * left) < 0
    size = np.abs(mean)
    # The current crosses zero where exp(-w t) = -c / (i_0 - c); before that it has the other sign.
    command, gap = np.broadcast_to(command_A, turns.shape)[turns], away[turns]
    share = -command / gap
    first = (-command * np.log(share) + gap * (1 - share)) / np.broadcast_to(x, turns.shape)[turns]
    size[turns] = np.abs(first) + np.abs(mean[turns] - first)
    return np.asarray(square + 2 * ripple_A * size + ripple_A**2)


@dataclass(frozen=True)
class CoilModel:
    """Two thermal nodes with copper whose resistance rises with the winding temperature.

    C_w dT_w/dt = R (1 + alpha (T_w - 25)) i_eff^2 - (T_w - T_h) / R_wh
    C_h dT_h/dt = (T_w - T_h) / R_wh - (T_h - T_ambient) / R_ha
    with C_w = tau_w / R_wh and C_h = tau_h / R_ha. With one node the housing keeps its start temperature, a good
    approximation over a tap; a single node with the sum of both resistances would overstate the heating of a tap
    several times.

    Attributes
    ----------
    R_ohm : resistance at 25 C that turns current into heat; on a `Bridge` larger than the winding's, for its ripple.
    R_wh_K_W, R_ha_K_W : thermal resistances winding to housing and housing to ambient.
    tau_w_s, tau_h_s : time constants of winding and housing.
    limit_C : highest permitted temperature of the winding.
    ambient_C : temperature around the housing.
    start_winding_C, start_housing_C : temperatures at the start, the winding's at most `limit_C`.
    nodes : 1 (winding) or 2 (winding and housing).
    ripple_A : constant of seed Eq. 7 for the heat of the PWM; the seed's value, or that of a `Bridge`.

    Raises
    ------
    InputError : one of them is out of its range.
    """

    R_ohm: float
    R_wh_K_W: float
    R_ha_K_W: float
    tau_w_s: float
    tau_h_s: float
    limit_C: float
    ambient_C: float = 25.0
    start_winding_C: float = 25.0
    start_housing_C: float = 25.0
    nodes: int = 2
    ripple_A: float = PWM_RIPPLE_A

    def __post_init__(self) -> None:
        for field in ("R_ohm", "R_wh_K_W", "R_ha_K_W", "tau_w_s", "tau_h_s"):
            value = getattr(self, field)
            if not 0 < value < np.inf:
                raise InputError(f"motor: {field} = {value:g}: must be > 0 and finite")
        if self.nodes not in (1, 2):
            raise InputError(f"thermal: nodes = {self.nodes}: must be 1 (winding) or 2 (winding and housing)")
        if self.start_winding_C > self.limit_C:
            raise InputError(
                f"thermal: start_winding_C = {self.start_winding_C:g} C is above the winding limit "
                f"{self.limit_C:g} C: let the motor cool or raise the limit"
            )

    def flow(self) -> tuple[FloatArray, FloatArray]:
        """Rate matrix (m, m) of the rises above `rest_C` [1/s]; their rate per watt in the winding (m,) [K/s/W]."""
        C_w, C_h = self.tau_w_s / self.R_wh_K_W, self.tau_h_s / self.R_ha_K_W
        g_w, g_h = 1 / self.R_wh_K_W, 1 / self.R_ha_K_W
        if self.nodes == 1:
            return np.array([[-g_w / C_w]]), np.array([1 / C_w])
        return np.array([[-g_w / C_w, g_w / C_w], [g_w / C_h, -(g_w + g_h) / C_h]]), np.array([1 / C_w, 0.0])

    @property
    def rest_C(self) -> float:
        """Temperature that all nodes approach without current."""
        return self.ambient_C if self.nodes == 2 else self.start_housing_C

    def continuous_current_A(self) -> float:
        """Constant current whose steady state is the winding's limit: the datasheet's continuous current."""
        rise = self.limit_C - self.ambient_C
        resistance = self.R_ohm * (1 + COPPER_PER_K * (self.limit_C - RESISTANCE_REFERENCE_C))
        return float(np.sqrt(rise / ((self.R_wh_K_W + self.R_ha_K_W) * resistance)))

    def on_a_device(self) -> "CoilModel":
        """The coil for the temperature estimate on a device, which assumes the seed's ripple.

        With a larger ripple the estimate is too low, and for a given estimate most under a steady current. So the
        limit is lowered to the estimate under the current whose true steady state is the winding's limit.
        """
        if self.ripple_A <= PWM_RIPPLE_A:
            return self
        counted_A = self.continuous_current_A() - self.ripple_A + PWM_RIPPLE_A
        warming = (self.R_wh_K_W + self.R_ha_K_W) * self.R_ohm * counted_A**2
        cold = 1 + COPPER_PER_K * (self.ambient_C - RESISTANCE_REFERENCE_C)
        return replace(self, limit_C=self.ambient_C + warming * cold / (1 - COPPER_PER_K * warming))

    def adiabatic_bound_C(self, current_A: float, duration_s: float) -> float:
        """Rigorous bound on the winding temperature while |i| <= `current_A` for `duration_s`.

        The bound assumes that no heat leaves and that the limit current flows throughout, starting from the hottest
        node: dT/dt = R (1 + alpha (T - 25)) i_eff^2 / C_w. The true winding stays below it: while it is the hottest
        node, heat only leaves it; while it is not, it lies below a node that only cools.
        """
        hottest = max(self.start_winding_C, self.start_housing_C, self.ambient_C)
        heating = (
            self.R_ohm * float(effective_square(np.asarray(current_A), self.ripple_A)) * self.R_wh_K_W / self.tau_w_s
        )
        above = hottest - RESISTANCE_REFERENCE_C
        with np.errstate(over="ignore"):  # an infinite bound is valid
            growth = np.expm1(COPPER_PER_K * heating * duration_s)
        return float(hottest + (above + 1 / COPPER_PER_K) * growth)

    def simulate(
        self, effective_square_A2: FloatArray, steps_s: FloatArray, start_C: FloatArray | None = None
    ) -> tuple[FloatArray, FloatArray]:
        """Winding and housing temperature, exact for heating that is constant over each step.

        The matrix exponential of the two nodes is computed in closed form, so the time constants may be arbitrarily
        short relative to the steps.

        Parameters
        ----------
        effective_square_A2 : (M, K) mean of i_eff^2 over each of K steps for M waveforms [A^2].
        steps_s : (K,) step lengths [s].
        start_C : (M, 2) winding and housing at the start; default: the model's start temperatures.

        Returns
        -------
        winding_C, housing_C : (M, K + 1) each, the start temperatures first; infinite after an overflow.
        """
        M, K = effective_square_A2.shape
        start = np.array([self.start_winding_C, self.start_housing_C])
        start = np.broadcast_to(start if start_C is None else start_C, (M, 2))
        compiled = heated(self._rates, effective_square_A2, steps_s, start)
        if compiled is not None:
            return compiled[0], compiled[1]
        with np.errstate(over="ignore", invalid="ignore"):  # an unstable wall lets the current grow without bound
            (p11, p12, p21, p22), (s1, s2) = self._steps(effective_square_A2, steps_s)
            # Recursion of the rise d above the start, d+ = (1 + p) d + (p T_0 + s), so that small rises keep digits.
            growth, forcing, (winding, housing) = np.empty((M, K, 4)), np.zeros((M, K + 1, 2)), start.T[..., None]
            growth[..., 0], growth[..., 1], growth[..., 2], growth[..., 3] = 1 + p11, p12, p21, 1 + p22
            forcing[:, 1:, 0] = p11 * winding + p12 * housing + s1
            forcing[:, 1:, 1] = p21 * winding + p22 * housing + s2
            rises = np.empty_like(forcing)
            for rise, P, f in zip(rises, growth.reshape(M, K, 2, 2), forcing, strict=True):
                rise[:] = forwards(P, f)
        # After an infinite value the banded solver returns NaN.
        rises[~np.isfinite(rises)] = np.inf
        return rises[..., 0] + winding, rises[..., 1] + housing

    @property
    def _rates(self) -> FloatArray:
        """(6,) numbers h of dT/dt = ((h_0 q - h_1, h_1), (h_2, h_3)) T + (h_4 q, h_5) with q = i_eff^2."""
        C_w = self.tau_w_s / self.R_wh_K_W
        C_h = self.tau_h_s / self.R_ha_K_W if self.nodes == 2 else np.inf
        g_w, g_h, by_heat = 1 / self.R_wh_K_W, 1 / self.R_ha_K_W, self.R_ohm / C_w
        at_zero = 1 - COPPER_PER_K * RESISTANCE_REFERENCE_C
        to_housing = g_w / C_h, -(g_w + g_h) / C_h
        return np.array(
            [COPPER_PER_K * by_heat, g_w / C_w, *to_housing, at_zero * by_heat, g_h * self.ambient_C / C_h]
        )

    def _steps(
        self, effective_square_A2: FloatArray, steps_s: FloatArray
    ) -> tuple[tuple[FloatArray, ...], tuple[FloatArray, ...]]:
        """Increment of both nodes' temperatures over each step, T+ - T = p T + s.

        dT/dt = m T + c has the increment h phi(h m) (m T + c) with phi(x) = (e^x - 1) / x. A function f of a 2 x 2
        matrix m with eigenvalues a +- d is f(m) = (f(a + d) + f(a - d)) / 2 + (f(a + d) - f(a - d)) / (2 d) (m - a).

        Returns
        -------
        The entries p11, p12, p21, p22 and s1, s2, (M, K) each.
        """
        by_heat, m12, m21, m22, pushed, c2 = self._rates.tolist()
        m11, c1 = by_heat * effective_square_A2 - m12, pushed * effective_square_A2
        mean, half = (m11 + m22) / 2, (m11 - m22) / 2
        # The eigenvalues are real, as the thermal network is symmetric up to its capacities.
        distance = np.maximum(np.sqrt(half**2 + m12 * m21), np.finfo(float).tiny)

        def increment(rate: FloatArray) -> FloatArray:
            x = rate * steps_s
            small = np.abs(x) < 1e-8
            return np.asarray(steps_s * np.where(small, 1 + x / 2, np.expm1(x) / np.where(small, 1.0, x)))

        fast, slow = increment(mean - distance), increment(mean + distance)
        level, slope = (slow + fast) / 2, (slow - fast) / (2 * distance)
        f11, f12, f21, f22 = level + slope * half, slope * m12, slope * m21, level - slope * half
        return (
            (f11 * m11 + f12 * m21, f11 * m12 + f12 * m22, f21 * m11 + f22 * m21, f21 * m12 + f22 * m22),
            (f11 * c1 + f12 * c2, f21 * c1 + f22 * c2),
        )

    def steady_course(
        self, effective_square_A2: FloatArray, steps_s: FloatArray, pause_s: float, idle_A: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Winding and housing over a tap in the steady state of periodic repetition.

        The temperatures after one period are affine in those before it; the start is their fixed point. They are
        infinite under thermal runaway, where every tap leaves the coil hotter.

        Parameters
        ----------
        effective_square_A2 : (M, K) mean of i_eff^2 over each step of the tap, for M waveforms [A^2].
        steps_s : (K,) step lengths [s].
        pause_s : time from the tap's end to the start of the next.
        idle_A : (M,) currents in the pause, without ripple.

        Returns
        -------
        winding_C, housing_C : (M, K + 1) each, as `simulate` gives them.
        """
        M = effective_square_A2.shape[0]
        pause_steps = np.full(PAUSE_STEPS, pause_s / PAUSE_STEPS)
        idle = np.broadcast_to(effective_square(idle_A, self.ripple_A)[:, None], (M, PAUSE_STEPS))
        heat = np.concatenate([effective_square_A2, idle], axis=1)
        steps = np.concatenate([steps_s, pause_steps])

        def after_period(winding_C: float, housing_C: float) -> FloatArray:
            start: FloatArray = np.full((M, 2), (winding_C, housing_C))
            return np.stack([course[:, -1] for course in self.simulate(heat, steps, start)], axis=1)

        origin, m = after_period(0.0, 0.0), self.nodes
        with np.errstate(invalid="ignore"):  # inf - inf under a runaway within one period
            transition = np.stack([after_period(1.0, 0.0) - origin, after_period(0.0, 1.0) - origin], axis=2)
            own, from_housing = transition[:, :m, :m], transition[:, :m, m:]
            # For one node the housing keeps its temperature, to which the winding settles.
            settled = origin[:, :m] + self.start_housing_C * from_housing.sum(axis=2)
        finite = np.all(np.isfinite(transition), axis=(1, 2))
        stable = finite.copy()
        stable[finite] = np.abs(np.linalg.eigvals(own[finite])).max(axis=1) < 1
        steady = np.full((M, 2), np.inf)
        steady[stable, m:] = self.start_housing_C
        steady[stable, :m] = np.linalg.solve(np.eye(m) - own[stable], settled[stable][..., None])[..., 0]
        K = steps_s.size + 1
        winding, housing = (np.full((M, K), np.inf) for _ in range(2))
        courses = self.simulate(heat[stable], steps, steady[stable])
        winding[stable], housing[stable] = (course[:, :K] for course in courses)
        return winding, housing


@dataclass(frozen=True)
class Circuit:
    """Motor terminals: V = R i + L di/dt + k_e w, the back-EMF stated at the tip.

    Attributes
    ----------
    R_ohm : resistance of the winding; that of a datasheet holds at 25 C.
    L_H : inductance of the winding.
    emf_V_s_m : back-EMF per m/s of the stylus tip, k_e times the transmission's ratio; in SI equal to the force per
        ampere.
    """

    R_ohm: float
    L_H: float
    emf_V_s_m: float

    def voltage_V(self, current_A: FloatArray, rate_A_s: FloatArray | float, velocity_m_s: FloatArray) -> FloatArray:
        """V for a current, its rate, and the velocity of the motor mass dz/dt, (...) each."""
        return np.asarray(self.R_ohm * current_A + self.L_H * rate_A_s + self.emf_V_s_m * velocity_m_s)

    def at(self, winding_C: float) -> "Circuit":
        """The circuit with the copper at another temperature, where this one states R at 25 C."""
        warmer = 1 + COPPER_PER_K * (winding_C - RESISTANCE_REFERENCE_C)
        return replace(self, R_ohm=self.R_ohm * warmer)
