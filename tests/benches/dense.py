"""An optimal-control problem of one entry solved another way: condensed, dense, from the plant's matrices alone.

Nothing of `transopt` but the numbers of the problem is used: the device is discretised here, every output is the sum
of its responses to the commands, and the quadratic program goes to an active-set method.
"""

from dataclasses import dataclass

import casadi as ca
import numpy as np
from scipy import linalg

from transopt.base.signals import FloatArray
from transopt.problem.problem import TransientProblem


@dataclass(frozen=True)
class Responses:
    """Outputs at tau_0 to tau_N as matrices (N + 1, N) by the commands.

    Attributes
    ----------
    acceleration : y'' of the stylus.
    current : i.
    position, velocity : y and dy/dt of the motor mass.
    """

    acceleration: FloatArray
    current: FloatArray
    position: FloatArray
    velocity: FloatArray


def _impulse(problem: TransientProblem) -> FloatArray:
    """(N + 1, n + 1) states of plant and amplifier after one ampere of command over the first period."""
    plant, amplifier, N = problem.stage.plant, problem.stage.amplifier, problem.grid.stages
    assert amplifier is not None
    n, w = plant.order, 2 * np.pi * amplifier.pole_Hz
    flow = np.zeros((n + 2, n + 2))
    flow[:n, :n], flow[:n, n : n + 1] = plant.A, plant.B
    flow[n, n], flow[n, n + 1] = -w, w
    step = linalg.expm(flow * problem.grid.dt_s)
    A, b = step[: n + 1, : n + 1], step[: n + 1, n + 1]
    states = np.zeros((N + 1, n + 1))
    for k in range(1, N + 1):
        states[k] = A @ states[k - 1] + (b if k == 1 else 0.0)
    return states


def states(problem: TransientProblem) -> FloatArray:
    """(N + 1, N, n + 1) states of the plant and the current at tau_0 to tau_N by the commands."""
    found = _impulse(problem)
    return np.stack([linalg.toeplitz(each, np.zeros(problem.grid.stages)) for each in found.T], axis=-1)


def responses(problem: TransientProblem) -> Responses:
    """By one matrix exponential of plant and amplifier pole, and Toeplitz matrices of the impulse responses."""
    plant, N, states = problem.stage.plant, problem.grid.stages, _impulse(problem)
    n = plant.order

    def of(row: FloatArray) -> FloatArray:
        return linalg.toeplitz(states @ row, np.zeros(N))

    return Responses(
        acceleration=of(np.append(plant.C[0], plant.D[0])),
        current=of(np.eye(n + 1)[n]),
        position=of(np.append(plant.Ce[0], 0.0)),
        velocity=of(np.append((plant.Ce @ plant.A)[0], 0.0)),
    )


def optimum(
    problem: TransientProblem, rows: FloatArray, lower: FloatArray, upper: FloatArray
) -> tuple[FloatArray, float]:
    """Command (N,) and J of the problem within its current and command limits and lower <= rows c <= upper."""
    found, r, N = responses(problem), problem.reference_m_s2, problem.grid.stages
    free, E = problem.free_stages, float(r @ r)
    limit, most = problem.limits["current"].stated, problem.limits["command"].stated
    moves = np.eye(N) - np.eye(N, k=-1)
    by_movement = problem.rho * (1e-4 / problem.grid.dt_s) ** 2 / (N * limit**2)
    a = found.acceleration[:N]
    H = 2 * (a.T @ a / E + by_movement * moves.T @ moves)[:free, :free]
    g = -2 * (a.T @ r / E)[:free]
    constraints = np.concatenate([found.current[:N, :free], rows[:, :free]])
    low = np.concatenate([np.full(N, -limit), lower])
    high = np.concatenate([np.full(N, limit), upper])
    solver = ca.conic(
        "dense",
        "qpoases",
        {"h": ca.DM(H).sparsity(), "a": ca.DM(constraints).sparsity()},
        {"printLevel": "none", "nWSR": 20000, "error_on_fail": True},
    )
    answer = solver(h=H, g=g, a=constraints, lba=low, uba=high, lbx=-most, ubx=most)
    command = np.append(np.asarray(answer["x"]).ravel(), np.zeros(N - free))
    error, movement = a @ command - r, moves @ command
    return command, float(error @ error / E + by_movement * movement @ movement)


@dataclass(frozen=True)
class Rail:
    """A supply rail, and all that the terminal voltage is made of.

    Attributes
    ----------
    R_ohm : resistances of the copper at which it is kept.
    emf_V_s_m : back-EMF per m/s of the motor mass.
    nominal_m_s : (N,) velocity of the nominal motion at tau_k.
    """

    limit_V: float
    R_ohm: tuple[float, ...]
    L_H: float
    pole_Hz: float
    emf_V_s_m: float
    nominal_m_s: FloatArray


@dataclass(frozen=True)
class Limited:
    """An optimum under the limits that are linear.

    Attributes
    ----------
    nrmse : of y'' against r.
    reached : name of a limit -> largest size of what it bounds.
    """

    nrmse: float
    reached: dict[str, float]


def limited(problem: TransientProblem, step_A: float | None, rail: Rail | None) -> Limited:
    """The optimum within the problem's current and command limits, a step of the command per tick, and a rail."""
    found, N, r = responses(problem), problem.grid.stages, problem.reference_m_s2
    held = np.eye(N, k=-1)
    blocks, offsets, bounds = [np.zeros((0, N))], [np.zeros(0)], [np.zeros(0)]
    if step_A is not None:
        blocks.append(np.eye(N) - held)
        offsets.append(np.zeros(N))
        bounds.append(np.full(N, step_A))
    if rail is not None:
        i, w = found.current[:N], 2 * np.pi * rail.pole_Hz
        for R in rail.R_ohm:
            for felt in (held, np.eye(N)):
                blocks.append(R * i + rail.L_H * w * (felt - i) + rail.emf_V_s_m * found.velocity[:N])
                offsets.append(rail.emf_V_s_m * rail.nominal_m_s)
                bounds.append(np.full(N, rail.limit_V))
    rows, offset, bound = (np.concatenate(each) for each in (blocks, offsets, bounds))
    # A row that no command moves has nothing to say.
    moved = np.abs(rows).max(axis=1) > 0
    command, _ = optimum(problem, rows[moved], -bound[moved] - offset[moved], bound[moved] - offset[moved])
    error = found.acceleration[:N] @ command - r
    sizes = np.abs(rows @ command + offset)
    reached = {
        "current": float(np.abs(found.current[:N] @ command).max()),
        "command": float(np.abs(command).max()),
        "slew": float(np.abs(np.diff(command, prepend=0.0)).max()),
    }
    if rail is not None:
        reached["supply"] = float(sizes[0 if step_A is None else N :].max())
    return Limited(float(np.sqrt(error @ error / (r @ r))), reached)
