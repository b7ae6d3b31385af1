"""Certificate of optimality without a solver (DESIGN 4)."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from transopt.base.signals import FloatArray
from transopt.plant.coil import PWM_RIPPLE_A
from transopt.plant.discretise import Motion
from transopt.plant.wall import earlier_by, feedback_command_transpose
from transopt.problem.problem import STAGEWISE, Certificate, Multipliers, TransientProblem

BINDING_MULTIPLIER = 1e-9  # 1/A; an interior-point method leaves about 1e-13 on a limit that does not bind
BINDING_SLACK = 1e-5  # of the limit
SILENT = 1e-12  # of the limit: what rounding leaves of no transient at all over a wall
DRAWS = 4  # of last bits, of which none may speak for rounding alone


def _moved(by_movement: FloatArray) -> FloatArray:
    """Transpose of dc_k = c_k - c_(k-1)."""
    return np.asarray(by_movement - np.append(by_movement[1:], 0.0))


@dataclass(frozen=True)
class Box:
    """One limit along the horizon: |value| <= bound, or value <= bound without `lower`."""

    name: str
    unit: str
    lower: FloatArray | None
    upper: FloatArray
    value: FloatArray
    bound: FloatArray
    stated: float  # the limit in the user's words

    @property
    def excess(self) -> FloatArray:
        """(N,) how far the value is outside, negative inside."""
        size = self.value if self.lower is None else np.abs(self.value)
        return np.asarray(size - self.bound)

    @property
    def tolerance(self) -> float:
        return Certificate.VIOLATION_TOLERANCE if self.unit == "C" else Certificate.tolerated(self.stated)

    @property
    def complementarity(self) -> float:
        """Sum of multiplier times slack, slacks by their size; a limit of infinity has no multiplier."""
        if not (self.upper.any() or (self.lower is not None and self.lower.any())):
            return 0.0
        stated = np.isfinite(self.bound)
        upper, value, bound = self.upper[stated], self.value[stated], self.bound[stated]
        total = float(upper @ np.abs(bound - value))
        return total if self.lower is None else total + float(self.lower[stated] @ np.abs(bound + value))


class Effect:
    """What a command (N,) does in a problem, each part computed when it is first asked for and then kept.

    Parameters
    ----------
    motion : of the problem's own device, where it is known already.
    """

    def __init__(self, problem: TransientProblem, command_A: FloatArray, motion: Motion | None = None) -> None:
        self.problem, self.command_A = problem, command_A
        if motion is not None:
            self.motion = motion

    @cached_property
    def motion(self) -> Motion:
        return self.problem.stage.motion(self.command_A)

    @cached_property
    def accelerations_m_s2(self) -> FloatArray:
        """(S, N) of every device."""
        others = [device.rollout(self.command_A)[0] for device in self.problem.spread]
        return np.stack([self.motion.acceleration_m_s2, *others])

    @cached_property
    def mean_square_A2(self) -> FloatArray:
        """(N,) mean of i_eff^2 over each period; of a problem with a temperature limit, as what follows."""
        assert self.problem.thermal is not None
        return self.problem.thermal.model.heating.mean_square(self.motion.current_A, self.command_A)

    @cached_property
    def rise_K(self) -> FloatArray:
        """(N + 1, m) of the nodes at tau_0 to tau_N."""
        assert self.problem.thermal is not None
        return self.problem.thermal.model.rise(self.mean_square_A2)

    def by_heating(self, multipliers: Multipliers) -> FloatArray:
        """(N,) gradient of the temperature limit's part of the Lagrangian by the heatings; zero without one."""
        thermal, by_winding = self.problem.thermal, multipliers.temperature_upper
        if thermal is None or not by_winding.any():
            return np.zeros(self.command_A.size)
        return thermal.model.adjoint(self.mean_square_A2, by_winding, self.rise_K)


def boxes(problem: TransientProblem, command_A: FloatArray, motion: Motion, multipliers: Multipliers) -> list[Box]:
    """Every limit that the problem has, with what the command does to it."""
    return list(_boxes(Effect(problem, command_A, motion), multipliers))


