"""Certificate of optimality from a command and multipliers, independent of the solver."""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from transopt.base.signals import FloatArray, is_finite
from transopt.plant.discretise import Motion, StageModel
from transopt.problem.answer import OBJECTIVE_SCALE, Certificate, Multipliers
from transopt.problem.limits import hand_over
from transopt.problem.limits.limit import Limit, tolerated
from transopt.problem.limits.own import LawRow
from transopt.problem.limits.row import transposed
from transopt.problem.objective.tracking import gradients
from transopt.problem.problem import TransientProblem, objectives
from transopt.proof.effect import TEMPERATURE, Effect, Together, alike, boxes_of, warm_up

BINDING_MULTIPLIER = 1e-9  # least multiplier of a binding limit [1/A]; interior-point methods leave 1e-13 on others
BINDING_SLACK = 1e-5  # largest slack of a binding limit, as a share of the limit
SILENT = 1e-12  # largest transient that is zero up to rounding over a wall, as a share of the limit
MOST_TOGETHER = 2**17  # numbers in the commands certified side by side: a megabyte an array
DRAWS = 4  # random perturbations by which `gradient_rounding` estimates the rounding error


def reduced_gradient(effect: Effect, multipliers: Multipliers, *, of_limits_alone: bool = False) -> FloatArray:
    """(N,) or (m, N) gradient by the commands of L + sum mu (constraint) + sum hand_over (c - feedback) [1/A].

    L is the minimised function, J where intensity has no price; `of_limits_alone` leaves it out.
    """
    one, by_heating = Together([effect], [multipliers]), effect.by_heating(multipliers)[None]
    return np.asarray(_reduced_gradients(one, by_heating, of_limits_alone=of_limits_alone)[0])


def _reduced_gradients(some: Together, by_heating: FloatArray | None, *, of_limits_alone: bool = False) -> FloatArray:
    """(G, N) or (G, m, N) `reduced_gradient` of commands side by side."""
    problem, command, motion, motors = some.problem, some.command, some.motions[0], some.problem.stage.motors
    pairs = [(row, some.pairs[row.name]) for _, row in problem.rows() if row.name in some.pairs]
    by_row = [(row, upper - lower) for row, (lower, upper) in pairs]
    by_command = hand_over.padded(problem, np.stack([each.hand_over for each in some.multipliers]))
    by_encoder = problem.feedback.transposed(-by_command)
    through = list[Motion]()
    for number, its_motion in enumerate(some.motions):
        its_own, directly = transposed(
            [each for each in by_row if each[0].device == number], its_motion, command, motors
        )
        through.append(its_own)
        by_command = by_command + directly
    by_input = through[0].plant_input
    if problem.thermal is not None and by_heating is not None and by_heating.any():
        slope = np.stack([each.slope for each in some.multipliers])
        by_current, directly = problem.thermal.model.heating.gradient(motion.plant_input, command, slope)
        by_input, by_command = by_input + by_heating * by_current, by_command + by_heating * directly
    if problem.heat_price > 0 and not of_limits_alone:
        by_input = by_input + problem.heat.gradient(motion.plant_input)
    through[0] = replace(through[0], plant_input=by_input, encoder_m=by_encoder)
    if of_limits_alone:
        return np.asarray(sum(map(StageModel.adjoint, problem.devices, through)) + by_command)
    # The tracking term also depends on the motion after the window; no limit's row does.
    costs, after = [effect.problem.tracking for effect in some.effects], problem.grid.after_stages
    by_error = gradients(costs, some.accelerations_m_s2, problem.shared)
    of_devices = [by_error] if problem.directions else [by_error[:, j] for j in range(len(through))]
    by_lasting = sum(
        device.adjoint(replace(its_own.padded(after), acceleration_m_s2=by_its_error))
        for device, its_own, by_its_error in zip(problem.devices, through, of_devices, strict=True)
    )
    by_tracking = problem.feedback.continued_transposed(np.asarray(by_lasting))
    return np.asarray(by_tracking + problem.movement.gradient(command) + by_command)


def gradient_rounding(problem: TransientProblem, command: FloatArray, multipliers: Multipliers) -> FloatArray:
    """(N,) estimate of the rounding error of the reduced gradient of the Lagrangian [1/A].

    Every command is perturbed by its last bit with a random sign, and the gradient is computed again. The change
    covers both causes: commands have a finite resolution, and the sums of the gradient round. Its absolute value is
    averaged over a few draws, so that no entry is small because two roundings cancel. The random signs are the same
    for every call.
    """
    m = admissible(problem, multipliers)

    def gradient(moved: FloatArray) -> FloatArray:
        return reduced_gradient(Effect(problem, moved), m)

    own, lot = gradient(command), np.random.default_rng(0)
    signs = lot.choice((-1.0, 1.0), (DRAWS, *command.shape))
    nearby = command * (1 + np.finfo(float).eps * signs)
    return np.asarray(np.mean([np.abs(gradient(moved) - own) for moved in nearby], axis=0))


