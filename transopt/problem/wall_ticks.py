"""Ticks at which the wall of a problem pushes, which depend on the command that plays."""

from dataclasses import replace

import numpy as np

from transopt.base.signals import FloatArray
from transopt.plant.wall import FeedbackLoop
from transopt.problem.problem import TransientProblem

MOST_TRIES = 12  # until the wall after the window pushes where it was assumed to


def silence(problem: TransientProblem) -> tuple[TransientProblem, FloatArray]:
    """The problem with its wall pressing where it does without a transient, and the command (N,) of that."""
    nothing = problem.rest
    if problem.wall is None:
        return problem, nothing
    command, course = _rendered(problem, nothing)
    return pressing(problem, course), command[: nothing.size]


def rendered(problem: TransientProblem, transient: FloatArray) -> FloatArray:
    """(N + M,) command of a device that plays a transient (N,) on top of its wall, and goes on after the window."""
    return _rendered(problem, transient)[0]


def _rendered(problem: TransientProblem, transient: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The command and the encoder's course (N + M,): the wall's law closed over the stage model, tick by tick."""
    stage, wall, M = problem.stage, problem.wall, problem.grid.after_stages
    command = np.append(transient, np.zeros(M))
    course = np.zeros(command.size)
    if wall is None:
        return command, course
    assert stage.Cp is not None
    assert stage.Dp is not None
    loop = FeedbackLoop(
        wall.wall, stage.amplifier, problem.grid.dt_s, wall.nominal_m[:1], np.array([wall.approach_m_s])
    )
    late, x = stage.whole_delay + 1, np.zeros((stage.A.shape[0], 1))
    with np.errstate(over="ignore", invalid="ignore"):  # a wall that grows by itself
        for k in range(command.size):
            command[k] += loop.step(wall.nominal_m[k : k + 1] + course[k])[0]
            if k + late < command.size:
                course[k + late] = (stage.Cp @ x + stage.Dp * command[k])[0, 0]
            x = stage.A @ x + stage.B * command[k]
    return command, course


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
