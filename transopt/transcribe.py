"""The optimal-control problem, stated once, in CasADi (DESIGN 4).

Every solver reads its data from this statement. Variables are stage-wise [dc_k, z_(k+1)], k = 0..N-1, with
z = [x / scale, c_(k) / I]: the stage model's states in physical scale and the command that was last issued, so
that the current (unless the amplifier is ideal), the command and its movement are all single variables and
every limit is a box. z_0 = 0 is not a variable. Nothing is condensed.
"""

from dataclasses import dataclass
from functools import lru_cache

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from transopt.discretise import state_scale
from transopt.problem import OBJECTIVE_SCALE, Multipliers, TransientProblem
from transopt.signals import FloatArray


@dataclass(frozen=True)
class Shape:
    """What fixes the sparsity of the program; problems of one shape share one solver object.

    Attributes
    ----------
    plant_states : of the device alone, acting ones. amplifier : False for an ideal one, which has no state.
    """

    stages: int
    plant_states: int
    amplifier: bool
    hand_over_samples: int

    @property
    def variables(self) -> int:
        """Variables of one stage: movement, plant states, current (unless ideal), command."""
        return self.plant_states + 2 + int(self.amplifier)

    def dynamics_mask(self) -> NDArray[np.bool_]:
        """(nz, nz) entries of the scaled stage matrix that can differ from zero; z is plant, current, command."""
        nz = self.variables - 1
        mask = np.zeros((nz, nz), dtype=bool)
        mask[: self.plant_states] = True  # the plant feels itself, the current and the held command
        np.fill_diagonal(mask, True)
        mask[:-1, -1] = True
        return mask

    def output_mask(self) -> NDArray[np.bool_]:
        """(1, nz) entries of the acceleration's row; the command acts on it directly only if it is the current."""
        mask = np.ones((1, self.variables - 1), dtype=bool)
        mask[0, -1] = not self.amplifier
        return mask


@dataclass(frozen=True)
class Program:
    """The statement as CasADi expressions and the functions that solvers and certificates read.

    Attributes
    ----------
    x : MX (N variables, 1) variables, stage by stage. p : MX parameters (see `parameters`).
    f : MX, J in units of `OBJECTIVE_SCALE`. g : MX, equality rows: dynamics, then the hand-over.
    qp_data : Function p -> (H sparse, q, A sparse) of 1/2 x'Hx + q'x, A x = 0.
    """

    shape: Shape
    x: ca.MX
    p: ca.MX
    f: ca.MX
    g: ca.MX
    qp_data: ca.Function


def _sparse_symbol(name: str, mask: NDArray[np.bool_]) -> tuple[ca.MX, ca.MX]:
    """A symbol for the nonzeros, column by column, and the matrix they fill."""
    rows, columns = np.nonzero(mask.T)[::-1]
    sparsity = ca.Sparsity.triplet(mask.shape[0], mask.shape[1], rows.tolist(), columns.tolist())
    nonzeros = ca.MX.sym(name, int(mask.sum()))
    return nonzeros, ca.MX(sparsity, nonzeros)


@lru_cache(maxsize=16)
def state_program(shape: Shape) -> Program:
    """State the problem for one shape; all numbers are parameters."""
    N, nz = shape.stages, shape.variables - 1
    variables = ca.MX.sym("stages", nz + 1, N)
    movement, after = variables[0, :], variables[1:, :]
    A_values, A = _sparse_symbol("A", shape.dynamics_mask())
    C_values, C = _sparse_symbol("C", shape.output_mask())
    B = ca.MX.sym("B", nz)
    reference, weights = ca.MX.sym("r", 1, N), ca.MX.sym("w", 1, N)
    movement_weight = ca.MX.sym("rho")

    before = ca.horzcat(ca.MX(nz, 1), after[:, :-1])
    dynamics = after - A @ before - B @ movement
    error = C @ before - reference
    if not shape.amplifier:
        error += C[0, nz - 1] * movement  # the command issued now acts at once
    objective = ca.dot(weights, error**2) + movement_weight * ca.dot(movement, movement)

    x = ca.vec(variables)
    f = objective / OBJECTIVE_SCALE
    g = ca.vertcat(ca.vec(dynamics), ca.vec(after[nz - 1, N - shape.hand_over_samples :]))
    p = ca.veccat(A_values, B, C_values, reference, weights, movement_weight)
    hessian, gradient = ca.hessian(f, x)
    at_zero = ca.substitute(gradient, x, ca.DM.zeros(x.numel()))
    qp_data = ca.Function("qp_data", [p], [hessian, at_zero, ca.jacobian(g, x)], ["p"], ["H", "q", "A"])
    return Program(shape, x, p, f, g, qp_data)