def _boxes(effect: Effect, multipliers: Multipliers) -> Iterator[Box]:
    problem, command_A, motion = effect.problem, effect.command_A, effect.motion
    limits, m, N = problem.limits, multipliers, problem.grid.stages

    def box(name: str, unit: str, pair: str, value: FloatArray, bound: float) -> Box:
        lower, upper = getattr(m, f"{pair}_lower"), getattr(m, f"{pair}_upper")
        return Box(name, unit, lower, upper, value, np.full(N, bound), bound)

    yield box("current", "A", "current", motion.current_A, limits.current_A)
    if limits.command_A is not None:
        yield box("command", "A", "command", command_A, limits.command_A)
    if limits.slew_A_per_s is not None:
        movement = np.diff(command_A, prepend=0.0)
        yield box("slew", "A/tick", "slew", movement, limits.slew_A_per_s * problem.grid.dt_s)
    if problem.supply is not None:
        before, after = problem.supply.voltages_V(motion, command_A)
        yield box("supply", "V", "supply_before", before, problem.supply.limit_V)
        yield box("supply", "V", "supply_after", after, problem.supply.limit_V)
    if problem.thermal is not None:
        model = problem.thermal.model
        winding, limit = effect.rise_K[1:, 0] + model.unpowered_C, model.headroom_K + model.unpowered_C
        yield Box("coil", "C", None, m.temperature_upper, winding, limit, problem.thermal.limit_C)


def inside(
    problem: TransientProblem, command_A: FloatArray, *, only: str | None = None, effect: Effect | None = None
) -> bool:
    """Whether a command keeps all limits, or only those of one name, without any tolerance.

    Parameters
    ----------
    effect : of this command in this problem, where further questions about it follow.
    """
    limits = _boxes(effect or Effect(problem, command_A), Multipliers.zero(problem))
    return all(bool((box.excess <= 0).all()) for box in limits if only in (None, box.name))


def reduced_gradient(
    problem: TransientProblem, command_A: FloatArray, motion: Motion, multipliers: Multipliers
) -> FloatArray:
    """(N,) gradient by the commands of J + sum mu (constraint) + sum hand_over (c - feedback) [1/A]."""
    effect = Effect(problem, command_A, motion)
    return _reduced_gradient(effect, multipliers, effect.by_heating(multipliers))


def _reduced_gradient(effect: Effect, multipliers: Multipliers, by_heating: FloatArray) -> FloatArray:
    problem, command_A, motion = effect.problem, effect.command_A, effect.motion
    m, r = multipliers, problem.reference_m_s2
    scale = 2 / (float(r @ r) * len(problem.devices))
    by_command = m.command_upper - m.command_lower

    def by_acceleration(acceleration_m_s2: FloatArray) -> FloatArray:
        weighted = scale * problem.tracking_weights * problem.weighted_error(acceleration_m_s2)
        return weighted if problem.error_filter is None else problem.error_filter.transpose(weighted)

    by_current = m.current_upper - m.current_lower
    by_velocity = np.zeros_like(by_current)
    by_encoder = np.zeros_like(by_current)
    if problem.supply is not None:
        before, after = m.supply_before_upper - m.supply_before_lower, m.supply_after_upper - m.supply_after_lower
        through_current, by_velocity, directly = problem.supply.transpose(before, after)
        by_current, by_command = by_current + through_current, by_command + directly
    if problem.thermal is not None and by_heating.any():
        heating = problem.thermal.model.heating
        through_current, directly = heating.gradient(motion.current_A, command_A, m.current_sign)
        by_current, by_command = by_current + by_heating * through_current, by_command + by_heating * directly
    tail = np.append(np.zeros(problem.free_stages), m.hand_over)
    by_command = by_command + tail
    if problem.wall is not None:
        dt, late = problem.grid.dt_s, problem.stage.whole_delay + 1
        by_feedback = feedback_command_transpose(-tail, problem.stage.amplifier, dt)
        by_encoder = earlier_by(late, problem.wall.feedback_transpose(by_feedback, dt))
    movement = np.diff(command_A, prepend=0.0)
    by_movement = 2 * problem.movement_weight * movement + m.slew_upper - m.slew_lower
    own = Motion(by_acceleration(motion.acceleration_m_s2), by_current, by_velocity, by_encoder)
    gradient = problem.stage.adjoint(own) + _moved(by_movement) + by_command
    for device, acceleration in zip(problem.spread, effect.accelerations_m_s2[1:], strict=True):
        tracking = replace(Motion.zero(acceleration.size), acceleration_m_s2=by_acceleration(acceleration))
        gradient = gradient + device.adjoint(tracking)
    return np.asarray(gradient)


