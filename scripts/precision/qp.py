"""The quadratic program of one entry as plain arrays, for solvers that know nothing of this project.

    minimise 1/2 x'Px + q'x   subject to   l <= A x <= u

read off the project's CasADi statement (`transopt.solvers.program`): nothing is condensed, every variable is of
order one.
"""

import io
from dataclasses import dataclass, fields, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from transopt.base.errors import InputError
from transopt.base.files import whole_file
from transopt.base.signals import FloatArray
from transopt.problem.answer import OBJECTIVE_SCALE, Multipliers
from transopt.problem.problem import TransientProblem
from transopt.problem.stage import linear_stage
from transopt.solvers import casadi_piqp
from transopt.solvers.options import SolverOptions
from transopt.solvers.program import state_program
from transopt.solvers.shape import Shape, program_shape
from transopt.solvers.statement import state

DUMP_SCHEMA = 3


@dataclass(frozen=True)
class QP:
    """One entry's QP, with what is needed to judge an answer to it.

    Variables: x = [dc_0, z_1, dc_1, z_2, ..., dc_(N-1), z_N], z the n states [plant, current, two of each
    term's filter, command] of the stage
    z_(k+1) = A_d z_k + B_d dc_k, z_0 = 0, each in its unit `units`; dc and the command in units of `current_unit_A`.
    Multipliers y: P x + q + A'y = 0, y < 0 where a lower bound is active, y > 0 where an upper one is.
    Objective: the project's J is `objective_scale` (1/2 x'Px + q'x) + `constant`.

    Attributes
    ----------
    P : (V, V) sparse, symmetric, both triangles. q : (V,).
    A : (m + b, V) sparse: `rows` = m rows of dynamics and hand-over, all equalities, stage by stage; then b rows of
        the identity, one for each variable `boxed` that has bounds. l, u : (m + b,).
    boxed : (b,) indices of variables. command_at : (N,) indices of the commands.
    A_d : (n, n), B_d : (n, 1), C_d : (T, n) acceleration through the filter of each term of the error, over sqrt(E).
    units : (n,) SI unit of each state. current_state : which of them is the current.
    current_limit_A, command_limit_A : |i(t)| and |c|. hand_over_samples : last commands, zero.
    wanted : (T, N + M) what C_d z is compared with: the target r - a_free through the filter of each term, over
        sqrt(E), at the switching instants, and at the M instants after the window, in which the command is zero.
    error_weights : (T, N + M) of the squared difference. movement_weight : of dc^2 [1/A^2].
    energy_m2_s4 : E, so that J is 1 without a command.
    dt_s : servo period.
    solution : (V,) reference solution, multipliers : (m + b,), objective : J of the solution, by its rollout.
    """

    name: str
    P: sparse.csc_array
    q: FloatArray
    A: sparse.csc_array
    l: FloatArray  # noqa: E741  the field's letter
    u: FloatArray
    rows: int
    boxed: NDArray[np.intp]
    command_at: NDArray[np.intp]
    A_d: FloatArray
    B_d: FloatArray
    C_d: FloatArray
    units: FloatArray
    current_state: int
    current_unit_A: float
    current_limit_A: float
    command_limit_A: float
    hand_over_samples: int
    wanted: FloatArray
    error_weights: FloatArray
    energy_m2_s4: float
    movement_weight: float
    dt_s: float
    objective_scale: float
    constant: float
    solution: FloatArray
    multipliers: FloatArray
    objective: float

    @property
    def stages(self) -> int:
        """N."""
        return int(self.command_at.size)

    def command(self, x: FloatArray) -> FloatArray:
        """(N,) commands [A] of a point (V,), moved by rounding only: into their range, zero at the hand-over."""
        command = np.clip(x[self.command_at] * self.current_unit_A, -self.command_limit_A, self.command_limit_A)
        command[self.stages - self.hand_over_samples :] = 0.0
        return np.asarray(command)

    def value(self, x: FloatArray) -> float:
        """J of a point (V,), as the QP states it."""
        return self.objective_scale * float(0.5 * x @ (self.P @ x) + self.q @ x) + self.constant

    def bounds(self) -> tuple[FloatArray, FloatArray]:
        """(V,) lower and upper bounds of the variables, infinite where there are none."""
        lower, upper = np.full(self.q.size, -np.inf), np.full(self.q.size, np.inf)
        lower[self.boxed], upper[self.boxed] = self.l[self.rows :], self.u[self.rows :]
        return lower, upper


def stage_order(shape: Shape) -> NDArray[np.intp]:
    """(m,) the program's rows, the dynamics of all stages and then the hand-over, sorted by stage.

    Methods that find the structure of an optimal-control problem themselves (HPIPM) need the rows of a stage
    together, its dynamics first.
    """
    N = shape.stages
    # The hand-over at the end of stage k limits the state that stage k + 1 begins with.
    handed_over = np.arange(N - shape.hand_over_samples, N) + 1
    return np.argsort(np.append(np.repeat(np.arange(N), shape.layout.states), handed_over), kind="stable")


