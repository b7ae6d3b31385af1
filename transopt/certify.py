"""Certificate of optimality without a solver (DESIGN 4)."""

from dataclasses import fields

import numpy as np

from transopt.problem import Certificate, Multipliers, TransientProblem
from transopt.signals import FloatArray

BINDING_MULTIPLIER = 1e-9  # 1/A; an interior-point method leaves about 1e-13 on a limit that does not bind
BINDING_SLACK = 1e-5  # of the limit current


def _moved(by_movement: FloatArray) -> FloatArray:
    """Transpose of dc_k = c_k - c_(k-1)."""
    return np.asarray(by_movement - np.append(by_movement[1:], 0.0))


def reduced_gradient(
    problem: TransientProblem, command_A: FloatArray, acceleration_m_s2: FloatArray, multipliers: Multipliers
) -> FloatArray:
    """(N,) gradient by the commands of J + sum mu (constraint), hand-over multipliers not included [1/A]."""
    r = problem.reference_m_s2
    by_acceleration = 2 * problem.tracking_weights * (acceleration_m_s2 - r) / float(r @ r)
    by_current = multipliers.current_upper - multipliers.current_lower
    movement = np.diff(command_A, prepend=0.0)
    by_movement = 2 * problem.movement_weight * movement + multipliers.slew_upper - multipliers.slew_lower
    by_command = multipliers.command_upper - multipliers.command_lower
    return problem.stage.adjoint(by_acceleration, by_current) + _moved(by_movement) + by_command


def certify(problem: TransientProblem, command_A: FloatArray, multipliers: Multipliers) -> Certificate:
    """Bound the distance of a command from the optimum.

    J is convex in the commands, so for any mu >= 0 the optimum is at least
    min over |c| <= c_max of the Lagrangian's tangent, which gives

        gap = sum_j mu_j s_j + sum_k |g_k| (c_max + |c_k|)

    with s the slacks and g the reduced gradient of the Lagrangian over the free commands. Negative slacks
    count by their size. The hand-over multipliers are checked too: they must cancel g over the hand-over,
    or what is left of it counts with c_max (so that a lost or flipped one is noticed, although the
    hand-over commands cannot move).

    Parameters
    ----------
    command_A : (N,).
    """
    limits, N = problem.limits, problem.grid.stages
    signed = [getattr(multipliers, field.name) for field in fields(multipliers) if field.name != "hand_over"]
    arrays = [command_A, *signed, multipliers.hand_over]
    shapes = [(N,)] * 7 + [(problem.hand_over_samples,)]
    if [a.shape for a in arrays] != shapes or not all(np.all(np.isfinite(a)) for a in arrays):
        return Certificate(float("nan"), float("inf"), float("inf"), float("inf"), finite=False)

    if problem.reference_is_zero:
        # The stated answer is the zero waveform; J is not defined.
        peak = float(np.abs(command_A).max())
        return Certificate(0.0, peak, 0.0, 0.0 if peak == 0.0 else float("inf"), finite=True)

    acceleration, current = problem.stage.rollout(command_A)
    movement = np.diff(command_A, prepend=0.0)
    objective = problem.objective(command_A, acceleration)
    c_max = limits.command_bound_A

    boxes = [(multipliers.current_lower, multipliers.current_upper, current, limits.current_A)]
    if limits.command_A is not None:
        boxes.append((multipliers.command_lower, multipliers.command_upper, command_A, limits.command_A))
    if limits.slew_A_per_s is not None:
        step = limits.slew_A_per_s * problem.grid.dt_s
        boxes.append((multipliers.slew_lower, multipliers.slew_upper, movement, step))
    violation = max(float((np.abs(value) - bound).max()) for _, _, value, bound in boxes)
    tail = command_A[problem.free_stages :]
    violation = max(violation, float(np.abs(tail).max()), 0.0)

    clipped = multipliers.clipped()
    g = reduced_gradient(problem, command_A, acceleration, clipped)
    g[problem.free_stages :] += clipped.hand_over
    gap = float(np.abs(g) @ (c_max + np.abs(command_A)))
    for lower, upper, value, bound in boxes:
        gap += float(np.maximum(lower, 0) @ np.abs(bound + value) + np.maximum(upper, 0) @ np.abs(bound - value))
    return Certificate(objective, violation, float(np.abs(g).max()), gap, finite=True)


def binding_limits(problem: TransientProblem, command_A: FloatArray, multipliers: Multipliers) -> str:
    """Which limits bind, with which sign and from when to when, in the user's words; "none" if none does.

    A limit binds at a stage where its multiplier is positive beyond rounding and its slack is gone.
    """
    _, current = problem.stage.rollout(command_A)
    limits, grid = problem.limits, problem.grid
    movement = np.diff(command_A, prepend=0.0)
    step = np.inf if limits.slew_A_per_s is None else limits.slew_A_per_s * grid.dt_s
    bound = np.inf if limits.command_A is None else limits.command_A
    m = multipliers
    rows = [
        (f"current +{limits.current_A:g} A", m.current_upper, limits.current_A - current),
        (f"current -{limits.current_A:g} A", m.current_lower, limits.current_A + current),
        (f"command +{bound:g} A", m.command_upper, bound - command_A),
        (f"command -{bound:g} A", m.command_lower, bound + command_A),
        ("slew up", m.slew_upper, step - movement),
        ("slew down", m.slew_lower, step + movement),
    ]
    times_ms = grid.switching_times_s * 1e3
    found = []
    for name, mu, slack in rows:
        active = (mu > BINDING_MULTIPLIER) & (np.abs(slack) < BINDING_SLACK * limits.current_A)
        edges = np.flatnonzero(np.diff(np.concatenate([[0], active.astype(int), [0]])))
        spans = [
            f"{times_ms[first]:.2f}" + (f" to {times_ms[after - 1]:.2f}" if after - first > 1 else "")
            for first, after in zip(edges[::2], edges[1::2], strict=True)
        ]
        if spans:
            found.append((times_ms[edges[0]], f"{name} at {', '.join(spans)} ms"))
    return "; ".join(text for _, text in sorted(found)) or "none"