def admissible(problem: TransientProblem, multipliers: Multipliers) -> Multipliers:
    """Clip multipliers to >= 0, and to zero where a bound is infinite.

    There is no slack to such a bound, so that a multiplier would cost nothing and could cancel any gradient.
    """
    clipped = multipliers.clipped()
    pairs = dict(clipped.pairs)
    for _, row in problem.rows():
        if row.name in pairs:
            lower, upper = pairs[row.name]
            pairs[row.name] = _of_bound(lower, row.lower), _of_bound(upper, row.upper)
    if problem.thermal is not None and TEMPERATURE in pairs:
        lower, upper = pairs[TEMPERATURE]
        pairs[TEMPERATURE] = np.zeros_like(lower), _of_bound(upper, problem.thermal.model.headroom_K)
    return replace(clipped, pairs=pairs)


def _of_bound(multipliers: FloatArray, bound: FloatArray | float) -> FloatArray:
    """(N,) multipliers of a bound, zero where it is infinite."""
    if isinstance(bound, np.ndarray):
        return np.where(np.isfinite(bound), multipliers, 0.0)
    return multipliers if math.isfinite(bound) else np.zeros_like(multipliers)


def kink_gap(effect: Effect, multipliers: Multipliers, by_heating: FloatArray) -> float:
    """Gap of the Lagrangian by the kink of |mean i|: how far the tangent with the stated slope lies below it.

    It is zero where the slope is the sign of the mean.

    Parameters
    ----------
    by_heating : `Effect.by_heating` of the multipliers.
    """
    thermal = effect.problem.thermal
    if thermal is None or not by_heating.any():
        return 0.0
    mean = thermal.model.heating.mean_current(effect.motion.plant_input, effect.command)
    short = np.abs(mean) - multipliers.slope * mean
    return float(np.abs(by_heating) @ (2 * thermal.model.heating.ripple_A * short))


def certify(
    problem: TransientProblem,
    command: FloatArray,
    multipliers: Multipliers,
    *,
    effect: Effect | None = None,
) -> Certificate:
    """Bound the distance of a command from the optimum, by `certify_all`.

    Parameters
    ----------
    command : (N,).
    effect : effect of this command in this problem, if it is known already.
    """
    return certify_all([(effect or Effect(problem, command), multipliers)])[0]