@dataclass(frozen=True)
class Scaling:
    """Units of the program's variables: states (nz - 1,), and the limit current for command and movement."""

    states: FloatArray
    current_A: float


def scaling(problem: TransientProblem) -> Scaling:
    current = problem.limits.current_A
    states = state_scale(problem.stage, current, problem.grid.stages)
    if problem.stage.amplifier is not None:
        states[-1] = current
    return Scaling(states, current)


def program_shape(problem: TransientProblem) -> Shape:
    stage = problem.stage
    return Shape(
        stages=problem.grid.stages,
        plant_states=stage.A.shape[0] - int(stage.amplifier is not None),
        amplifier=stage.amplifier is not None,
        hand_over_samples=problem.hand_over_samples,
    )


def stage_matrices(problem: TransientProblem, scale: Scaling) -> tuple[FloatArray, FloatArray, FloatArray]:
    """The scaled stage model on z = [states, command]: A (nz, nz), B (nz,), C (1, nz) of y'' / |r|."""
    stage, units = problem.stage, scale.states
    size = float(np.linalg.norm(problem.reference_m_s2))
    held = stage.B * scale.current_A / units[:, None]
    A = np.block([[stage.A * units / units[:, None], held], [np.zeros((1, units.size)), np.ones((1, 1))]])
    C = np.hstack([stage.C * units, stage.D * scale.current_A]) / size
    return A, A[:, -1], C


def parameters(problem: TransientProblem, scale: Scaling) -> FloatArray:
    """The program's parameter vector for one problem, scaled; the reference enters as r / |r|."""
    shape = program_shape(problem)
    A, B, C = stage_matrices(problem, scale)
    return np.concatenate(
        [
            A.T[shape.dynamics_mask().T],
            B,
            C[shape.output_mask()],
            problem.reference_m_s2 / np.linalg.norm(problem.reference_m_s2),
            problem.tracking_weights,
            [problem.movement_weight * scale.current_A**2],
        ]
    )


def box(problem: TransientProblem, scale: Scaling) -> FloatArray:
    """(N (nz + 1),) upper bounds of the program's variables; the lower bounds are their negatives."""
    N, nz = problem.grid.stages, problem.stage.A.shape[0] + 1
    limits = problem.limits
    bounds = np.full((N, nz + 1), np.inf)
    if limits.slew_A_per_s is not None:
        bounds[:, 0] = limits.slew_A_per_s * problem.grid.dt_s / scale.current_A
    if limits.command_A is None:
        bounds[:, nz] = 1.0
    else:
        bounds[:, nz] = limits.command_A / scale.current_A
        # The current at tau_N follows a zero command, so it is inside whenever the one before is.
        bounds[:-1, nz - 1] = 1.0
    return bounds.ravel()


def command(problem: TransientProblem, scale: Scaling, x: FloatArray) -> FloatArray:
    """(N,) the commands of a program point [A], moved by rounding only: into the box, zero over the hand-over."""
    nz = problem.stage.A.shape[0] + 1
    c = x.reshape(-1, nz + 1)[:, nz] * scale.current_A
    c = np.clip(c, -problem.limits.command_bound_A, problem.limits.command_bound_A)
    c[problem.free_stages :] = 0.0
    return np.asarray(c)


def multipliers(problem: TransientProblem, scale: Scaling, lam_x: FloatArray, lam_g: FloatArray) -> Multipliers:
    """CasADi's multipliers (grad f + J' lam_g + lam_x = 0) as multipliers of J in SI, clipped to their sign."""
    N, nz = problem.grid.stages, problem.stage.A.shape[0] + 1
    unit = OBJECTIVE_SCALE / scale.current_A
    box_multipliers = lam_x.reshape(N, nz + 1) * unit
    zero = np.zeros(N)
    on_command = box_multipliers[:, nz]
    if problem.limits.command_A is None:
        on_current, on_command = on_command, zero
    else:
        # The variable of stage k is the current at tau_(k+1); the current at tau_0 is zero and has no limit.
        on_current = np.concatenate([[0.0], box_multipliers[:-1, nz - 1]])
    on_movement = box_multipliers[:, 0] if problem.limits.slew_A_per_s is not None else zero
    both = Multipliers(
        current_lower=-on_current,
        current_upper=on_current,
        command_lower=-on_command,
        command_upper=on_command,
        slew_lower=-on_movement,
        slew_upper=on_movement,
        hand_over=lam_g[N * nz :] * unit,
    )
    return both.clipped()
