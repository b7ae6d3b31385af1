"""Hand-over: the last `hand_over_samples` commands equal the wall's feedback command, zero without a wall.

It is the problem's only equality constraint, c_k = feedback of the encoder's reading, and therefore not a `Limit`.
Its multipliers have either sign and are stored beside those of the limits. It ends the transient within the waveform,
so that the wall's loop alone acts afterwards; that loop has to be stable.
"""

from dataclasses import replace

import numpy as np

from transopt.base.signals import FloatArray, IndexArray
from transopt.plant.amplifier import prefilter_coefficients
from transopt.plant.discretise import Motion
from transopt.problem.problem import TransientProblem
from transopt.problem.stage import LinearStage, linear_stage


def residual(problem: TransientProblem, command: FloatArray, motion: Motion) -> FloatArray:
    """(h,) residual of the hand-over, command (N,) minus feedback command under this motion [A]."""
    return np.asarray((command - problem.hand_over_command(motion))[..., problem.free_stages :])


def padded(problem: TransientProblem, by_residual: FloatArray) -> FloatArray:
    """(..., N) gradient by the commands for a gradient (..., h) by the residual."""
    before = np.zeros((*by_residual.shape[:-1], problem.free_stages))
    return np.concatenate([before, by_residual], axis=-1)


def rows(problem: TransientProblem, stage: LinearStage) -> tuple[FloatArray, FloatArray]:
    """Hand-over as c_k = rows_k x_k + constant_k: (h, n) on scaled states and (h,), in units of `input_scale`."""
    return _rows(problem, stage, np.arange(problem.free_stages, problem.grid.stages))


def rows_after(problem: TransientProblem, stage: LinearStage) -> tuple[FloatArray, FloatArray]:
    """Equations of the hand-over for the M commands after the window, as in `rows`: (M, n) and (M,)."""
    N, M = problem.grid.stages, problem.grid.after_stages
    return _rows(problem, stage, np.arange(N, N + M))


def _rows(problem: TransientProblem, stage: LinearStage, at: IndexArray) -> tuple[FloatArray, FloatArray]:
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
    """Spectral radius per tick of the loop closed by the pressing wall alone; the loop is stable below 1."""
    assert problem.wall is not None
    stage = linear_stage(problem, physical_scale=True)
    everywhere = replace(problem, wall=replace(problem.wall, pressing=np.ones_like(problem.wall.pressing)))
    by_state, _ = rows(everywhere, stage)
    # c_k = rows x_k, and the input of the stage is the movement c_k - c_(k-1).
    held = by_state[-1].copy()
    held[-1] -= 1.0
    loop = stage.A + np.outer(stage.B[:, 0], held)
    return float(np.abs(np.linalg.eigvals(loop)).max())
