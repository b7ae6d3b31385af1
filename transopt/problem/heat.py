"""The recursion of the winding's temperature that the optimal-control problem uses."""

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np

from transopt.base.errors import InputError
from transopt.base.matrices import expm
from transopt.base.recursions import Recursion, backwards, bilinear, filtered
from transopt.base.shown import brief
from transopt.base.signals import FloatArray
from transopt.plant.amplifier import Amplifier
from transopt.plant.coil import COPPER_PER_K, PWM_RIPPLE_A, RESISTANCE_REFERENCE_C, CoilModel
from transopt.plant.time_grid import TimeGrid

# Margin below the limit, as a share of the largest rise, where taps repeat for ever. The recursion neglects the heat
# of a current that changes its sign within a servo period, and the steady state sums that up over all taps.
STEADY_MARGIN = 2e-4


def mean_current(share: Any, decay: Any, current: Any, command: Any) -> Any:
    """Mean of i over a period in which it goes from `current` towards `command`; for arrays or CasADi expressions."""
    return share * current + (1 - share) * (decay * current + (1 - decay) * command)


def mean_square(square: Any, decay: Any, ripple: Any, current: Any, command: Any, size: Any) -> Any:
    """Mean of (|i| + ripple)^2 over that period (seed Eq. 7), `size` the mean of |i|; for arrays or expressions."""
    a, b = current, decay * current + (1 - decay) * command
    return square[0] * a * a + square[1] * a * b + square[2] * b * b + 2 * ripple * size + ripple**2


def next_rise(M: Any, b: Any, gain: Any, copper: Any, rise: Any, winding: Any, heating: Any) -> Any:
    """th_(k+1) = M th_k + b (gain_k + copper th_w,k) h_k; for arrays or expressions, thermal nodes in rows."""
    return M @ rise + b @ ((gain + copper * winding) * heating)


