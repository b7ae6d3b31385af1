"""Exact discretisation of plant and amplifier on the switching instants (DESIGN 2 and 4)."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from transopt.amplifier import Amplifier
from transopt.models import StateSpace
from transopt.signals import FloatArray


@dataclass(frozen=True)
class TimeGrid:
    """Servo ticks t_k = -lead + k dt and switching instants tau_k = t_k + delay, contact at t = 0."""

    dt_s: float
    stages: int
    lead_s: float
    delay_s: float

    @property
    def issue_times_s(self) -> FloatArray:
        """(N,) t_k: command c_k is issued here and held."""
        return np.asarray(-self.lead_s + self.dt_s * np.arange(self.stages), dtype=float)

    @property
    def switching_times_s(self) -> FloatArray:
        """(N,) tau_k: the motor feels c_k from here; predictions and reference are sampled here."""
        return self.issue_times_s + self.delay_s

    @property
    def end_s(self) -> float:
        """tau_N, where the last command ends [s]."""
        return -self.lead_s + self.dt_s * self.stages + self.delay_s


@dataclass(frozen=True)
class StageModel:
    """One grip's device over one servo period, exact for a held command.

    x_(k+1) = A x_k + B c_k,  y''_k = C x_k + D c_k,  i_k = Ci x_k + Di c_k  at the switching instants.
    x holds the plant's acting states and, unless the amplifier is ideal, the current (its last entry).

    Attributes
    ----------
    plant, amplifier, dt_s : what was discretised; amplifier None is ideal, i = c.
    A : (n, n). B : (n, 1). C, Ci : (1, n). D, Di : (1, 1).
    """

    plant: StateSpace
    amplifier: Amplifier | None
    dt_s: float
    A: FloatArray
    B: FloatArray
    C: FloatArray
    D: FloatArray
    Ci: FloatArray
    Di: FloatArray

    def rollout(self, command_A: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Acceleration y'' and current at the switching instants for held commands.

        Parameters
        ----------
        command_A : (..., N).

        Returns
        -------
        acceleration_m_s2, current_A : (..., N) each.
        """
        N = command_A.shape[-1]
        c = command_A.reshape(-1, N)
        x = np.empty((N, self.A.shape[0], c.shape[0]))
        x[0] = 0.0
        for k in range(N - 1):
            x[k + 1] = self.A @ x[k] + self.B * c[:, k]
        acceleration = np.einsum("n,knm->mk", self.C[0], x) + self.D[0, 0] * c
        current = np.einsum("n,knm->mk", self.Ci[0], x) + self.Di[0, 0] * c
        return acceleration.reshape(command_A.shape), current.reshape(command_A.shape)

    def adjoint(self, by_acceleration: FloatArray, by_current: FloatArray) -> FloatArray:
        """Gradient by the commands of a function whose gradients by y'' and i are given, all (N,).

        The transpose of `rollout`, by the adjoint recursion: lambda_k = A' lambda_(k+1) + C' g_k + Ci' h_k.
        """
        N = by_acceleration.size
        costate = np.zeros(self.A.shape[0])
        gradient = self.D[0, 0] * by_acceleration + self.Di[0, 0] * by_current
        A_T, B, C, Ci = self.A.T.copy(), self.B[:, 0], self.C[0], self.Ci[0]
        for k in range(N - 1, -1, -1):
            gradient[k] += costate @ B
            costate = A_T @ costate + C * by_acceleration[k] + Ci * by_current[k]
        return np.asarray(gradient)


def acting_states(plant: StateSpace) -> NDArray[np.bool_]:
    """(n,) states that the acceleration depends on, by the structure of A and C.

    A free device's position only integrates its velocity: nothing depends on it, and without a wall nobody asks.
    """
    acting: NDArray[np.bool_] = plant.C[0] != 0
    while True:
        more = acting | np.any(plant.A[acting] != 0, axis=0)
        if np.array_equal(more, acting):
            return acting
        acting = more


def discretise(plant: StateSpace, amplifier: Amplifier | None, dt_s: float) -> StageModel:
    """Exact zero-order hold of plant and amplifier by one matrix exponential.

    The amplifier's delay does not appear: it only shifts the time axis (DESIGN 2). States that the acceleration
    does not depend on are left out.
    """
    acting = acting_states(plant)
    n = int(acting.sum())
    A, B, C = plant.A[np.ix_(acting, acting)], plant.B[acting], plant.C[:, acting]
    zero = np.zeros((1, 1))
    if amplifier is None:
        flow = np.block([[A, B], [np.zeros((1, n + 1))]])
        D, Ci, Di = plant.D, np.zeros((1, n)), np.ones((1, 1))
    else:
        w = amplifier.rate_rad_s
        flow = np.zeros((n + 2, n + 2))
        flow[:n, : n + 1] = np.hstack([A, B])
        flow[n, n:] = -w, w
        C, D = np.hstack([C, plant.D]), zero
        Ci, Di = np.eye(1, n + 1, n), zero
    hold = linalg.expm(flow * dt_s)
    return StageModel(plant, amplifier, dt_s, hold[:-1, :-1], hold[:-1, -1:], C, D, Ci, Di)


def state_scale(model: StageModel, current_limit_A: float, stages: int) -> FloatArray:
    """(n,) size of each state under a square wave of the limit current, 40 servo periods long.

    In these units every state of the optimal-control problem is of order one, whatever the masses and
    stiffnesses; elongations and velocities in SI differ by four orders of magnitude.
    """
    period = 20
    n = model.A.shape[0]
    x = np.zeros(n)
    peak = np.zeros(n)
    for k in range(min(stages, 20 * period)):
        wave = current_limit_A if (k // period) % 2 == 0 else -current_limit_A
        x = model.A @ x + model.B[:, 0] * wave
        peak = np.maximum(peak, np.abs(x))
    # A state that the current cannot move has no size of its own.
    return np.where(peak > 0, peak, 1.0)
