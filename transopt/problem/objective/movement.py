"""The penalties on the command: its changes, which keep the problem strictly convex, and the heat of its current."""

from dataclasses import dataclass

import numpy as np

from transopt.base.signals import FloatArray

SMOOTHNESS_STEP_S = 1e-4  # reference servo period of rho, which makes it independent of the scene's period


@dataclass(frozen=True)
class Movement:
    """rho / (N I^2) sum_k (dc_k 1e-4 s / dt)^2 with dc_k = c_k - c_(k-1) and c_(-1) = 0.

    Attributes
    ----------
    rho : >= 0.
    stages : N.
    dt_s : servo period.
    input_limit : I, the limit on the plant's input, here the unit of the command.
    """

    rho: float
    stages: int
    dt_s: float
    input_limit: float

    @property
    def weight(self) -> float:
        """Weight of dc_k^2: rho (1e-4 s / dt)^2 / (N I^2) [1/A^2]."""
        step = SMOOTHNESS_STEP_S / self.dt_s
        return self.rho * step**2 / (self.stages * self.input_limit**2)

    def value(self, command: FloatArray) -> float:
        """The term at a command (N,), or the sum over the motors at (m, N)."""
        movement = _moves(command)
        return self.weight * float(np.vdot(movement, movement))

    def gradient(self, command: FloatArray) -> FloatArray:
        """(..., N) gradient of the term by the commands [1/A]."""
        by_movement = 2 * self.weight * _moves(command)
        by_command = by_movement.copy()
        by_command[..., :-1] -= by_movement[..., 1:]
        return by_command


def _moves(command: FloatArray) -> FloatArray:
    """(..., N) changes dc_k of a command (..., N), the first one from zero."""
    moves = command.copy()
    moves[..., 1:] -= command[..., :-1]
    return moves


@dataclass(frozen=True)
class HeatPrice:
    """price sum_(k<N) i_k^2, with i_k the plant's input at the switching instants of the window.

    The term is convex. For every price the minimiser of J is also the optimum under the constraint that the heat is
    at most the minimiser's own.

    Attributes
    ----------
    price : >= 0 [1/A^2 or 1/V^2].
    """

    price: float

    def value(self, plant_input: FloatArray) -> float:
        """The term at inputs (N,), or the sum over the motors at (m, N)."""
        return self.price * float(np.vdot(plant_input, plant_input))

    def gradient(self, plant_input: FloatArray) -> FloatArray:
        """(..., N) of the term by the inputs (..., N)."""
        return 2 * self.price * plant_input
