"""The cost of the tail after the waveform, as a function of the state x_N at the end of the window.

From tau_N on the commands follow from the state (`limits.hand_over`), so y'' at the M instants after the window is
affine in it, O x_N + offset, with one row per instant and device. With O = Q R the sum of squares |O x_N - r_after|^2
over hundreds of rows becomes |R x_N - Q' r_after|^2 plus a constant, with R of the state's size. Evaluated as a
square it keeps all digits; x' P x - 2 p' x would cancel.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from transopt.base.matrices import powers
from transopt.base.signals import FloatArray, IndexArray
from transopt.problem.limits import hand_over
from transopt.problem.problem import TransientProblem
from transopt.problem.stage import LinearStage, in_unit_scales, units_m_s2


@dataclass(frozen=True)
class Tail:
    """Cost of the tail, |gain x_N - target|^2 + rest: all error terms over E, averaged by the devices' shares.

    Attributes
    ----------
    gain : (m, n) on the states of `LinearStage`, m <= n; m = 0 where the tail has no weight. (P, m, n) of P problems.
    target : (m,) or (P, m).
    rest : scalar or (P,), >= 0, independent of x_N.
    """

    gain: FloatArray
    target: FloatArray
    rest: FloatArray


@dataclass(frozen=True)
class _Free:
    """Factors of the tail's free motion, shared by all problems of one linear stage; both scales are 1.

    Attributes
    ----------
    counting : indices of the outputs with a weight in the tail, among those of all devices and terms.
    roots : (M counting,) square roots of the weights.
    Q, R : factors of the weighted outputs Q R x_N, one row per instant and output.
    """

    counting: IndexArray
    roots: FloatArray
    Q: FloatArray
    R: FloatArray


def tail(problem: TransientProblem, stage: LinearStage) -> Tail:
    """The tail's cost of a problem, for the states of its linear stage."""
    found = tails([problem], stage)
    return Tail(found.gain[0], found.target[0], found.rest[0])


def tails(problems: Sequence[TransientProblem], stage: LinearStage) -> Tail:
    """The tails' costs of P problems that differ only in the target; with a wall there is only one.

    Parameters
    ----------
    stage : linear stage of the first problem.
    """
    first = problems[0]
    M, n = first.grid.after_stages, stage.units.size
    if M == 0 or not any(term.after > 0 for term in first.terms):
        P = len(problems)
        return Tail(np.zeros((P, 0, n)), np.zeros((P, 0)), np.zeros(P))
    free = _free(first, stage)
    wanted = np.stack([problem.tracking.unit_wanted[:, first.grid.stages :] for problem in problems])
    asked = np.swapaxes(wanted[:, free.counting % wanted.shape[1]], 1, 2).reshape(len(problems), -1)
    with np.errstate(over="ignore", invalid="ignore"):  # the loop of an unstable wall overflows
        if first.wall is None:
            Q, gains = free.Q, free.R * (stage.input_scale / units_m_s2(problems))[:, None, None]
        else:
            by_state, offset = _walled(first, stage, free.counting)
            Q, gain = np.linalg.qr(by_state * free.roots[:, None])
            asked, gains = asked - offset, gain[None]
        asked = asked * free.roots
        targets = np.matmul(asked[:, None, :], Q)[:, 0]
        rests = np.maximum(np.sum(asked * asked, axis=1) - np.sum(targets * targets, axis=1), 0.0)
    return Tail(gains, targets, rests)


def _free(problem: TransientProblem, stage: LinearStage) -> _Free:
    """The factors of the free motion, cached in the stage model because all taps of one grip share them."""
    own = problem.grid.after_stages, tuple(problem.shared.tolist())
    return problem.stage.kept(_Free, (stage.A, problem.terms), own, lambda: _free_of(problem))


def _free_of(problem: TransientProblem) -> _Free:
    M = problem.grid.after_stages
    # Roots of the weights of every output (device, term), repeated for the M instants.
    after = np.sqrt([term.after for term in problem.terms])
    counting = np.flatnonzero(np.tile(after, problem.shared.size) > 0)
    roots = np.tile(np.outer(np.sqrt(problem.shared), after).ravel()[counting], M)
    Q, R = np.zeros((0, 0)), np.zeros((0, 0))
    if problem.wall is None:
        # From scales of one, so that no digit depends on the tap that came first.
        Q, R = np.linalg.qr(_fixed(in_unit_scales(problem), M, counting) * roots[:, None])
    return _Free(counting, roots, Q, R)


def _fixed(stage: LinearStage, M: int, counting: IndexArray) -> FloatArray:
    """(M outputs, n) weighted outputs by x_N, instant by instant, with all commands zero."""
    n, m = stage.units.size, stage.motors
    loop, outputs = stage.A.copy(), stage.C[counting]
    # The first movement takes the held commands to zero, where they stay.
    loop[:, -m:] -= stage.B
    outputs[:, -m:] -= stage.E[counting]
    by_state = outputs @ powers(loop, M - 1).reshape(M, n, n)
    return by_state.reshape(M * counting.size, n)


def _walled(problem: TransientProblem, stage: LinearStage, counting: IndexArray) -> tuple[FloatArray, FloatArray]:
    """(M outputs, n) outputs by x_N, and (M outputs,) their constant parts, under the wall's feedback command."""
    M, n = problem.grid.after_stages, stage.units.size
    gains, offsets = hand_over.rows_after(problem, stage)
    gains[:, -1] -= 1.0  # dc_k = rows x_k + constant - c_(k-1), and c_(k-1) is the last state
    by_movement = stage.B[:, 0]
    loops = stage.A + by_movement[:, None] * gains[:, None, :]
    states = np.empty((M, n, n + 1))  # derivatives by x_N, then the constant part
    states[0] = np.eye(n, n + 1)
    for j in range(M - 1):
        np.matmul(loops[j], states[j], out=states[j + 1])
        states[j + 1, :, n] += by_movement * offsets[j]
    movement = np.matmul(gains[:, None, :], states)
    movement[:, 0, n] += offsets
    rows = (np.matmul(stage.C[counting], states) + stage.E[counting] * movement).reshape(-1, n + 1)
    return rows[:, :n], rows[:, n]