def gradient_rounding(problem: TransientProblem, command_A: FloatArray, multipliers: Multipliers) -> FloatArray:
    """(N,) what rounding makes of the reduced gradient of the Lagrangian [1/A].

    Every command is moved by its last bit, up or down by lot, and the gradient is taken again. The change has both
    causes in it: the answer cannot be stored more finely, and the sums of the gradient round. Its size is averaged
    over a few draws, so that no entry is small because two roundings cancel. The lot is the same for every call.
    """
    m = admissible(problem, multipliers)

    def gradient(command: FloatArray) -> FloatArray:
        return reduced_gradient(problem, command, problem.stage.motion(command), m)

    own, lot = gradient(command_A), np.random.default_rng(0)
    signs = lot.choice((-1.0, 1.0), (DRAWS, command_A.size))
    moved = command_A * (1 + np.finfo(float).eps * signs)
    return np.asarray(np.mean([np.abs(gradient(command) - own) for command in moved], axis=0))


def admissible(problem: TransientProblem, multipliers: Multipliers) -> Multipliers:
    """The same >= 0, and zero where there is no limit to bear them: a headroom may be infinite at some instants."""
    clipped = multipliers.clipped()
    if problem.thermal is None or not clipped.temperature_upper.any():
        return clipped
    bears = np.isfinite(problem.thermal.model.headroom_K)
    return replace(clipped, temperature_upper=np.where(bears, clipped.temperature_upper, 0.0))


def kink_gap(problem: TransientProblem, command_A: FloatArray, motion: Motion, multipliers: Multipliers) -> float:
    """What the tangent at |mean i| with the stated slope lies below it; zero where the slope is its sign."""
    effect = Effect(problem, command_A, motion)
    return _kink_gap(effect, multipliers, effect.by_heating(multipliers))


def _kink_gap(effect: Effect, multipliers: Multipliers, by_heating: FloatArray) -> float:
    thermal = effect.problem.thermal
    if thermal is None or not by_heating.any():
        return 0.0
    mean = thermal.model.heating.mean_current(effect.motion.current_A, effect.command_A)
    short = np.abs(mean) - multipliers.current_sign * mean
    return float(np.abs(by_heating) @ (2 * PWM_RIPPLE_A * short))


def certify(
    problem: TransientProblem,
    command_A: FloatArray,
    multipliers: Multipliers,
    lower_bound: float = -np.inf,
    *,
    effect: Effect | None = None,
) -> Certificate:
    """Bound the distance of a command from the optimum.

    J is convex in the commands, so for any mu >= 0 the optimum is at least
    min over |c| <= c_max of the Lagrangian's tangent, which gives

        gap = sum_j mu_j s_j + sum_k |g_k| (c_max + |c_k|)

    with s the slacks and g the reduced gradient of the Lagrangian over the commands. Negative slacks
    count by their size. The hand-over multipliers are checked too: they must cancel g over the hand-over,
    or what is left of it counts with c_max (so that a lost or flipped one is noticed, although the
    hand-over commands cannot move). Where the temperature binds, the Lagrangian is not convex: the gap is then
    that of a stationary point, and `lower_bound` has to come from the convex problem of `solvers.global_bound`.

    Parameters
    ----------
    command_A : (N,).
    lower_bound : of the optimum, from elsewhere; not needed while no temperature multiplier is positive.
    effect : of this command in this problem, where it is known already.
    """
    N = problem.grid.stages
    signed = [getattr(multipliers, name) for name in STAGEWISE]
    arrays = [command_A, *signed, multipliers.hand_over]
    shapes = [(N,)] * (1 + len(signed)) + [(problem.hand_over_samples,)]
    if [a.shape for a in arrays] != shapes or not np.isfinite(np.concatenate(arrays)).all():
        return Certificate.nothing()

    effect, clipped = effect or Effect(problem, command_A), admissible(problem, multipliers)
    limits, silent = list(_boxes(effect, clipped)), problem.reference_is_zero
    objective = 0.0 if silent else problem.objective(command_A, effect.accelerations_m_s2)

    if not all(np.isfinite(box.value).all() for box in limits):
        # Thermal runaway: there is no steady state to speak of.
        return replace(Certificate.nothing(), objective=objective)

    over = [float(box.excess.max()) for box in limits]

    def violation(*units: str) -> float:
        return max((by for by, box in zip(over, limits, strict=True) if box.unit in units), default=0.0)

    tail = (command_A - problem.hand_over_command(effect.motion))[problem.free_stages :]
    off = float(np.abs(tail).max())
    excess = [by / box.tolerance for by, box in zip(over, limits, strict=True)]
    excess.append(off / Certificate.tolerated(problem.limits.current_A))
    found = Certificate(
        objective=objective,
        primal_violation_A=max(violation("A", "A/tick"), off, 0.0),
        primal_violation_V=max(violation("V"), 0.0),
        primal_violation_K=max(violation("C"), 0.0),
        excess=max(*excess, 0.0),
        dual_residual=0.0,
        duality_gap=0.0,
        lower_bound=0.0,
        finite=True,
    )
    if silent:
        # The stated answer is the zero waveform, over a wall as without one; J is not defined.
        zero = float(np.abs(problem.transient_command(command_A)).max()) <= SILENT * problem.limits.current_A
        return found if zero else replace(found, duality_gap=float("inf"), lower_bound=-float("inf"))

    by_heating = effect.by_heating(clipped)
    g = _reduced_gradient(effect, clipped, by_heating)
    c_max = problem.limits.command_bound_A
    gap = float(np.abs(g) @ (c_max + np.abs(command_A))) + sum(box.complementarity for box in limits)
    gap += float(np.abs(clipped.hand_over) @ np.abs(tail)) + _kink_gap(effect, clipped, by_heating)
    convex = problem.thermal is None or problem.thermal.model.copper == 0 or not clipped.temperature_upper.any()
    return replace(
        found,
        dual_residual=float(np.abs(g).max()),
        duality_gap=gap,
        lower_bound=max(objective - gap, lower_bound) if convex else lower_bound,
    )


