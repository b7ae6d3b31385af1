"""Admission: whether an answer that was proven and replayed may stand in a library, and what speaks against it."""

import numpy as np

from transopt.base.signals import FloatArray
from transopt.plant.wall import Wall
from transopt.problem.answer import Status
from transopt.problem.limits import hand_over
from transopt.problem.limits.limit import Limit, tolerated
from transopt.problem.limits.temperature import TemperatureLimit
from transopt.problem.problem import TransientProblem
from transopt.problem.wall_ticks import encoder_course, pressing
from transopt.proof.continuous import after_s
from transopt.proof.designed import Designed
from transopt.proof.replay import Replay

GROWS = 1e-6  # per tick: more than rounding


def admit(designed: Designed, played: Replay) -> tuple[Status, list[str]]:
    """Whether an answer may stand in a library: optimal, certified and replayed clean.

    Returns
    -------
    The entry's status and, unless it is OPTIMAL or on a nonlinear plant STATIONARY, what speaks against it, one
    sentence each.
    """
    status, said = _admitted(designed, played)
    return status, designed.remarks or said


def _admitted(designed: Designed, played: Replay) -> tuple[Status, list[str]]:
    if designed.nonlinear is not None:
        return _admitted_as_stationary(designed, played)
    status, certificate, problem = designed.solution.status, designed.certificate, designed.problem
    if status is not Status.OPTIMAL:
        return status, [status.value]
    # For a limit of a user's own that is not convex nobody can promise more than a stationary point.
    bent = certificate.is_stationary and any(name != TemperatureLimit.name for name in problem.nonlinear)
    if not (certificate.accepted or bent):
        below = certificate.is_stationary and certificate.relative_bound > certificate.BOUND_TOLERANCE
        return Status.NOT_GLOBAL if below else Status.NOT_CERTIFIED, [certificate.shortfall]
    command = designed.solution.command
    shortfalls = played.shortfalls(problem, command, designed.effect.motion.acceleration_m_s2)
    if not shortfalls:
        return Status.OPTIMAL, []
    unstable = unstable_wall(problem)
    if unstable:
        return Status.UNSTABLE_WALL, [unstable]
    left = [limit for limit in problem.limits if played.leaves(limit)]
    late = [limit for limit in left if problem.wall is not None and played.leaves_late(limit)]
    between = [limit.unresolved(problem, command, played.peak(limit)) for limit in left if limit not in late]
    if problem.wall is not None and not left and (elsewhere := _pushes_elsewhere(played, problem, command)):
        return Status.HAND_OVER, [elsewhere]
    # A cause that explains some of it is no cause.
    if len(left) < len(shortfalls) or not all(between):
        return Status.REPLAY_VIOLATION, shortfalls
    return (
        (Status.HAND_OVER, [_after_hand_over(played, problem, late), *between])
        if late
        else (
            Status.UNRESOLVED,
            between,
        )
    )


def _admitted_as_stationary(designed: Designed, played: Replay) -> tuple[Status, list[str]]:
    """Whether an answer on a nonlinear plant is a certified stationary point and replayed clean."""
    answer, certificate = designed.solution, designed.certificate
    predicted = designed.effect.motion.acceleration_m_s2
    shortfalls = played.shortfalls(designed.problem, designed.effect.command, predicted)
    if answer.status is not Status.OPTIMAL:
        return answer.status, [f"IPOPT: {answer.message}", *shortfalls]
    if not certificate.is_stationary:
        return Status.NOT_CERTIFIED, [certificate.shortfall, *shortfalls]
    return (Status.REPLAY_VIOLATION, shortfalls) if shortfalls else (Status.STATIONARY, [])


def _pushes_elsewhere(played: Replay, problem: TransientProblem, command: FloatArray) -> str:
    """Whether the wall pushes at other ticks of the hand-over than the optimum was sought for; empty if not."""
    assert problem.wall is not None
    truly = pressing(problem, encoder_course(problem, command)).wall
    assert truly is not None
    ticks = int(np.sum((truly.pressing != problem.wall.pressing)[max(problem.free_stages - 1, 0) :]))
    if not ticks:
        return ""
    off = float(np.abs(played.command - command).max())
    return (
        f"hand-over: the stylus grazes the surface, and the wall pushes at {ticks} of its ticks other than the "
        f"optimum was sought for: the command is {off:.1e} {problem.driven_by.unit} off, limit "
        f"{tolerated(problem.limits.input_limit):.0e} {problem.driven_by.unit}"
    )


def _after_hand_over(played: Replay, problem: TransientProblem, late: list[Limit]) -> str:
    """What the wall does with the limits when the waveform has ended, which no transient can help any more."""
    assert problem.wall is not None
    asked = " and ".join(
        f"a {limit.label} of {played.peak(limit):.6g} {limit.unit}, {played.peak(limit) - limit.stated:.2g} "
        f"{limit.unit} over its limit of {limit.stated:g} {limit.unit}"
        for limit in late
    )
    return (
        f"hand-over: within {after_s(problem.grid) * 1e3:g} ms after the last command the wall alone asks for "
        f"{asked}, with {stated_wall(problem.wall.wall)}"
    )


def unstable_wall(problem: TransientProblem) -> str:
    """Whether the pressing wall grows by itself on this device; empty if it does not."""
    if problem.wall is None:
        return ""
    growth = hand_over.growth(problem)
    if growth <= 1 + GROWS:
        return ""
    stated = stated_wall(problem.wall.wall)
    return f"feedback: on this device the pressing wall grows {growth:.4g} times per tick, with {stated}"


def stated_wall(wall: Wall) -> str:
    """What a scene says of its wall, as far as that is not zero."""
    numbers = {
        "feedback.stiffness_N_m": (wall.stiffness_N_m, " N/m"),
        "feedback.damping_N_s_m": (wall.damping_N_s_m, " N s/m"),
        "feedback.latency_ticks": (wall.latency_ticks, ""),
    }
    return ", ".join(f"{key} = {value:g}{unit}" for key, (value, unit) in numbers.items() if value > 0)
