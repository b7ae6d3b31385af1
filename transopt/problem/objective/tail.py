"""What an optimum does when the waveform is over, as a function of the state in which the window ends.

From tau_N on the commands follow from the state (`limits.hand_over`), so that y'' at the M instants after the window
is O x_N and an offset, one row an instant and device. The sum of squares |O x_N - r_after|^2 over hundreds of rows
depends on x_N by a triangle of its size: with O = Q R it is |R x_N - Q' r_after|^2 and a rest that no command moves.
Evaluated as a square it loses no digits, as x' P x - 2 p' x would.
"""

from dataclasses import dataclass

import numpy as np

from transopt.base.signals import FloatArray
from transopt.plant.discretise import powers
from transopt.problem.limits import hand_over
from transopt.problem.problem import TransientProblem
from transopt.problem.stage import LinearStage


@dataclass(frozen=True)
class Tail:
    """sum over the tail of (F e)^2 / E, the mean over the devices by their shares, as |gain x_N - target|^2 + rest.

    Attributes
    ----------
    gain : (m, n) on the states of `LinearStage`, m <= n; m = 0 where nothing after the window counts.
    target : (m,).
    rest : >= 0.
    """

    gain: FloatArray
    target: FloatArray
    rest: float


def tail(problem: TransientProblem, stage: LinearStage) -> Tail:
    """The tail of a problem, for the states of its linear stage."""
    M, n, devices = problem.grid.after_stages, stage.units.size, stage.E.size
    if M == 0:
        return Tail(np.zeros((0, n)), np.zeros(0), 0.0)
    after = problem.tracking.unit_reference[problem.grid.stages :]
    if problem.wall is None and problem.error_filter is None and devices == 1:
        # The free motion of one device from its own states, which stand in front: known for its grip.
        Q, R = problem.stage.free_response(M)
        gain, wanted, own = np.zeros((R.shape[0], n)), after, slice(R.shape[1])
        gain[:, own] = R * (stage.units[own] / stage.unit_m_s2)
    else:
        with np.errstate(over="ignore", invalid="ignore"):  # a wall that grows by itself
            by_state, offset = _fixed(stage, M) if problem.wall is None else _walled(problem, stage)
            roots = np.tile(np.sqrt(problem.shared), M)
            Q, gain = np.linalg.qr(by_state * roots[:, None])
            wanted = (np.repeat(after, devices) - offset) * roots
    with np.errstate(over="ignore", invalid="ignore"):
        target = wanted @ Q
        rest = max(float(wanted @ wanted - target @ target), 0.0)
    return Tail(gain, target, rest)


def _fixed(stage: LinearStage, M: int) -> tuple[FloatArray, FloatArray]:
    """(M S, n) of the outputs by x_N and (M S,) beside it, instant by instant; all commands zero."""
    n, devices = stage.units.size, stage.E.size
    loop, outputs = stage.A.copy(), stage.C.copy()
    # The first movement takes the command that is held to zero, where it stays.
    loop[:, -1] -= stage.A[:, -1]
    outputs[:, -1] -= stage.E
    by_state = outputs @ powers(loop, M - 1).reshape(M, n, n)
    return by_state.reshape(M * devices, n), np.zeros(M * devices)


def _walled(problem: TransientProblem, stage: LinearStage) -> tuple[FloatArray, FloatArray]:
    """Compute what `_fixed` does, but where the commands are what the wall asks for."""
    M, n = problem.grid.after_stages, stage.units.size
    gains, offsets = hand_over.rows_after(problem, stage)
    gains[:, -1] -= 1.0  # c_k = rows x_k + constant, so dc_k = that less c_(k-1)
    by_movement = stage.A[:, -1]
    loops = stage.A + by_movement[:, None] * gains[:, None, :]
    states = np.empty((M, n, n + 1))  # by x_N and beside it
    states[0] = np.eye(n, n + 1)
    for j in range(M - 1):
        np.matmul(loops[j], states[j], out=states[j + 1])
        states[j + 1, :, n] += by_movement * offsets[j]
    movement = np.matmul(gains[:, None, :], states)
    movement[:, 0, n] += offsets
    rows = (np.matmul(stage.C, states) + stage.E[:, None] * movement).reshape(-1, n + 1)
    return rows[:, :n], rows[:, n]
