"""Admission of an answer to a library: its status after certificate and replay, and the reasons against it."""

import numpy as np

from transopt.base.signals import FloatArray
from transopt.plant.nonlinear_stage import MOST_SUBSTEPS, NonlinearStage
from transopt.plant.wall import Wall
from transopt.problem.answer import Status
from transopt.problem.limits import hand_over
from transopt.problem.limits.limit import Limit, tolerated
from transopt.problem.problem import TransientProblem
from transopt.problem.wall_ticks import encoder_course, pressing
from transopt.proof.continuous import AGREEMENT, after_s
from transopt.proof.designed import Designed
from transopt.proof.replay import Replay

NO_MOTION = (
    "the motion has no value: a formula of model.nonlinear has none where it goes, or drives it without end; lower "
    "limits.stroke_m to where the formulas hold"
)
STEPS_OF_FRICTION = 40.0  # integration steps in the time within which the friction at rest stops the moving part
ROUNDED = "where the slope of abs(z) jumps there may be no stationary point: write sqrt(z**2 + e**2) - e for it"
UNSTABLE_GROWTH = 1e-6  # excess of the spectral radius over 1 per tick beyond rounding


def admit(designed: Designed, played: Replay) -> tuple[Status, list[str]]:
    """Decide whether an answer may enter a library: it must be optimal, certified, and feasible in the replay.

    Returns
    -------
    The entry's status and, unless it is OPTIMAL or STATIONARY, the reasons, one sentence each.
    """
    status, reasons = _admitted(designed, played)
    return status, designed.remarks or reasons


def _admitted(designed: Designed, played: Replay) -> tuple[Status, list[str]]:
    if designed.nonlinear is not None:
        return _admitted_as_stationary(designed, played)
    status, certificate, problem = designed.solution.status, designed.certificate, designed.problem
    if status is not Status.OPTIMAL:
        return status, [status.value]
    if not designed.is_accepted:
        below = certificate.is_stationary and certificate.relative_bound > certificate.BOUND_TOLERANCE
        return Status.NOT_GLOBAL if below else Status.NOT_CERTIFIED, [_unproven(designed)]
    command = designed.solution.command
    shortfalls = played.shortfalls(problem, command, designed.effect.motion.acceleration_m_s2)
    if not shortfalls:
        return Status.OPTIMAL if certificate.accepted else Status.STATIONARY, []
    unstable = unstable_wall(problem)
    if unstable:
        return Status.UNSTABLE_WALL, [unstable]
    left = [limit for limit in problem.limits if played.leaves(limit)]
    late = [limit for limit in left if problem.wall is not None and played.leaves_late(limit)]
    between = [limit.unresolved(problem, command, played.peak(limit)) for limit in left if limit not in late]
    if problem.wall is not None and not left and (elsewhere := _pushes_elsewhere(played, problem, command)):
        return Status.HAND_OVER, [elsewhere]
    # The causes count only if they explain all shortfalls.
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
    """Status of an answer on a nonlinear plant: STATIONARY if certified and feasible in the replay."""
    answer, certificate = designed.solution, designed.certificate
    predicted = designed.effect.motion.acceleration_m_s2
    assert designed.nonlinear is not None
    cause = _too_sharp(designed.nonlinear.stage)
    shortfalls = played.shortfalls(designed.problem, designed.effect.command, predicted, cause)
    if not np.isfinite(played.acceleration_m_s2).all():
        shortfalls = [NO_MOTION]
    if answer.status is not Status.OPTIMAL:
        shortfalls += _no_smooth_search(designed.nonlinear.stage)
        missed = _missed(designed) if answer.status is Status.INFEASIBLE else []
        return answer.status, [f"IPOPT: {answer.message}", *missed, *shortfalls]
    if not certificate.is_stationary:
        return Status.NOT_CERTIFIED, [_unproven(designed), *shortfalls]
    if played.step_error <= AGREEMENT < played.off(predicted):
        shortfalls.append(cause)
    return (Status.REPLAY_VIOLATION, shortfalls) if shortfalls else (Status.STATIONARY, [])


def _unproven(designed: Designed) -> str:
    """Why the certificate is not accepted; the limits that the answer leaves by name."""
    missed = _missed(designed)
    return f"not certified: {' and '.join(missed)}" if missed else designed.certificate.shortfall


