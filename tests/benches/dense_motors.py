"""A problem of several motors and directions solved another way: condensed, dense, from the plant's matrices alone.

As in `dense`, nothing of `transopt` but the numbers of the problem is used: each motor is discretised by itself, and
every acceleration is the sum of its responses to all commands. The quadratic program goes to another method (PIQP,
dense), which knows no stages.
"""

from dataclasses import dataclass

import casadi as ca
import numpy as np
from scipy import linalg, signal

from transopt.base.signals import FloatArray
from transopt.problem.problem import TransientProblem

EPS = 1e-12  # of PIQP


def impulse(problem: TransientProblem, motor: int, instants: int) -> FloatArray:
    """(instants, n + 1) states of the plant and the motor's current after one ampere of command over one period."""
    plant, amplifier = problem.stage.plant, problem.stage.amplifier
    n = plant.order
    flow = np.zeros((n + 2, n + 2))
    flow[:n, :n] = plant.A
    if amplifier is None:
        flow[:n, n + 1] = plant.B[:, motor]
    else:
        w = 2 * np.pi * amplifier.pole_Hz
        flow[:n, n] = plant.B[:, motor]
        flow[n, n], flow[n, n + 1] = -w, w
    step, state = linalg.expm(flow * problem.grid.dt_s), np.append(np.zeros(n + 1), 1.0)
    found = np.zeros((instants, n + 2))
    for k in range(instants):
        found[k] = state
        state = step @ state
        state[-1] = 0.0
    if amplifier is None:
        found[:, n] = found[:, -1]
    return found[:, :-1]


@dataclass(frozen=True)
class Dense:
    """J as |A c - b|^2 + rest over the free commands c, motor after motor, and the currents by them.

    Attributes
    ----------
    A : (rows, m free). b : (rows,). rest : of J, what no command changes.
    currents : (m N, m free) at the switching instants.
    """

    A: FloatArray
    b: FloatArray
    rest: float
    currents: FloatArray

    @classmethod
    def of(cls, problem: TransientProblem) -> "Dense":
        """Roll out every motor's impulse through the window and after it."""
        N, M, free, m = problem.grid.stages, problem.grid.after_stages, problem.free_stages, problem.stage.motors
        plant, target, L = problem.stage.plant, problem.target, problem.target.lost
        states = [impulse(problem, j, N + M) for j in range(m)]
        rows, asked, energy, lost = [], [], 0.0, 0.0
        for p in range(plant.tracked):
            course = [target.before_m_s2[p], target.window_m_s2[p], target.after_m_s2[p]]
            for term in problem.terms:
                b, a = (
                    (np.ones(1), np.ones(1))
                    if term.error_filter is None
                    else (
                        term.error_filter.b,
                        term.error_filter.a,
                    )
                )
                weights = np.concatenate([np.full(L, term.before), term.weights, np.full(M, term.after)])
                weights = problem.shares[p] * weights
                wanted = signal.lfilter(b, a, np.concatenate(course))
                energy += float(weights @ wanted**2)
                lost += float(weights[:L] @ wanted[:L] ** 2)
                outputs = [
                    signal.lfilter(b, a, each @ np.append(plant.C[p], plant.D[p, j])) for j, each in enumerate(states)
                ]
                by_command = np.hstack([linalg.toeplitz(y, np.zeros(N))[:, :free] for y in outputs])
                root = np.sqrt(weights[L:])
                rows.append(root[:, None] * by_command)
                asked.append(root * wanted[L:])
        moves = (np.eye(N) - np.eye(N, k=-1))[:, :free]
        limit, step = problem.limits.input_limit, 1e-4 / problem.grid.dt_s
        move_weight = np.sqrt(problem.rho * step**2 / (N * limit**2))
        currents = linalg.block_diag(*(linalg.toeplitz(x[:N, -1], np.zeros(N))[:, :free] for x in states))
        unit = np.sqrt(energy)
        A = [each / unit for each in rows] + [np.kron(np.eye(m), moves) * move_weight]
        A += [np.sqrt(problem.heat_price) * currents]
        b = [each / unit for each in asked] + [np.zeros(m * N)] * 2
        return cls(np.vstack(A), np.concatenate(b), lost / energy, currents)

    def value(self, command: FloatArray) -> float:
        """J of commands (m, free)."""
        left = self.A @ command.ravel() - self.b
        return float(left @ left) + self.rest

    def optimum(self, problem: TransientProblem) -> tuple[FloatArray, float]:
        """(m, N) commands within the box of every current and of every command, and their J."""
        m, N, free = problem.stage.motors, problem.grid.stages, problem.free_stages
        H, g = 2 * self.A.T @ self.A, -2 * self.A.T @ self.b
        shares = problem.limits.input.shares or (1.0,) * m
        most = np.repeat([problem.limits.input_limit * share for share in shares], N)
        moved = np.abs(self.currents).max(axis=1) > 0
        tolerances = {"eps_abs": EPS, "eps_rel": 0.0, "eps_duality_gap_abs": EPS, "eps_duality_gap_rel": 0.0}
        shape = {"h": ca.Sparsity.dense(m * free, m * free), "a": ca.Sparsity.dense(int(moved.sum()), m * free)}
        solver = ca.conic("dense", "piqp", shape, {"piqp": tolerances})
        box = np.full(m * free, problem.command_bound)
        scale = 1e3  # objectives of order one
        answer = solver(
            h=scale * H, g=scale * g, a=self.currents[moved], lba=-most[moved], uba=most[moved], lbx=-box, ubx=box
        )
        command = np.zeros((m, N))
        command[:, :free] = np.clip(np.asarray(answer["x"]).ravel(), -box, box).reshape(m, free)
        return command, self.value(command[:, :free])