@dataclass(frozen=True)
class Heating:
    """Mean of i_eff^2 over one servo period as a function of the current i_k and the command c_k.

    The current approaches i_(k+1) = decay i_k + (1 - decay) c_k exponentially. Its mean square is a convex quadratic
    in i_k and c_k. The mean of |i| is |mean of i| unless the sign changes within the period, and is taken as that:
    mean i_eff^2 = quadratic + 2 ripple |mean i| + ripple^2, which is convex.

    Attributes
    ----------
    decay : exp(-w dt) of the amplifier's pole w; 0 for an ideal amplifier, i = c_k throughout.
    square : (3,) weights of i_k^2, i_k i_(k+1), i_(k+1)^2 in the mean square.
    share : weight of i_k in the mean current.
    ripple_A : constant of seed Eq. 7.
    """

    decay: float
    square: FloatArray
    share: float
    ripple_A: float = PWM_RIPPLE_A

    def after(self, current_A: FloatArray, command: FloatArray) -> FloatArray:
        """i_(k+1)."""
        return np.asarray(self.decay * current_A + (1 - self.decay) * command)

    def mean_current(self, current_A: FloatArray, command: FloatArray) -> FloatArray:
        """(...) mean current over the period [A]."""
        return np.asarray(mean_current(self.share, self.decay, current_A, command))

    def mean_square(self, current_A: FloatArray, command: FloatArray) -> FloatArray:
        """(...) mean of i_eff^2 = (|i| + ripple)^2 over the period [A^2]."""
        size = np.abs(self.mean_current(current_A, command))
        return np.asarray(mean_square(self.square, self.decay, self.ripple_A, current_A, command, size))

    def gradient(self, current_A: FloatArray, command: FloatArray, sign: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Derivatives of `mean_square` by the current and by the command, (...) each [A].

        Parameters
        ----------
        sign : (...) subgradient of |mean i|: the sign of the mean, and any number in [-1, 1] where it is zero.
        """
        a, b = current_A, self.after(current_A, command)
        by_a = 2 * self.square[0] * a + self.square[1] * b + 2 * self.ripple_A * self.share * sign
        by_b = 2 * self.square[2] * b + self.square[1] * a + 2 * self.ripple_A * (1 - self.share) * sign
        return by_a + self.decay * by_b, (1 - self.decay) * by_b


@lru_cache(maxsize=16)
def heating(amplifier: Amplifier | None, dt_s: float, ripple_A: float = PWM_RIPPLE_A) -> Heating:
    """`Heating` of one servo period with this amplifier; None is an ideal one."""
    if amplifier is None:
        return Heating(0.0, np.array([0.0, 0.0, 1.0]), 0.0, ripple_A)
    x = amplifier.rate_rad_s * dt_s
    e = float(np.exp(-x))
    # i(t) = (1 - s) i_k + s i_(k+1) with s = (1 - exp(-w t)) / (1 - e); s1, s2: means of s and s^2 over the period.
    s1 = (1 + np.expm1(-x) / x) / (1 - e)
    s2 = (1 + 2 * np.expm1(-x) / x - np.expm1(-2 * x) / (2 * x)) / (1 - e) ** 2
    return Heating(e, np.array([1 - 2 * s1 + s2, 2 * (s1 - s2), s2]), float(1 - s1), ripple_A)


@dataclass(frozen=True)
class HeatModel:
    """Rise th of the thermal nodes above their temperatures without current, with h_k the mean i_eff^2 of period k:

        th_(k+1) = M th_k + b (gain_k + copper th_w,k) h_k,    th_w the winding's.

    The temperature limit at tau_(k+1) is `th_w,(k+1) <= headroom_k`. For a single tap th_0 = 0. Taps that repeat for
    ever are periodic, th_0 = F th_N + f, where F and f describe the pause between two taps.

    Attributes
    ----------
    heating : h_k as a function of current and command.
    M : (m, m), winding first, then housing.
    b : (m,) [K/W].
    gain : (N,) resistance at the temperature without current [ohm].
    copper : increase of the resistance per kelvin of rise [ohm/K].
    headroom_K : (N,), infinite where there is no limit.
    closure : (F (m, m), f (m,)) of repeating taps; None for a single one.
    unpowered_C : (N,) winding temperature at tau_(k+1) without current.
    """

    heating: Heating
    M: FloatArray
    b: FloatArray
    gain: FloatArray
    copper: float
    headroom_K: FloatArray
    closure: tuple[FloatArray, FloatArray] | None
    unpowered_C: FloatArray

    __repr__ = brief

    @property
    def nodes(self) -> int:
        """m, 1 for the winding alone or 2 with the housing."""
        return int(self.b.size)

    def _course(self, h: FloatArray, gain: FloatArray, start: FloatArray) -> FloatArray:
        """(N + 1, m) rises at tau_0 to tau_N from the rise `start` (m,) at tau_0."""
        return bilinear(self.M, self.b, gain, self.copper, h, start)

    def _start(self, h: FloatArray) -> FloatArray:
        """(m,) rise at the first switching instant."""
        if self.closure is None:
            return np.zeros(self.nodes)
        F, f = self.closure
        units = [self._course(h, np.zeros(h.size), unit)[-1] for unit in np.eye(self.nodes)]
        offset = self._course(h, self.gain, np.zeros(self.nodes))[-1]
        with np.errstate(over="ignore", invalid="ignore"):  # thermal runaway, tested below
            period = F @ np.stack(units, axis=1)
        if not (np.all(np.isfinite(period)) and np.abs(np.linalg.eigvals(period)).max() < 1):
            # Thermal runaway: the rise grows from tap to tap, and the equation's fixed point is unstable.
            return np.full(self.nodes, np.inf)
        return np.asarray(np.linalg.solve(np.eye(self.nodes) - period, F @ offset + f))

    def rise(self, h: FloatArray) -> FloatArray:
        """(N + 1, m) rises at tau_0 to tau_N for heatings h (N,) [A^2]; infinite without a steady state."""
        start = self._start(h)
        if not np.all(np.isfinite(start)):
            return np.full((h.size + 1, self.nodes), np.inf)
        return self._course(h, self.gain, start)

    def adjoint(self, h: FloatArray, by_winding: FloatArray, rise: FloatArray | None = None) -> FloatArray:
        """(N,) gradient by h for a gradient `by_winding` (N,) by th_w,(k+1).

        Parameters
        ----------
        rise : (N + 1, m) that of h, if it is known already.
        """
        course = self.rise(h) if rise is None else rise
        P = np.repeat(self.M[None], h.size, axis=0)
        P[:, :, 0] += self.b * (self.copper * h)[:, None]
        m = self.nodes

        def by_rises(at_end: FloatArray, forcing: FloatArray) -> FloatArray:
            """(N, m) gradients by th_1 to th_N."""
            by_rise = np.zeros((h.size, m))
            by_rise[:, 0] = forcing
            by_rise[-1] += at_end
            return backwards(P[1:], by_rise)

        end = np.zeros(m)
        if self.closure is not None:
            F, _ = self.closure
            # The pause couples the adjoint at both ends of the tap, nu_N = F' nu_0: a linear fixed point.
            free = P[0].T @ by_rises(end, by_winding)[0]
            silent = np.zeros(h.size)
            transition = np.stack([P[0].T @ by_rises(unit, silent)[0] for unit in np.eye(m)], axis=1)
            end = np.linalg.solve(np.eye(m) - F.T @ transition, F.T @ free)
        nu = by_rises(end, by_winding)
        return np.asarray((nu @ self.b) * (self.gain + self.copper * course[:-1, 0]))

    def prices(self, by_h: FloatArray) -> FloatArray:
        """(N,) gradient by th_w,(k+1) whose `adjoint` is `by_h` (N,): the inverse, for copper = 0 and a single tap.

        by_h / gain is that gradient, filtered backwards in time by the winding's impulse response to one heating.
        """
        assert self.copper == 0
        assert self.closure is None
        if self.nodes == 1:
            answer, own = self.b, np.array([1.0, -self.M[0, 0]])
        else:
            (ww, wh), (hw, hh) = self.M
            answer = np.array([self.b[0], wh * self.b[1] - hh * self.b[0]])
            own = np.array([1.0, -ww - hh, ww * hh - wh * hw])
        return filtered(own / answer[0], answer / answer[0], (by_h / self.gain)[::-1])[::-1]


@dataclass(frozen=True)
class Budget:
    """Requirements on the winding's temperature beyond its limit over the horizon.

    Attributes
    ----------
    headroom_K : largest rise of one tap above the start temperature; None for no such requirement.
    tap_rate_Hz : rate at which the same tap repeats for ever; None for a single tap.
    idle_A : current in the pause between taps, without ripple. None: zero or, with a wall, the wall's feedback at the
        end of the window (`limits.temperature.with_pause_current`).
    """

    headroom_K: float | None = None
    tap_rate_Hz: float | None = None
    idle_A: float | None = None

    @property
    def pause_A(self) -> float:
        """Current in the pause, zero where none is stated [A]."""
        return 0.0 if self.idle_A is None else self.idle_A


def winding_limit_C(coil: CoilModel, budget: Budget) -> float:
    """The lower of the winding's limit and of the start temperature plus the headroom."""
    return coil.limit_C if budget.headroom_K is None else min(coil.limit_C, coil.start_winding_C + budget.headroom_K)


def steady_margin_K(coil: CoilModel, budget: Budget) -> float:
    """Margin below the limit where taps repeat for ever [K]; see `STEADY_MARGIN`."""
    return STEADY_MARGIN * (winding_limit_C(coil, budget) - coil.rest_C)


def _under_power(coil: CoilModel, held: FloatArray, effective_A: float) -> FloatArray:
    """(m + 1, m + 1) generator F of d(th, 1)/dt = F (th, 1) under a constant effective current.

    th is the rise above rest; the constant 1 as a further state makes the affine equation linear.
    """
    m = held.shape[0] - 1
    power, inflow = coil.R_ohm * effective_A**2, held[:m, m]
    generator = held.copy()
    generator[:m, 0] += inflow * power * COPPER_PER_K
    generator[:m, m] = inflow * power * (1 + COPPER_PER_K * (coil.rest_C - RESISTANCE_REFERENCE_C))
    return generator


@dataclass(frozen=True)
class _Nodes:
    """The part of a coil's `HeatModel` on one grid that does not depend on the start temperatures.

    Attributes
    ----------
    M, b : as in `HeatModel`.
    held : (m + 1, m + 1) generator of the rises above rest and of the constant 1, which stands for one watt.
    winding : (N + 1, m) rise of the winding without current at tau_0 to tau_N, for a unit rise of each node at tau_0.
    waiting : (m + 1, m + 1) transition from the first command to tau_0, while the ripple alone heats.
    """

    M: FloatArray
    b: FloatArray
    held: FloatArray
    winding: FloatArray
    waiting: FloatArray


@lru_cache(maxsize=16)
def _nodes(coil: CoilModel, grid: TimeGrid) -> _Nodes:
    flow, inflow = coil.flow()
    m, N = inflow.size, grid.stages
    held = np.zeros((m + 1, m + 1))
    held[:m, :m], held[:m, m] = flow, inflow
    hold = expm(held * grid.dt_s)
    M, b = hold[:m, :m], hold[:m, m]
    courses, unpowered = [], Recursion(M)
    for unit in np.eye(m):
        start = np.zeros((N + 1, m))
        start[0] = unit
        courses.append(unpowered.run(start)[:, 0])
    waiting = expm(_under_power(coil, held, coil.ripple_A) * grid.delay_s)
    return _Nodes(M, b, held, np.stack(courses, axis=1), waiting)


@lru_cache(maxsize=64)  # the entries of a scene without a wall share one model
def heat_model(coil: CoilModel, amplifier: Amplifier | None, grid: TimeGrid, budget: Budget) -> HeatModel:
    """The winding's model over one horizon: from the coil's start temperatures or, with a tap rate, periodic.

    Raises
    ------
    InputError : a tap takes longer than the time between taps.
    """
    # `_nodes` does not read the start temperatures: with fixed ones its cache serves every start of the coil.
    nodes = _nodes(replace(coil, start_winding_C=coil.limit_C, start_housing_C=coil.rest_C), grid)
    m, dt, N = nodes.b.size, grid.dt_s, grid.stages
    unpowered = np.full(N + 1, coil.rest_C)
    closure, margin_K = None, 0.0
    if budget.tap_rate_Hz is None:
        # The start temperatures hold when the first command is issued. The command acts at tau_0, an amplifier's
        # delay later; until then the ripple alone heats.
        start = np.array([coil.start_winding_C, coil.start_housing_C])[:m] - coil.rest_C
        unpowered += nodes.winding @ (nodes.waiting[:m, :m] @ start + nodes.waiting[:m, m])
    else:
        pause = _under_power(coil, nodes.held, budget.pause_A + coil.ripple_A)
        pause_s, takes_s = 1 / budget.tap_rate_Hz - N * dt, (N + 1) * dt + grid.delay_s
        if not 1 / budget.tap_rate_Hz > takes_s:
            raise InputError(
                f"thermal: tap_rate_Hz = {budget.tap_rate_Hz:g} Hz: a tap takes {takes_s * 1e3:g} ms, the "
                "amplifier's delay included: lower it"
            )
        with np.errstate(over="ignore", invalid="ignore"):  # thermal runaway under the pause's current
            paused = expm(pause * pause_s)
        closure = (paused[:m, :m], paused[:m, m])
        margin_K = steady_margin_K(coil, budget)
    return HeatModel(
        heating=heating(amplifier, dt, coil.ripple_A),
        M=nodes.M,
        b=nodes.b,
        gain=coil.R_ohm * (1 + COPPER_PER_K * (unpowered[:-1] - RESISTANCE_REFERENCE_C)),
        copper=coil.R_ohm * COPPER_PER_K,
        headroom_K=winding_limit_C(coil, budget) - margin_K - unpowered[1:],
        closure=closure,
        unpowered_C=unpowered[1:],
    )
