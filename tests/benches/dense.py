"""An optimal-control problem of one entry solved another way: condensed, dense, from the plant's matrices alone.

Nothing of `transopt` but the numbers of the problem is used: the device is discretised here, every output is the sum
of its responses to the commands, and the quadratic program goes to an active-set method.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np
from scipy import linalg, signal

from transopt.base.signals import FloatArray
from transopt.plant.discretise import StageModel
from transopt.problem.problem import TransientProblem

OUTPUTS = {"stroke": "position", "velocity": "velocity", "current": "current"}  # of a limit


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


def _impulse(device: StageModel, dt_s: float, instants: int, later: float = 1.0) -> FloatArray:
    """(instants, n + 1) states of plant and current after one ampere of command over the first period.

    Parameters
    ----------
    later : share of a period after the end of the last one; the states are those there.
    """
    plant, amplifier = device.plant, device.amplifier
    n = plant.order
    flow = np.zeros((n + 2, n + 2))
    flow[:n, :n] = plant.A
    if amplifier is None:  # the held command is the current
        flow[:n, n + 1 :] = plant.B
    else:
        w = 2 * np.pi * amplifier.pole_Hz
        flow[:n, n : n + 1] = plant.B
        flow[n, n], flow[n, n + 1] = -w, w
    first, step = np.append(np.zeros(n + 1), 1.0), linalg.expm(flow * dt_s)
    found = np.zeros((instants, n + 2))
    found[0] = first
    for k in range(1, instants):
        found[k] = step @ found[k - 1]
        found[k, -1] = 0.0
    if later != 1:
        found[1:] = found[:-1] @ linalg.expm(flow * (later * dt_s)).T
        found[0] = 0.0
    if amplifier is None:
        found[:, n] = found[:, -1]
    return found[:, :-1]


def states(problem: TransientProblem) -> FloatArray:
    """(N + 1, N, n + 1) states of the plant and the current at tau_0 to tau_N by the commands."""
    N = problem.grid.stages
    found = _impulse(problem.stage, problem.grid.dt_s, N + 1)
    return np.stack([linalg.toeplitz(each, np.zeros(N)) for each in found.T], axis=-1)


def responses(problem: TransientProblem, device: StageModel | None = None, later: float = 1.0) -> Responses:
    """Compute Toeplitz matrices of impulse responses by one matrix exponential of plant and amplifier pole.

    Parameters
    ----------
    device : another one than the entry's own.
    later : share of a period; below 1 row k + 1 is so much later than tau_k, and row 0 is rest.
    """
    device = problem.stage if device is None else device
    plant, N = device.plant, problem.grid.stages
    n, states = plant.order, _impulse(device, problem.grid.dt_s, N + 1, later)

    def of(row: FloatArray) -> FloatArray:
        return linalg.toeplitz(states @ row, np.zeros(N))

    return Responses(
        acceleration=of(np.append(plant.C[0], plant.D[0])),
        current=of(np.eye(n + 1)[n]),
        position=of(np.append(plant.output("position").row[0], 0.0)),
        velocity=of(np.append(plant.output("velocity").row[0], 0.0)),
    )


@dataclass(frozen=True)
class Program:
    """L as a quadratic function of the commands, rolled out for every device from the lost samples to the tail.

    Attributes
    ----------
    filtered : (T, S, N + M, N) F y'' of every term and device by the commands; wanted : (T, N + M) F of the target.
    weights : (T, N + M). E : the weighted squares of the target. lost : those that no command can reach.
    current : (N, N) by the commands, and price : of its squares.
    """

    filtered: FloatArray
    wanted: FloatArray
    weights: FloatArray
    E: float
    lost: float
    intensity: float
    level: float
    by_movement: float
    current: FloatArray
    price: float

    @classmethod
    def of(cls, problem: TransientProblem) -> "Program":
        N, M, target = problem.grid.stages, problem.grid.after_stages, problem.target
        whole = np.concatenate([target.before_m_s2, target.window_m_s2, target.after_m_s2])
        L = target.before_m_s2.size
        filtered, wanted, weights = [], [], []
        for term in problem.terms:
            by = term.error_filter
            b, a = (np.ones(1), np.ones(1)) if by is None else (by.b, by.a)
            responses = []
            for device in problem.devices:
                states = _impulse(device, problem.grid.dt_s, N + M)
                response = signal.lfilter(b, a, states @ np.append(device.plant.C[0], device.plant.D[0]))
                responses.append(linalg.toeplitz(response, np.zeros(N)))
            filtered.append(np.stack(responses))
            wanted.append(signal.lfilter(b, a, whole))
            weights.append(np.concatenate([np.full(L, term.before), term.weights, np.full(M, term.after)]))
        squares = np.stack(weights) * np.stack(wanted) ** 2
        limit = problem.limits.input_limit
        return cls(
            filtered=np.stack(filtered),
            wanted=np.stack(wanted)[:, L:],
            weights=np.stack(weights)[:, L:],
            E=float(squares.sum()),
            lost=float(squares[:, :L].sum()),
            intensity=problem.intensity,
            level=10 ** (problem.intensity_dB / 10),
            by_movement=problem.rho * (1e-4 / problem.grid.dt_s) ** 2 / (N * limit**2),
            current=responses_of_current(problem),
            price=problem.heat_price,
        )

    def merits(self, command: FloatArray) -> tuple[float, float]:
        """J and L of a command (N,)."""
        N, made, current = command.size, self.filtered @ command, self.current @ command
        errors = (made - self.wanted[:, None]) ** 2
        squares = self.lost + float(np.sum(np.mean(errors, axis=1) * self.weights))
        J = squares / self.E + self.by_movement * float(np.sum(np.diff(command, prepend=0.0) ** 2))
        J += self.price * float(current @ current)
        energy = float(np.mean(np.sum(made[-1, :, :N] ** 2, axis=1)))
        return J, J - self.intensity * (energy - self.level * float(np.sum(self.wanted[-1, :N] ** 2))) / self.E

    def quadratic(self) -> tuple[FloatArray, FloatArray]:
        """(N, N) Hessian of L and (N,) its gradient at rest."""
        devices, N = self.filtered.shape[1], self.filtered.shape[3]
        moves = np.eye(N) - np.eye(N, k=-1)
        H, g = 2 * self.by_movement * moves.T @ moves + 2 * self.price * self.current.T @ self.current, np.zeros(N)
        for of_term, wanted, weights in zip(self.filtered, self.wanted, self.weights, strict=True):
            for a in of_term:
                H = H + 2 / (self.E * devices) * (a.T * weights) @ a
                g = g - 2 / (self.E * devices) * a.T @ (weights * wanted)
        for a in self.filtered[-1]:
            H = H - 2 * self.intensity / (self.E * devices) * a[:N].T @ a[:N]
        return H, g


def responses_of_current(problem: TransientProblem) -> FloatArray:
    """(N, N) the plant's input at tau_0 to tau_(N-1) by the commands."""
    N = problem.grid.stages
    states = _impulse(problem.stage, problem.grid.dt_s, N)
    return linalg.toeplitz(states[:, -1], np.zeros(N))


