"""An LRA and its click, posed and solved another way: two masses and a coil by Newton's law, condensed, dense.

Nothing of `transopt` but numbers is used. The states are the positions and velocities of mass and case, each against
the room, and the coil's current; a held voltage is integrated by one matrix exponential; every output is the sum of
its responses to the commands; the quadratic program goes to an active-set method.
"""

from dataclasses import dataclass

import casadi as ca
import numpy as np
from scipy import linalg

from transopt.base.signals import FloatArray


@dataclass(frozen=True)
class Actuator:
    """The actuator has the numbers of a scene's `[model]`; f0 and Q are those of the mass against the case."""

    resonance_Hz: float
    quality: float
    moving_mass_kg: float
    case_mass_kg: float
    force_factor_N_A: float
    R_ohm: float
    L_H: float

    def flow(self) -> tuple[FloatArray, FloatArray]:
        """(5, 5), (5,) of d/dt [mass, its velocity, case, its velocity, current], and by the voltage.

        A positive current pushes the case forwards and the mass backwards.
        """
        m, M, BL = self.moving_mass_kg, self.case_mass_kg, self.force_factor_N_A
        w = 2 * np.pi * self.resonance_Hz
        k = w**2 / (1 / m + 1 / M)
        c = k / (w * self.quality)
        spring = np.array([-k, -c, k, c])  # force on the mass by the stretch between the two
        A = np.zeros((5, 5))
        A[0, 1] = A[2, 3] = 1.0
        A[1, :4], A[3, :4] = spring / m, -spring / M
        A[1, 4], A[3, 4] = -BL / m, BL / M
        A[4] = np.array([0.0, BL, 0.0, -BL, -self.R_ohm]) / self.L_H
        return A, np.array([0.0, 0.0, 0.0, 0.0, 1 / self.L_H])

    def responses(self, dt_s: float, stages: int, instants: int, later: float = 0.0) -> tuple[FloatArray, FloatArray]:
        """(instants, stages) the case's acceleration, and (instants, stages) case less mass, by held commands.

        Parameters
        ----------
        later : share of a period by which the instants come after the switching instants.
        """
        A, b = self.flow()
        whole = np.zeros((6, 6))
        whole[:5, :5], whole[:5, 5] = A * dt_s, b * dt_s
        step = linalg.expm(whole)
        states = np.zeros((instants, 5))
        for j in range(1, instants):
            states[j] = step[:5, :5] @ states[j - 1] + (step[:5, 5] if j == 1 else 0.0)
        part = linalg.expm(whole * later)
        states = states @ part[:5, :5].T
        states[0] += part[:5, 5]
        row = np.zeros(stages)
        return tuple(linalg.toeplitz(states @ out, row) for out in (A[3], np.array([-1.0, 0, 1.0, 0, 0])))  # type: ignore[return-value]


def optimum(
    device: Actuator,
    wanted: FloatArray,
    weights: FloatArray,
    dt_s: float,
    stages: int,
    *,
    voltage_V: float,
    stroke_m: float,
    rho: float,
    handed_over: int,
    parts: int = 1,
) -> tuple[FloatArray, float]:
    """Command (N,) and J, the error over all of `wanted` (N + M,), under voltage and stroke until tau_N.

    Parameters
    ----------
    parts : of every period, at whose ends the stroke is limited.
    """
    acceleration, _ = device.responses(dt_s, stages, wanted.size)
    free = stages - handed_over
    E = float(np.sum(wanted[:stages] ** 2))
    moves = np.eye(stages) - np.eye(stages, k=-1)
    by_movement = rho * (1e-4 / dt_s) ** 2 / (stages * voltage_V**2)
    H = 2 / E * (acceleration.T * weights) @ acceleration + 2 * by_movement * moves.T @ moves
    g = -2 / E * acceleration.T @ (weights * wanted)
    within = [device.responses(dt_s, stages, stages, j / parts)[1][:, :free] for j in range(1, parts + 1)]
    rows = np.concatenate(within)
    unit = 1 / stroke_m
    solver = ca.conic(
        "dense",
        "qpoases",
        {"h": ca.DM(H[:free, :free]).sparsity(), "a": ca.DM(rows).sparsity()},
        {"printLevel": "none", "nWSR": 20000, "error_on_fail": True},
    )
    answer = solver(h=H[:free, :free], g=g[:free], a=rows * unit, lba=-1.0, uba=1.0, lbx=-voltage_V, ubx=voltage_V)
    command = np.append(np.asarray(answer["x"]).ravel(), np.zeros(handed_over))
    left = acceleration @ command - wanted
    J = float(weights @ left**2) / E + by_movement * float(np.sum(np.diff(command, prepend=0.0) ** 2))
    return command, J
