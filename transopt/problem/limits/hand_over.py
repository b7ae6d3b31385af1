"""Hand-over: over the last `hand_over_samples` the command is what the wall's feedback asks for, zero without a wall.

It is the one constraint that is no box: an equation for each of the last commands, c_k = feedback of the encoder's
course. So it is no `Limit`; its multipliers, of either sign, stand beside those of the limits. The wall's end follows
from it: nothing is left of the transient when the waveform is over, and the loop of the wall alone has to be calm.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from transopt.base.signals import FloatArray
from transopt.plant.amplifier import prefilter_coefficients
from transopt.plant.discretise import Motion
from transopt.problem.problem import TransientProblem
from transopt.problem.stage import LinearStage, linear_stage


def residual(problem: TransientProblem, command: FloatArray, motion: Motion) -> FloatArray:
    """(h,) by how much a command (N,) with this motion differs from what is asked for over the hand-over [A]."""
    return np.asarray((command - problem.hand_over_command(motion))[..., problem.free_stages :])


def transposed(problem: TransientProblem, by_residual: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Gradients by the commands (N,) and by the encoder's course (N,) for a gradient (h,) by the residual."""
    before = np.zeros((*by_residual.shape[:-1], problem.free_stages))
    tail = np.concatenate([before, by_residual], axis=-1)
    return tail, problem.feedback.transposed(-tail)


def rows(problem: TransientProblem, stage: LinearStage) -> tuple[FloatArray, FloatArray]:
    """Hand-over as c_k = rows_k x_k + constant_k: (h, n) on scaled states and (h,), in units of `input_scale`."""
    return _rows(problem, stage, np.arange(problem.free_stages, problem.grid.stages))


def rows_after(problem: TransientProblem, stage: LinearStage) -> tuple[FloatArray, FloatArray]:
    """State the hand-over of the commands after the window, where it goes on, as `rows` does: (M, n) and (M,)."""
    N, M = problem.grid.stages, problem.grid.after_stages
    return _rows(problem, stage, np.arange(N, N + M))


def _rows(problem: TransientProblem, stage: LinearStage, at: NDArray[np.intp]) -> tuple[FloatArray, FloatArray]:
    if problem.wall is None:
        return np.zeros((at.size, stage.units.size)), np.zeros(at.size)
    amplifier, dt = problem.stage.amplifier, problem.grid.dt_s
    now, before = (1.0, 0.0) if amplifier is None else prefilter_coefficients(amplifier, dt)
    pressing = problem.wall.pressing.astype(float)
    earlier = np.where(at > 0, pressing[at - 1], 0.0)
    by_state = now * pressing[at, None] * stage.feedback[0] + before * earlier[:, None] * stage.feedback[1]
    without = problem.feedback.command(Motion.zero(pressing.size))
    return by_state / stage.input_scale, without[at] / stage.input_scale


def growth(problem: TransientProblem) -> float:
    """Largest factor per tick by which a motion under the pressing wall alone grows; below 1 it dies out."""
    assert problem.wall is not None
    stage = linear_stage(problem, physical_scale=True)
    everywhere = replace(problem, wall=replace(problem.wall, pressing=np.ones_like(problem.wall.pressing)))
    by_state, _ = rows(everywhere, stage)
    # c_k = rows x_k, so the movement is that less the command held before.
    held = by_state[-1].copy()
    held[-1] -= 1.0
    loop = stage.A + np.outer(stage.B[:, 0], held)
    return float(np.abs(np.linalg.eigvals(loop)).max())
