"""What a problem does not need: limits that no admissible command can reach."""

from dataclasses import dataclass, replace

import numpy as np

from transopt.base.signals import FloatArray
from transopt.plant.discretise import StageModel, discretise
from transopt.plant.wall import FeedbackLoop
from transopt.problem.problem import TransientProblem

MOST_TRIES = 12  # until the wall after the window pushes where it was assumed to


def silence(problem: TransientProblem) -> tuple[TransientProblem, FloatArray]:
    """The problem with its wall pressing where it does when no transient plays, and that command (N,); zero without.

    Tick by tick, with the wall's law closed over the stage model.
    """
    stage, wall, N = problem.stage, problem.wall, problem.grid.stages
    ticks = N + problem.grid.after_stages
    command = np.zeros(ticks)
    if wall is None:
        return problem, command[:N]
    assert stage.Cp is not None
    assert stage.Dp is not None
    loop = FeedbackLoop(
        wall.wall, stage.amplifier, problem.grid.dt_s, wall.nominal_m[:1], np.array([wall.approach_m_s])
    )
    course, late, x = np.zeros(ticks), stage.whole_delay + 1, np.zeros((stage.A.shape[0], 1))
    with np.errstate(over="ignore", invalid="ignore"):  # a wall that grows by itself
        for k in range(ticks):
            command[k] = loop.step(wall.nominal_m[k : k + 1] + course[k])[0]
            if k + late < ticks:
                course[k + late] = (stage.Cp @ x + stage.Dp * command[k])[0, 0]
            x = stage.A @ x + stage.B * command[k]
    return pressing(problem, course), command[:N]


@dataclass(frozen=True)
class Reduced:
    """A smaller problem with the same answer, and part -> why it may be missing."""

    problem: TransientProblem
    left_out: dict[str, str]


def leave_out(problem: TransientProblem) -> Reduced:
    """The problem without the limits, and without the rows of limits, that cannot matter, each with its proof."""
    reasons = dict[str, str]()
    for limit in problem.limits:
        reason = limit.cannot_bind(problem)
        if reason:
            reasons[limit.name] = reason
            problem = problem.without(limit.name)
            continue
        needed, of_rows = limit.needed(problem)
        if of_rows:
            reasons |= of_rows
            problem = problem.replaced(needed)
    if problem.wall is not None and not problem.wall.pressing[max(problem.free_stages - 1, 0) :].any():
        reasons["feedback"] = "the stylus is above the surface from the hand-over on: the wall asks for nothing there"
        problem = replace(problem, wall=None, stage=without_position(problem.stage))
    return Reduced(problem, reasons)


def without_position(stage: StageModel) -> StageModel:
    """Leave out the encoder's position, and the states of the device that only it depends on."""
    return discretise(stage.plant, stage.amplifier, stage.dt_s, outputs=tuple(stage.outputs))


def encoder_course(problem: TransientProblem, command: FloatArray) -> FloatArray:
    """(N + M,) deviation of the encoder at the ticks under a command (N,) and what follows it."""
    return problem.feedback.course(problem.stage.motion(problem.continued(command)))


def pressing(problem: TransientProblem, deviation_m: FloatArray) -> TransientProblem:
    """Let the problem's wall push where an encoder course (N + M,) of deviations makes it push."""
    wall = problem.wall
    assert wall is not None
    pushes = wall.feedback(deviation_m, problem.grid.dt_s) > 0
    return replace(problem, wall=replace(wall, pressing=pushes))


def pressing_under(problem: TransientProblem, command: FloatArray) -> TransientProblem:
    """Let the problem's wall push where a command (N,) and the wall after it make it push.

    What the wall does after the window depends on where it pushes there, so the ticks are taken anew until they stay.
    """
    for _ in range(MOST_TRIES):
        again = pressing(problem, encoder_course(problem, command))
        assert again.wall is not None
        assert problem.wall is not None
        if np.array_equal(again.wall.pressing, problem.wall.pressing):
            return problem
        problem = again
    return problem
