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

from transopt.discretise import state_scale
from transopt.problem import OBJECTIVE_SCALE, Multipliers, TransientProblem
from transopt.signals import FloatArray


@dataclass(frozen=True)
class Shape:
    """What fixes the sparsity of the program; problems of one shape share one solver object."""

    stages: int
    stage_states: int
    hand_over_samples: int


@dataclass(frozen=True)
class Program:
    """The statement as CasADi expressions and the functions that solvers and certificates read.

    Attributes
    ----------
    x : MX (N (nz + 1), 1) variables, stage by stage. p : MX parameters (see `parameters`).
    f : MX, J in units of `OBJECTIVE_SCALE`. g : MX, equality rows: N nz of dynamics, then the hand-over.
    qp_data : Function p -> (H sparse, q, A sparse) of 1/2 x'Hx + q'x, A x = 0.
    """

    shape: Shape
    x: ca.MX
    p: ca.MX
    f: ca.MX
    g: ca.MX
    qp_data: ca.Function


@lru_cache(maxsize=16)
def state_program(shape: Shape) -> Program:
    """State the problem for one shape; all numbers are parameters."""
    N, nz = shape.stages, shape.stage_states + 1
    variables = ca.MX.sym("stages", nz + 1, N)
    movement, after = variables[0, :], variables[1:, :]
    A, B = ca.MX.sym("A", nz, nz), ca.MX.sym("B", nz)
    C, D = ca.MX.sym("C", 1, nz), ca.MX.sym("D")
    reference, weights = ca.MX.sym("r", 1, N), ca.MX.sym("w", 1, N)
    movement_weight = ca.MX.sym("rho")

    before = ca.horzcat(ca.MX(nz, 1), after[:, :-1])
    dynamics = after - A @ before - B @ movement
    error = C @ before + D * movement - reference
    objective = ca.dot(weights, error**2) + movement_weight * ca.dot(movement, movement)

    x = ca.vec(variables)
    f = objective / OBJECTIVE_SCALE
    g = ca.vertcat(ca.vec(dynamics), ca.vec(after[nz - 1, N - shape.hand_over_samples :]))
    p = ca.veccat(A, B, C, D, reference, weights, movement_weight)
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
    return Shape(problem.grid.stages, problem.stage.A.shape[0], problem.hand_over_samples)


def parameters(problem: TransientProblem, scale: Scaling) -> FloatArray:
    """The program's parameter vector for one problem, scaled; the reference enters as r / |r|."""
    stage, units = problem.stage, scale.states
    size = float(np.linalg.norm(problem.reference_m_s2))
    A = stage.A * units / units[:, None]
    B = stage.B[:, 0] * scale.current_A / units
    full_A = np.block([[A, B[:, None]], [np.zeros((1, units.size)), np.ones((1, 1))]])
    full_C = np.append(stage.C[0] * units, stage.D[0, 0] * scale.current_A) / size
    return np.concatenate(
        [
            full_A.ravel(order="F"),
            B,
            [1.0],
            full_C,
            [stage.D[0, 0] * scale.current_A / size],
            problem.reference_m_s2 / size,
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