def within(problem: TransientProblem, name: str, shares: Sequence[float]) -> tuple[FloatArray, FloatArray]:
    """(m N, N) and (m N,) a limited output after these shares of all periods, by the commands, and z_nom's."""
    nominal = problem.limits[name].nominal  # type: ignore[attr-defined]
    stage, grid = problem.stage, problem.grid
    row, none = np.append(stage.plant.output(OUTPUTS[name]).row[0], 0.0), np.zeros(grid.stages)
    rows = [linalg.toeplitz((_impulse(stage, grid.dt_s, none.size + 1, s) @ row)[1:], none) for s in shares]
    return np.concatenate(rows), np.concatenate([(1 - s) * nominal[:-1] + s * nominal[1:] for s in shares])


def optimum(
    problem: TransientProblem, rows: FloatArray, lower: FloatArray, upper: FloatArray
) -> tuple[FloatArray, float]:
    """Command (N,) and J of the problem within its current and command limits and lower <= rows c <= upper."""
    N, free, program = problem.grid.stages, problem.free_stages, Program.of(problem)
    limit, most = problem.limits.input_limit, problem.command_bound
    H, g = program.quadratic()
    H, g = H[:free, :free], g[:free]
    constraints = np.concatenate([responses(problem).current[:N, :free], rows[:, :free]])
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
    return command, program.merits(command)[0]


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
    tap_error : |y'' - r| / |r| from contact to the end of the intention, of a target without a_free.
    reached : name of a limit -> largest size of what it bounds.
    """

    tap_error: float
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
    error, target = found.acceleration[:N] @ command - r, problem.target
    lost = float(np.sum(target.before_m_s2**2))
    tau = problem.grid.switching_times_s
    first = (tau >= 0) & (tau < problem.intention_s)
    error, r = error[first], r[first]
    sizes = np.abs(rows @ command + offset)
    reached = {
        "current": float(np.abs(found.current[:N] @ command).max()),
        "command": float(np.abs(command).max()),
        "slew": float(np.abs(np.diff(command, prepend=0.0)).max()),
    }
    if rail is not None:
        reached["supply"] = float(sizes[0 if step_A is None else N :].max())
    return Limited(float(np.sqrt((lost + error @ error) / (lost + r @ r))), reached)
