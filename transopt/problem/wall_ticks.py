"""The servo ticks at which a problem's virtual wall pushes; they depend on the command."""

from dataclasses import replace

import numpy as np

from transopt.base.signals import FloatArray
from transopt.plant.wall import FeedbackLoop
from transopt.problem.problem import TransientProblem

MAX_ITERATIONS = 12  # of the fixed point of the ticks at which the wall pushes


def silence(problem: TransientProblem) -> tuple[TransientProblem, FloatArray]:
    """The problem with the wall's ticks of a tap without transient, and the wall's command (N,) during that tap."""
    nothing = problem.rest
    if problem.wall is None:
        return problem, nothing
    command, course = _rendered(problem, nothing)
    return pressing(problem, course), command[: nothing.size]


def rendered(problem: TransientProblem, transient: FloatArray) -> FloatArray:
    """(N + M,) command of a device that renders its wall and adds a transient (N,), through and after the window."""
    return _rendered(problem, transient)[0]


def _rendered(problem: TransientProblem, transient: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Command and encoder reading, (N + M,) each, of the wall's closed loop simulated tick by tick."""
    stage, wall, grid = problem.stage, problem.wall, problem.grid
    late = stage.whole_delay + 1  # ticks from a command to the first reading that depends on it
    commands = np.zeros((1, late + grid.stages + grid.after_stages))
    commands[0, late : late + grid.stages] = transient
    if wall is None:
        return commands[0, late:], np.zeros(commands.size - late)
    assert stage.Cp is not None
    assert stage.Dp is not None
    nominal = wall.nominal_m[None]
    loop = FeedbackLoop(wall.wall, stage.amplifier, grid.dt_s, nominal[:, 0], np.array([wall.approach_m_s]))
    encoder = np.append(stage.Dp, stage.Cp)
    course = loop.close((stage.A, stage.B, encoder), nominal, commands)
    return commands[0, late:], course[0]


def encoder_course(problem: TransientProblem, command: FloatArray) -> FloatArray:
    """(N + M,) deviation of the encoder's reading from the nominal motion at the ticks, under a command (N,)."""
    return problem.feedback.course(problem.stage.motion(problem.continued(command)))


def pressing(problem: TransientProblem, deviation_m: FloatArray) -> TransientProblem:
    """The problem with the wall's ticks that follow from the encoder's deviations (N + M,)."""
    wall = problem.wall
    assert wall is not None
    pushes = wall.feedback(deviation_m, problem.grid.dt_s) > 0
    return replace(problem, wall=replace(wall, pressing=pushes))


def pressing_under(problem: TransientProblem, command: FloatArray) -> TransientProblem:
    """The problem with the wall's ticks that follow from a command (N,) and its continuation after the window.

    The continuation depends on the ticks itself, so they are iterated until they no longer change.
    """
    for _ in range(MAX_ITERATIONS):
        again = pressing(problem, encoder_course(problem, command))
        assert again.wall is not None
        assert problem.wall is not None
        if np.array_equal(again.wall.pressing, problem.wall.pressing):
            return problem
        problem = again
    return problem