def relaxed_bound(effect: Effect, multipliers: Multipliers) -> float:
    """Rigorous lower bound on J where the warming copper makes the problem nonconvex, from its own multipliers.

    Any multipliers of the convex problem (`ThermalLimit.relaxed`) bound its optimum, which bounds this one's: those
    are taken under which heat has the price that it has here: what is stationary here is stationary there too.
    All that the bound then lacks is what the limits differ by, price times slack. Minus infinity where taps repeat:
    there the two problems price heat over different times.

    Parameters
    ----------
    effect : of the command in the problem. multipliers : its own, as `certify` takes them.
    """
    problem, command_A = effect.problem, effect.command_A
    thermal = problem.thermal
    if thermal is None or thermal.model.closure is not None:
        return -np.inf
    relaxed = replace(problem, thermal=thermal.relaxed(problem.limits.current_A))
    assert relaxed.thermal is not None
    prices = relaxed.thermal.model.prices(effect.by_heating(admissible(problem, multipliers)))
    priced = replace(multipliers, temperature_upper=np.maximum(prices, 0.0))
    return certify(relaxed, command_A, priced, effect=Effect(relaxed, command_A, effect.motion)).lower_bound


def spans_ms(problem: TransientProblem, active: NDArray[np.bool_]) -> str:
    """From when to when a limit is active, in milliseconds after contact."""
    times_ms = problem.grid.switching_times_s * 1e3
    edges = np.flatnonzero(np.diff(np.concatenate([[0], active.astype(int), [0]])))
    spans = [
        f"{times_ms[first]:.2f}" + (f" to {times_ms[after - 1]:.2f}" if after - first > 1 else "")
        for first, after in zip(edges[::2], edges[1::2], strict=True)
    ]
    return ", ".join(spans)


def binding_limits(problem: TransientProblem, command_A: FloatArray, multipliers: Multipliers) -> str:
    """Which limits bind, with which sign and from when to when, in the user's words; "none" if none does.

    A limit binds at a stage where its multiplier is positive beyond rounding and its slack is gone.
    """
    if multipliers.largest <= BINDING_MULTIPLIER:
        return "none"
    limits = boxes(problem, command_A, problem.stage.motion(command_A), multipliers)
    rows: dict[str, NDArray[np.bool_]] = {}
    for box in limits:
        near = BINDING_SLACK * np.where(np.isfinite(box.bound), np.abs(box.bound), 1.0)
        sides = [("+" if box.lower is not None else "", box.upper, box.bound - box.value)]
        if box.lower is not None:
            sides.append(("-", box.lower, box.bound + box.value))
        for sign, mu, slack in sides:
            active = (mu > BINDING_MULTIPLIER) & (np.abs(slack) < near)
            label = f"{box.name} {sign}{box.stated:.8g} {box.unit}"
            rows[label] = rows.get(label, np.zeros(active.size, dtype=bool)) | active
    found = sorted((int(np.argmax(active)), label) for label, active in rows.items() if active.any())
    return "; ".join(f"{label} at {spans_ms(problem, rows[label])} ms" for _, label in found) or "none"