def _missed(designed: Designed) -> list[str]:
    return [row.missed(designed.problem.grid) for row in designed.missed]


def _too_steep(stage: NonlinearStage) -> str:
    """Message if the friction at rest is too steep for the finest integration steps; empty otherwise."""
    finest_s, slope = stage.dt_s / MOST_SUBSTEPS, stage.plant.friction_slope_N_s_m
    most = stage.plant.moved_kg / (STEPS_OF_FRICTION * finest_s)
    if slope <= most:
        return ""
    return (
        f"model.nonlinear.friction rises by {slope:.2g} N s/m at rest, too steeply for integration steps of "
        f"{finest_s:.2g} s: at most {most:.2g} N s/m, by a larger v0 in tanh(v/v0)"
    )


def _no_smooth_search(stage: NonlinearStage) -> list[str]:
    """Properties of the formulas that may end the search for an optimum, one sentence each."""
    return [said for said in (_too_steep(stage), ROUNDED if stage.plant.kinked else "") if said]


def _too_sharp(stage: NonlinearStage) -> str:
    """Message if integration steps do not follow the plant: what to change."""
    step_s, plant = stage.dt_s / stage.substeps, stage.plant
    lag_s = 0.0 if plant.R_ohm is None else plant.L_H / plant.R_ohm
    if steep := _too_steep(stage):
        return steep
    if 0 < lag_s < step_s:
        return (
            f"the coil's L / R of {lag_s:.2g} s is below the {step_s:.2g} s of an integration step: leave "
            "model.L_H out, or lower time.dt_s"
        )
    smoother = f"; {ROUNDED}" if plant.kinked else ", or make the formulas smoother"
    return f"model.nonlinear turns too sharply for integration steps of {step_s:.2g} s: lower time.dt_s{smoother}"


def _pushes_elsewhere(played: Replay, problem: TransientProblem, command: FloatArray) -> str:
    """Message if the wall pushes at other ticks of the hand-over than the problem assumed; empty otherwise."""
    assert problem.wall is not None
    truly = pressing(problem, encoder_course(problem, command)).wall
    assert truly is not None
    ticks = int(np.sum((truly.pressing != problem.wall.pressing)[max(problem.free_stages - 1, 0) :]))
    if not ticks:
        return ""
    off = float(np.abs(played.command - command).max())
    return (
        f"hand-over: the stylus grazes the surface, and at {ticks} of its ticks the wall pushes where the problem "
        f"assumes that it does not, or the reverse: the command is {off:.1e} {problem.driven_by.unit} off, limit "
        f"{tolerated(problem.limits.input_limit):.0e} {problem.driven_by.unit}"
    )


def _after_hand_over(played: Replay, problem: TransientProblem, late: list[Limit]) -> str:
    """Message on the limits that the wall alone exceeds after the waveform."""
    assert problem.wall is not None
    exceeded = " and the ".join(limit.missed(played.peak(limit) - limit.stated) for limit in late)
    return (
        f"hand-over: within {after_s(problem.grid) * 1e3:g} ms after the last command the wall alone brings the "
        f"{exceeded}, with {stated_wall(problem.wall.wall)}"
    )


def unstable_wall(problem: TransientProblem) -> str:
    """Message if the loop of the pressing wall is unstable on this device; empty otherwise."""
    if problem.wall is None:
        return ""
    growth = hand_over.growth(problem)
    if growth <= 1 + UNSTABLE_GROWTH:
        return ""
    stated = stated_wall(problem.wall.wall)
    return f"feedback: on this device the pressing wall grows {growth:.4g} times per tick, with {stated}"


def stated_wall(wall: Wall) -> str:
    """The scene's keys and values of a wall, without those that are zero."""
    numbers = {
        "feedback.stiffness_N_m": (wall.stiffness_N_m, " N/m"),
        "feedback.damping_N_s_m": (wall.damping_N_s_m, " N s/m"),
        "feedback.latency_ticks": (wall.latency_ticks, ""),
    }
    return ", ".join(f"{key} = {value:g}{unit}" for key, (value, unit) in numbers.items() if value > 0)