def quadratic_program(name: str, problem: TransientProblem) -> QP:
    """The QP of an entry, its solution still zero (`solved`).

    Raises
    ------
    InputError : no QP of this plain form, with the part of the problem that it has not.
    """
    parts = {
        "a temperature limit": problem.thermal is not None,
        "a supply limit": "supply" in problem.limits,
        "a slew limit": "slew" in problem.limits,
        "a wall": problem.wall is not None,
        "a price on heat": problem.heat_price > 0,
        "a spread of devices": bool(problem.spread),
        "an ideal amplifier": "command" not in problem.limits,
    }
    for part, present in parts.items():
        if present:
            raise InputError(f"{name}: has {part}, which the plain QP of current and command limits does not state")
    statement, stage = state(problem), linear_stage(problem)
    data = state_program(statement.shape).qp_data(p=statement.p)
    boxed = np.flatnonzero(np.isfinite(statement.lower_x) | np.isfinite(statement.upper_x))
    V = statement.lower_x.size
    identity = sparse.csc_array((np.ones(boxed.size), (np.arange(boxed.size), boxed)), shape=(boxed.size, V))
    order = stage_order(statement.shape)
    rows = sparse.csc_array(data["A"].sparse())[order]
    tracking, shape = problem.tracking, statement.shape
    return QP(
        name=name,
        P=sparse.csc_array(data["H"].sparse()),
        q=np.asarray(data["q"]).ravel(),
        A=sparse.csc_array(sparse.vstack([rows, identity])),
        l=np.append(statement.lower_g[order], statement.lower_x[boxed]),
        u=np.append(statement.upper_g[order], statement.upper_x[boxed]),
        rows=order.size,
        boxed=boxed,
        command_at=shape.variables * np.arange(shape.stages) + shape.command,
        A_d=stage.A,
        B_d=stage.A[:, -1:],
        C_d=stage.C,
        units=stage.units,
        current_state=shape.layout.current,
        current_unit_A=stage.input_scale,
        current_limit_A=problem.limits.input_limit,
        command_limit_A=problem.limits["command"].stated,
        hand_over_samples=problem.hand_over_samples,
        wanted=tracking.unit_wanted,
        error_weights=tracking.weights[:, problem.target.before_m_s2.size :],
        energy_m2_s4=tracking.energy_m2_s4,
        movement_weight=problem.movement.weight,
        dt_s=problem.grid.dt_s,
        objective_scale=OBJECTIVE_SCALE,
        # What the error costs where nothing moves.
        constant=tracking.value(np.zeros(tracking.unit_wanted.shape[1])),
        solution=np.zeros(V),
        multipliers=np.zeros(order.size + boxed.size),
        objective=float("nan"),
    )


def solved(qp: QP, problem: TransientProblem, objective: float, tolerance: float) -> QP:
    """The QP with its reference point and multipliers, from the project's PIQP; `objective` is J of its rollout."""
    shape, statement = program_shape(problem), state(problem)
    program = state_program(shape)
    data = program.qp_data(p=statement.p)
    result = casadi_piqp.solver_object(shape, SolverOptions("casadi-piqp", tolerance))(
        h=data["H"],
        g=data["q"],
        a=data["A"],
        lba=statement.lower_g,
        uba=statement.upper_g,
        lbx=statement.lower_x,
        ubx=statement.upper_x,
    )
    on_rows = np.asarray(result["lam_a"]).ravel()[stage_order(shape)]
    on_variables = np.asarray(result["lam_x"]).ravel()[qp.boxed]
    solution = np.asarray(result["x"]).ravel()
    return replace(qp, solution=solution, multipliers=np.append(on_rows, on_variables), objective=objective)


def project_multipliers(problem: TransientProblem, qp: QP, y: FloatArray) -> Multipliers:
    """Multipliers y (m + b,) of the QP as those of the problem, in SI: what `transopt.proof.certify` takes."""
    on_rows = np.empty(qp.rows)
    on_rows[stage_order(program_shape(problem))] = y[: qp.rows]
    on_variables = np.zeros(qp.q.size)
    on_variables[qp.boxed] = y[qp.rows :]
    return state(problem).multipliers(on_variables, on_rows)


def dump(qp: QP, path: Path) -> None:
    """Write a QP as NPZ that numpy alone reads, without pickles: matrices as CSC parts NAME_data, _indices, _indptr,
    _shape, everything else under its name in `QP`.

    Raises
    ------
    InputError : the file cannot be written.
    """
    arrays: dict[str, object] = {"schema": DUMP_SCHEMA}
    for field in fields(QP):
        value = getattr(qp, field.name)
        if sparse.issparse(value):
            parts = {part: getattr(value, part) for part in ("data", "indices", "indptr", "shape")}
            arrays |= {f"{field.name}_{part}": array for part, array in parts.items()}
        else:
            arrays[field.name] = value
    content = io.BytesIO()
    np.savez_compressed(content, **{name: np.asarray(value) for name, value in arrays.items()})
    with whole_file(path) as file:
        file.write(content.getvalue())