def certify_all(answers: Sequence[tuple[Effect, Multipliers]]) -> list[Certificate]:
    """Bound the distance of commands, each given by its effect, from the optima of their problems.

    The minimised function, J or, where intensity has a price, L, is convex in the commands. So for any mu >= 0 the
    optimum is at least the minimum over |c| <= c_max of the Lagrangian's tangent, which gives

        gap = sum_j mu_j s_j + sum_k |g_k| (c_max + |c_k|)

    with the slacks s, negative ones by their size, and the reduced gradient g of the Lagrangian over the commands. If
    that exceeds the accepted gap, `movement_bound` replaces the second sum if it is smaller: it is quadratic in g,
    hence small for rounding errors. The hand-over multipliers are checked too: they must cancel g over the hand-over,
    and any remainder counts with c_max, so that a lost or flipped multiplier is noticed although the hand-over
    commands are fixed. Where the temperature binds, the Lagrangian is not convex: the gap is then that of a
    stationary point, and the lower bound, minus infinity here, has to come from the convex problem of
    `TemperatureLimit.relaxed`.

    Problems that differ only in their targets, such as those of one grip, are computed side by side.
    """
    found = dict[int, Certificate]()
    groups: dict[tuple[object, ...], list[int]] = {}
    for i, (effect, multipliers) in enumerate(answers):
        if is_stated(effect.problem, effect.command, multipliers):
            groups.setdefault(alike(effect), []).append(i)
        else:
            found[i] = Certificate.nothing()
    for group in groups.values():
        some = max(MOST_TOGETHER // answers[group[0]][0].command.size, 1)
        for part in (group[first : first + some] for first in range(0, len(group), some)):
            effects = [answers[i][0] for i in part]
            clipped = [admissible(answers[i][0].problem, answers[i][1]) for i in part]
            with np.errstate(over="ignore", invalid="ignore"):  # an unstable wall; multipliers of 1e300
                found |= zip(part, _certificates(Together(effects, clipped)), strict=True)
    return [found[i] for i in range(len(answers))]


class _Numbers(NamedTuple):
    """What the certificate of one command is made of.

    Attributes
    ----------
    objective, merit : J and L.
    outside : (rows,) largest violation of each row, negative where it holds; finite whether all values of rows are.
    tail : (h,) residual of the hand-over.
    slack : sum of the multipliers times the slacks, those of the temperature left out.
    by_command : sum_k |g_k| (c_max + |c_k|) with the reduced gradient g.
    gradient : (N,) or (m, N) g.
    by_heating : (N,) `Effect.by_heating`; None without a multiplier of the temperature.
    """

    objective: float
    merit: float
    outside: FloatArray
    finite: bool
    tail: FloatArray
    slack: float
    by_command: float
    gradient: FloatArray
    by_heating: FloatArray | None


def _certificates(some: Together) -> list[Certificate]:
    """Certificates of commands side by side, whose multipliers are `admissible`."""
    problem, effects, multipliers = some.problem, some.effects, some.multipliers
    problems, inputs = [effect.problem for effect in effects], some.motions[0].plant_input
    known = np.array([each.tracking.energy_m2_s4 > 0 for each in problems])
    objective = np.where(known, objectives(problems, some.command, some.accelerations_m_s2, inputs), 0.0)
    rewards = [effect.problem.tracking.reward(effect.accelerations_m_s2) for effect in effects]
    tails = np.stack([hand_over.residual(effect.problem, effect.command, effect.motion) for effect in effects])
    slack = _sum(np.abs([each.hand_over for each in multipliers]) * np.abs(tails))
    finite, outside = np.ones(len(effects), dtype=bool), np.empty((len(effects), len(problem.rows())))
    for j, (_, row) in enumerate(problem.rows()):
        value, lower, upper = some.row(j)
        finite &= np.isfinite(value).all(axis=-1)
        above, below = value - upper, lower - value
        outside[:, j] = np.maximum(above, below).max(axis=-1)
        if row.name in some.pairs:
            slack += sum(map(_paired, some.pairs[row.name], (below, above)))
    hot = [problem.thermal is not None and each.most(TEMPERATURE) > 0 for each in multipliers]
    warm_up([effect for effect in effects if not effect.problem.stays_cool])
    by_heating = None
    if any(hot):
        by_heating = np.stack([effect.by_heating(each) for effect, each in zip(effects, multipliers, strict=True)])
    g = _reduced_gradients(some, by_heating)
    by_command = _sum(np.abs(g) * (problem.command_bound + np.abs(some.command)))
    sums = (objective, objective - np.where(known, rewards, 0.0), slack, by_command)
    J, merit, slacks, by_commands = (of.astype(float).tolist() for of in sums)  # plain numbers, of extended ones too
    numbers = zip(
        *(J, merit, outside, finite.tolist(), tails, slacks, by_commands, g),
        ([None] * len(hot) if by_heating is None else by_heating),
        strict=True,
    )
    judged = zip(effects, multipliers, numbers, strict=True)
    return [_certificate(effect, each, _Numbers(*own)) for effect, each, own in judged]


def _certificate(effect: Effect, multipliers: Multipliers, numbers: _Numbers) -> Certificate:
    problem, J, merit = effect.problem, numbers.objective, numbers.merit
    if not np.isfinite(merit):
        # A gap relative to an infinite objective would be accepted.
        return Certificate.nothing()
    outside = [(limit, by) for (limit, _), by in zip(problem.rows(), numbers.outside.tolist(), strict=True)]
    violations, excess = left_over(problem, outside, float(np.abs(numbers.tail).max()), winding=effect)
    if not (numbers.finite and np.isfinite(excess)):
        # Thermal runaway: there is no steady state.
        return replace(Certificate.nothing(), objective=J, merit=merit)
    dual_residual, rest = float(np.abs(numbers.gradient).max()), numbers.slack
    if numbers.by_heating is not None:
        rest += _of_temperature(effect, multipliers, numbers.by_heating)
    if problem.worst:
        # The mean by the shares bounds the worst device's loss from below, and `merit` is that loss.
        rest += problem.tracking.above_mean(effect.accelerations_m_s2)
    gap, bounds = numbers.by_command + rest, is_convex(problem, multipliers)
    if gap > Certificate.GAP_TOLERANCE * max(J, OBJECTIVE_SCALE):
        gap = float(np.fmin(gap, movement_bound(problem, numbers.gradient) + rest))
    if problem.reference_is_zero:
        # For a target of zero in the window the answer is the zero transient, with or without a wall.
        is_zero = bool(np.abs(problem.transient_command(effect.command)).max() <= SILENT * problem.limits.input_limit)
        dual_residual, gap, bounds = 0.0, 0.0 if is_zero else np.inf, True
    elif not np.isfinite(gap):
        dual_residual, gap = np.inf, np.inf
    return Certificate(
        objective=J,
        merit=merit,
        violations=violations,
        excess=excess,
        dual_residual=dual_residual,
        duality_gap=gap,
        lower_bound=merit - gap if bounds else -np.inf,
        finite=True,
    )


def _sum(courses: FloatArray) -> FloatArray:
    """(G,) sums over courses (G, ...)."""
    return np.asarray(courses.reshape(len(courses), -1).sum(axis=1))


def _paired(multipliers: FloatArray, outside: FloatArray) -> FloatArray:
    """(G,) sums of multiplier times |slack| over the finite bounds, for values so far `outside` of them (G, N)."""
    return _sum(multipliers * np.abs(np.where(np.isfinite(outside), outside, 0.0)))


def _of_temperature(effect: Effect, multipliers: Multipliers, by_heating: FloatArray) -> float:
    """What the temperature's multipliers add to the gap: their slacks, and the kink of |mean i|."""
    assert effect.problem.thermal is not None
    above = effect.winding_C - effect.problem.thermal.bounds_C
    slacks = float(_paired(multipliers.upper(TEMPERATURE)[None], above[None])[0])
    return slacks + kink_gap(effect, multipliers, by_heating)


def is_convex(problem: TransientProblem, multipliers: Multipliers) -> bool:
    """Whether tangents of the Lagrangian give a lower bound: every limit with a multiplier is proven convex."""
    warms = problem.thermal is not None and problem.thermal.model.copper != 0
    if warms and multipliers.upper(TEMPERATURE).any():
        return False
    return not any(
        isinstance(row, LawRow) and not row.convex and any(side.any() for side in multipliers.pairs.get(row.name, ()))
        for _, row in problem.rows()
    )


def under_further_limits(proof: Certificate, effect: Effect, known: TransientProblem) -> Certificate:
    """The certificate of a command under further limits, whose multipliers are zero.

    Parameters
    ----------
    proof : its certificate in the problem `known`.
    effect : its effect in the same problem with the further limits.
    """
    problem, rows = effect.problem, {row.name for _, row in known.rows()}
    outside = list[tuple[Limit, float]]()
    for limit, row in problem.rows():
        if row.name not in rows:
            value, (lower, upper) = effect.value(row), row.bounds(problem.grid.stages)
            outside.append((limit, float(np.maximum(value - upper, lower - value).max())))
    violations, excess = left_over(problem, outside, 0.0, winding=effect if known.thermal is None else None)
    for unit, by in proof.violations.items():
        violations[unit] = max(violations.get(unit, 0.0), by)
    return replace(proof, violations=violations, excess=max(excess, proof.excess))


def is_stated(problem: TransientProblem, command: FloatArray, multipliers: Multipliers) -> bool:
    """Whether command and multipliers have the problem's shapes and are finite."""
    N, arrays = problem.grid.stages, [command, *multipliers.arrays()]
    motors = problem.rest.shape[:-1]
    shapes = [(*motors, N)] + [(N,)] * (len(arrays) - 3) + [(*motors, problem.hand_over_samples), (N,)]
    return [a.shape for a in arrays] == shapes and all(map(is_finite, arrays))


def left_over(
    problem: TransientProblem, outside: Sequence[tuple[Limit, float]], off: float, *, winding: Effect | None = None
) -> tuple[dict[str, float], float]:
    """Violations of limits and hand-over by unit, and the largest one divided by its tolerance.

    Parameters
    ----------
    outside : limits, each with its largest violation, negative where it holds.
    off : largest residual of the hand-over [A].
    winding : effect whose winding's temperature is judged too, unless the other limits, being kept, imply its limit.
    """
    if winding is not None and problem.thermal is not None:
        kept = problem.stays_cool and all(by <= limit.tolerance for limit, by in outside)
        hotter = 0.0 if kept else float((winding.winding_C - problem.thermal.bounds_C).max())
        outside = [*outside, (problem.thermal, np.inf if np.isnan(hotter) else hotter)]
    violations, excess = {"A": max(off, 0.0)}, [off / tolerated(problem.limits.input_limit), 0.0]
    for limit, by in outside:
        unit = limit.base_unit()
        violations[unit] = max(violations.get(unit, 0.0), by)
        excess.append(by / limit.tolerance)
    return violations, max(excess)


def movement_bound(problem: TransientProblem, gradient: FloatArray) -> float:
    """Bound on the decrease of the Lagrangian that a reduced gradient (N,) permits, from the movement's curvature.

    The Lagrangian without the movement's term is convex and lies above its tangent; that term is w sum m_k^2 with m_k
    the changes of the command. A step with changes m thus changes the Lagrangian by at least
    sum_k (G_k m_k + w m_k^2), G_k = sum_(j >= k) g_j, whose minimum over all m is -sum G_k^2 / (4 w). The bound is
    infinite for w = 0. With several motors, (m, N), the sums of all motors are added.
    """
    to_come = np.cumsum(gradient[..., ::-1], axis=-1)
    weight = problem.movement.weight
    return float(np.vdot(to_come, to_come)) / (4 * weight) if weight > 0 else np.inf


def relaxed_bound(effect: Effect, multipliers: Multipliers) -> float:
    """Rigorous lower bound on J where warming copper makes the problem nonconvex, from the problem's own multipliers.

    Any multipliers of the convex relaxation (`TemperatureLimit.relaxed`) give a lower bound on its optimum and so on
    this problem's. The multipliers are chosen such that heat has the same price as here: a stationary point here is
    then one there too, and the bound's gap is only price times the difference of the limits. For repeating taps the
    bound is minus infinity, as `HeatModel.prices` is implemented for a single tap only.

    Parameters
    ----------
    effect : effect of the command in the problem.
    multipliers : multipliers of the problem, as for `certify`.
    """
    problem, command = effect.problem, effect.command
    thermal = problem.thermal
    if thermal is None or thermal.model.closure is not None:
        return -np.inf
    relaxed_limit = thermal.relaxed()
    relaxed = problem.replaced(relaxed_limit)
    prices = relaxed_limit.model.prices(effect.by_heating(admissible(problem, multipliers)))
    priced = multipliers.with_pair(TEMPERATURE, np.zeros_like(prices), np.maximum(prices, 0.0))
    return certify(relaxed, command, priced, effect=effect.of(relaxed)).lower_bound


def _spans_ms(problem: TransientProblem, stages: NDArray[np.intp]) -> str:
    """The time spans of ascending stages, in milliseconds after contact."""
    ends, times_s = np.flatnonzero(np.diff(stages) > 1).tolist(), problem.grid.switching_times_s
    spans = zip([0, *(end + 1 for end in ends)], [*ends, -1], strict=True)
    found = [(1e3 * float(times_s[stages[first]]), 1e3 * float(times_s[stages[last]])) for first, last in spans]
    return ", ".join(f"{first:.2f}" + (f" to {last:.2f}" if last > first else "") for first, last in found)


def binding_limits(
    problem: TransientProblem, command: FloatArray, multipliers: Multipliers, *, effect: Effect | None = None
) -> str:
    """The binding limits with sign and time spans, in words; "none" if none binds.

    A limit binds at a stage where its multiplier exceeds `BINDING_MULTIPLIER` and its slack is below `BINDING_SLACK`.

    Parameters
    ----------
    effect : effect of this command in this problem, if it is known already.
    """
    stages: dict[str, NDArray[np.intp]] = {}
    for box in boxes_of(effect or Effect(problem, command), multipliers, above=BINDING_MULTIPLIER):
        near = BINDING_SLACK * abs(box.limit.stated)
        for side, mu, bound in (("upper", box.by_upper, box.upper), ("lower", box.by_lower, box.lower)):
            at = np.flatnonzero(mu > BINDING_MULTIPLIER)
            at = at[np.abs(bound[at] - box.value[at]) < near]
            if not at.size:
                continue
            two_sided = bool(np.isfinite(box.lower).any())
            label = (
                f"{box.name} {box.limit.bound_in_words(side, two_sided=two_sided)} {box.limit.key_unit()}".rstrip()
            )
            label = f"{label} {box.condition}".rstrip()
            stages[label] = np.union1d(stages[label], at) if label in stages else at
    found = sorted((int(at[0]), label) for label, at in stages.items())
    return "; ".join(f"{label} at {_spans_ms(problem, stages[label])} ms" for _, label in found) or "none"
