"""Sizes of the states of a stage, by which the solvers scale them."""

import numpy as np

from transopt.base.matrices import powers
from transopt.base.signals import FloatArray

PEAK_PERIOD = 20  # stages in half a period of the square wave that scales the states


def state_scale(A: FloatArray, B: FloatArray, current_limit_A: float, stages: int) -> FloatArray:
    """(n,) size of each state of x+ = A x + B c under a square wave of the limit current of 40 servo periods.

    In these units every state of the optimal-control problem is of order one for all masses and stiffnesses;
    elongations and velocities in SI differ by four orders of magnitude.

    Parameters
    ----------
    A : (n, n).
    B : (n, m), or (n,) with one motor. The sizes under the single motors are added.
    current_limit_A : amplitude of the square wave.
    stages : N of the problem; at most 400 periods are simulated.
    """
    return sizes(current_limit_A * peaks(A, B, stages))


def sizes(largest: FloatArray) -> FloatArray:
    """Peaks as sizes: 1 for a state that the input does not move."""
    return np.where(largest > 0, largest, 1.0)


def peaks(A: FloatArray, B: FloatArray, stages: int) -> FloatArray:
    """(n,) peak of each state under a square wave of amplitude 1, summed over the motors."""
    of_A = powers(A, PEAK_PERIOD)
    return np.asarray(
        np.sum([_peaks_of_motor(of_A, column, stages) for column in B.reshape(B.shape[0], -1).T], axis=0)
    )


def _peaks_of_motor(of_A: FloatArray, B: FloatArray, stages: int) -> FloatArray:
    period, n = PEAK_PERIOD, B.size
    halves = -(-min(stages, 20 * period) // period)
    held = np.cumsum((of_A[:-n] @ B).reshape(period, n), axis=0)
    # One half period per row, with the sign of its current taken out: x+ = held_20 - A^20 x. All states of a half
    # period follow from its start.
    starts = np.zeros((halves, n))
    starts[1:] = np.cumsum((powers(-of_A[-n:], halves - 2) @ held[-1]).reshape(-1, n), axis=0)
    courses = held.ravel() - starts @ of_A[n:].T
    return np.asarray(np.abs(courses).max(axis=0).reshape(period, n).max(axis=0))
