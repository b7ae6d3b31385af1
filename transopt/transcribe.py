"""The optimal-control problem, stated once, in CasADi (DESIGN 4).

Every solver reads its data from this statement. Variables are stage-wise [dc_k, e_k, x_(k+1), th_(k+1)], k = 0..N-1:
the command's movement, the linear states of `linear` in physical scale, and where the temperature is in the problem
the size e_k of the mean current and the nodes' rises. x_0 = 0 is not a variable; th_0 is one, in front, where taps
repeat. Current, command and movement are single variables, so that their limits are boxes. Nothing is condensed.
"""

from dataclasses import dataclass, fields
from functools import lru_cache

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from transopt.linear import Layout, LinearStage, hand_over_rows, layout, linear_stage
from transopt.problem import OBJECTIVE_SCALE, Multipliers, TransientProblem
from transopt.signals import FloatArray
from transopt.thermal import PWM_RIPPLE_A

REPEATED_WEIGHT = 1e3
SIZE_BOUND = 2.0  # of the limit current


@dataclass(frozen=True)
class Shape:
    """What fixes the sparsity of the program; problems of one shape share one solver object.

    Attributes
    ----------
    supply : whether the supply rows are in. nodes : thermal states, 0 without. repeated : taps repeat for ever.
    """

    stages: int
    layout: Layout
    hand_over_samples: int
    supply: bool
    nodes: int
    repeated: bool

    @property
    def controls(self) -> int:
        """Movement, and with the temperature the size of the mean current."""
        return 1 + int(self.nodes > 0)

    @property
    def variables(self) -> int:
        """Variables of one stage."""
        return self.controls + self.layout.states + self.nodes

    @property
    def first(self) -> int:
        """Variables in front of the first stage."""
        return self.nodes if self.repeated else 0

    @property
    def command(self) -> int:
        """Index of the command among a stage's variables."""
        return self.controls + self.layout.states - 1


@dataclass(frozen=True)
class Program:
    """The statement as CasADi expressions and the functions that solvers and certificates read.

    Attributes
    ----------
    x : MX (variables, 1), stage by stage. p : MX parameters (see `parameters`).
    f : MX, J in units of `OBJECTIVE_SCALE`. g : MX, rows kind by kind.
    rows : kind -> where it stands in g: "dynamics", "heat", "size_above", "size_below", "pause", "hand_over",
        "supply_before", "supply_after".
    row_stages : (rows,) stage that each row belongs to. stage_order : permutation of g that sorts them by it.
    qp_data : Function p -> (H sparse, q, A sparse) of 1/2 x'Hx + q'x, lb <= A x <= ub. With the temperature
        (`nlp_only`) there is none.
    """

    shape: Shape
    x: ca.MX
    p: ca.MX
    f: ca.MX
    g: ca.MX
    rows: dict[str, slice]
    row_stages: NDArray[np.intp]
    stage_order: NDArray[np.intp]
    nlp_only: bool
    _qp_data: ca.Function | None

    @property
    def qp_data(self) -> ca.Function:
        assert self._qp_data is not None
        return self._qp_data


def _sparse_symbol(name: str, mask: NDArray[np.bool_]) -> tuple[ca.MX, ca.MX]:
    """A symbol for the nonzeros, column by column, and the matrix they fill."""
    rows, columns = np.nonzero(mask.T)[::-1]
    sparsity = ca.Sparsity.triplet(mask.shape[0], mask.shape[1], rows.tolist(), columns.tolist())
    nonzeros = ca.MX.sym(name, int(mask.sum()))
    return nonzeros, ca.MX(sparsity, nonzeros)


def _nonzeros(matrix: FloatArray, mask: NDArray[np.bool_]) -> FloatArray:
    return np.asarray(matrix.T[mask.T])


def _feedback_mask(where: Layout) -> NDArray[np.bool_]:
    """(1, n) states that the hand-over's command depends on."""
    mask = np.zeros((1, where.states), dtype=bool)
    mask[0, where.wall] = True
    return mask


def _supply_mask(where: Layout) -> NDArray[np.bool_]:
    """(1, n) states that the terminal voltage depends on."""
    mask = np.zeros((1, where.states), dtype=bool)
    mask[0, where.plant(0)] = mask[0, where.current] = mask[0, -1] = True
    return mask


@dataclass(frozen=True)
class _HeatSymbols:
    """Parameters of the temperature recursion, in units of the limit current and of the headroom."""

    M: ca.MX
    b: ca.MX
    gain: ca.MX
    copper: ca.MX
    square: ca.MX
    share: ca.MX
    decay: ca.MX
    ripple: ca.MX
    F: ca.MX
    f: ca.MX

    @classmethod
    def make(cls, shape: Shape) -> "_HeatSymbols":
        m = shape.nodes
        sizes = {"M": (m, m), "b": (m, 1), "gain": (1, shape.stages), "square": (3, 1), "F": (m, m), "f": (m, 1)}
        return cls(**{field.name: ca.MX.sym(field.name, *sizes.get(field.name, (1, 1))) for field in fields(cls)})

    def mean_current(self, current: ca.MX, command: ca.MX) -> ca.MX:
        """`heat.Heating.mean_current`, in units of the limit current."""
        return self.share * current + (1 - self.share) * (self.decay * current + (1 - self.decay) * command)

    def mean_square(self, current: ca.MX, command: ca.MX, size: ca.MX) -> ca.MX:
        """Mean of i_eff^2 over a period; `heat.Heating.mean_square` with |mean i| a variable of its own."""
        a, b = current, self.decay * current + (1 - self.decay) * command
        quadratic = self.square[0] * a**2 + self.square[1] * a * b + self.square[2] * b**2
        return quadratic + 2 * self.ripple * size + self.ripple**2


@lru_cache(maxsize=16)
def state_program(shape: Shape) -> Program:
    """State the problem for one shape; all numbers are parameters."""
    N, n, m, h, where = shape.stages, shape.layout.states, shape.nodes, shape.hand_over_samples, shape.layout
    variables = ca.MX.sym("stages", shape.variables, N)
    first = ca.MX.sym("start", shape.first)
    movement, after = variables[0, :], variables[shape.controls : shape.controls + n, :]
    rise = variables[shape.controls + n :, :]
    A_values, A = _sparse_symbol("A", where.dynamics_mask())
    C_values, C = _sparse_symbol("C", where.output_mask())
    B, E = ca.MX.sym("B", n), ca.MX.sym("E", where.devices)
    reference, weights = ca.MX.sym("r", 1, N), ca.MX.sym("w", 1, N)
    movement_weight = ca.MX.sym("rho")
    symbols = [A_values, B, C_values, E, reference, weights, movement_weight]

    before = ca.horzcat(ca.MX(n, 1), after[:, :-1])
    error = C @ before - ca.repmat(reference, where.devices, 1)
    if not where.amplifier:
        error += E @ movement
    tracking = sum(ca.dot(weights, error[s, :] ** 2) for s in range(where.devices)) / where.devices
    objective = tracking + movement_weight * ca.dot(movement, movement)

    # Each kind's rows with the stage they belong to in a stage-wise order.
    kinds: list[tuple[str, ca.MX, NDArray[np.intp]]] = []
    every = np.arange(N)
    kinds.append(("dynamics", ca.vec(after - A @ before - B @ movement), np.repeat(every, n)))
    if m:
        heat = _HeatSymbols.make(shape)
        symbols += [getattr(heat, field.name) for field in fields(_HeatSymbols)]
        warm = ca.horzcat(first if shape.repeated else ca.MX(m, 1), rise[:, :-1])
        current = before[where.current, :] if where.amplifier else ca.MX(1, N)
        size, issued = variables[1, :], before[-1, :] + movement
        power = (heat.gain + heat.copper * warm[0, :]) * heat.mean_square(current, issued, size)
        # A step's own rise is tiny beside the headroom of taps that repeat: the row is weighed to be met as exactly.
        weight = REPEATED_WEIGHT if shape.repeated else 1.0
        kinds.append(("heat", ca.vec(weight * (rise - heat.M @ warm - heat.b @ power)), np.repeat(every, m)))
        # size >= |mean i|: the kink of Eq. 7 as two rows, on which Newton does not stumble.
        mean = heat.mean_current(current, issued)
        kinds.append(("size_above", ca.vec(size - mean), every))
        kinds.append(("size_below", ca.vec(size + mean), every))
        if shape.repeated:
            kinds.append(("pause", weight * (first - heat.F @ rise[:, -1] - heat.f), np.full(m, N)))
    if where.feedback_delay is None:
        kinds.append(("hand_over", ca.vec(after[-1, N - h :]), every[N - h :] + 1))
    else:
        mask = np.repeat(_feedback_mask(where), h, axis=0).T
        T_values, T = _sparse_symbol("T", mask)
        symbols.append(T_values)
        asked = before[-1, N - h :] + movement[N - h :] - ca.sum1(T * before[:, N - h :])
        kinds.append(("hand_over", ca.vec(asked), every[N - h :]))
    if shape.supply:
        S_values, S = _sparse_symbol("S", _supply_mask(where))
        direct = ca.MX.sym("S_direct")
        symbols += [S_values, direct]
        kinds.append(("supply_before", ca.vec(S @ after[:, :-1]), every[1:]))
        kinds.append(("supply_after", ca.vec(S @ before + direct * movement), every))

    ends = np.cumsum([0, *(rows.numel() for _, rows, _ in kinds)])
    # Stable: within a stage the dynamics stay first, then come the limits.
    row_stages = np.concatenate([stages for _, _, stages in kinds])
    order = np.argsort(row_stages, kind="stable")
    x = ca.veccat(first, variables)
    f = objective / OBJECTIVE_SCALE
    g = ca.vertcat(*(rows for _, rows, _ in kinds))
    p = ca.veccat(*symbols)
    qp_data = None
    if not m:
        hessian, gradient = ca.hessian(f, x)
        at_zero = ca.substitute(gradient, x, ca.DM.zeros(x.numel()))
        qp_data = ca.Function("qp_data", [p], [hessian, at_zero, ca.jacobian(g, x)], ["p"], ["H", "q", "A"])
    rows_of = {name: slice(int(ends[j]), int(ends[j + 1])) for j, (name, _, _) in enumerate(kinds)}
    return Program(shape, x, p, f, g, rows_of, row_stages, order, qp_data is None, qp_data)


def program_shape(problem: TransientProblem) -> Shape:
    thermal = problem.thermal
    return Shape(
        stages=problem.grid.stages,
        layout=layout(problem),
        hand_over_samples=problem.hand_over_samples,
        supply=problem.supply is not None,
        nodes=0 if thermal is None else thermal.model.nodes,
        repeated=thermal is not None and thermal.model.closure is not None,
    )


@dataclass(frozen=True)
class Statement:
    """One problem's numbers for the program of its shape.

    Attributes
    ----------
    p : parameters. lower_x, upper_x, lower_g, upper_g : bounds.
    kelvin : unit of the rises; 0 without temperature.
    """

    problem: TransientProblem
    shape: Shape
    stage: LinearStage
    kelvin: float
    p: FloatArray
    lower_x: FloatArray
    upper_x: FloatArray
    lower_g: FloatArray
    upper_g: FloatArray


def _kelvin(problem: TransientProblem) -> float:
    """Unit of the rises: the largest headroom."""
    if problem.thermal is None:
        return 0.0
    headroom = problem.thermal.model.headroom_K
    return max(float(headroom[np.isfinite(headroom)].max()), 1e-9)


def _parameters(problem: TransientProblem, shape: Shape, stage: LinearStage, kelvin: float) -> FloatArray:
    """In the order of the program's symbols; the reference enters as r / |r|."""
    where, r = shape.layout, problem.reference_m_s2
    filtered = r if problem.error_filter is None else problem.error_filter.apply(r)
    values = [
        _nonzeros(stage.A, where.dynamics_mask()),
        stage.A[:, -1],
        _nonzeros(stage.C, where.output_mask()),
        stage.E,
        filtered / np.linalg.norm(r),
        problem.tracking_weights,
        [problem.movement_weight * stage.current_A**2],
    ]
    if problem.thermal is not None:
        model, unit = problem.thermal.model, stage.current_A
        F, f = (np.zeros_like(model.M), np.zeros_like(model.b)) if model.closure is None else model.closure
        heat: dict[str, FloatArray | list[float]] = {
            "M": model.M.T.ravel(),
            "b": model.b * unit**2 / kelvin,
            "gain": model.gain,
            "copper": [model.copper * kelvin],
            "square": model.heating.square,
            "share": [model.heating.share],
            "decay": [model.heating.decay],
            "ripple": [PWM_RIPPLE_A / unit],
            "F": F.T.ravel(),
            "f": f / kelvin,
        }
        values += [heat[field.name] for field in fields(_HeatSymbols)]
    if where.feedback_delay is not None:
        rows, _ = hand_over_rows(problem, stage)
        values.append(rows[:, where.wall].ravel())
    if problem.supply is not None:
        volts = problem.supply.limit_V
        values.append(_nonzeros(stage.supply[None] / volts, _supply_mask(where)))
        values.append([problem.supply.by_command * stage.current_A / volts])
    return np.concatenate([np.asarray(value, dtype=float).ravel() for value in values])


def _variable_bounds(
    problem: TransientProblem, shape: Shape, stage: LinearStage, kelvin: float
) -> tuple[FloatArray, FloatArray]:
    N, limits, where = shape.stages, problem.limits, shape.layout
    upper = np.full((N, shape.variables), np.inf)
    if limits.slew_A_per_s is not None:
        upper[:, 0] = limits.slew_A_per_s * problem.grid.dt_s / stage.current_A
    if limits.command_A is None:
        upper[:, shape.command] = 1.0
    else:
        upper[:, shape.command] = limits.command_A / stage.current_A
        # The current at tau_N follows the hand-over, so the horizon's limits end at the instant before.
        upper[:-1, shape.controls + where.current] = 1.0
    lower = -upper
    if problem.thermal is not None:
        # No mean current is larger than the limit; unbounded, a size whose heat does not matter would drift.
        lower[:, 1], upper[:, 1] = -SIZE_BOUND, SIZE_BOUND
        upper[:, shape.command + 1] = problem.thermal.model.headroom_K / kelvin
    front = np.full(shape.first, np.inf)
    return np.append(-front, lower.ravel()), np.append(front, upper.ravel())


def _row_bounds(problem: TransientProblem, shape: Shape, stage: LinearStage) -> tuple[FloatArray, FloatArray]:
    program = state_program(shape)
    lower, upper = np.zeros(program.g.numel()), np.zeros(program.g.numel())
    _, constant = hand_over_rows(problem, stage)
    for kind in ("size_above", "size_below"):
        upper[program.rows.get(kind, slice(0, 0))] = np.inf
    lower[program.rows["hand_over"]] = upper[program.rows["hand_over"]] = constant
    if problem.supply is not None:
        nominal = problem.supply.nominal_V / problem.supply.limit_V
        for kind, volts in (("supply_before", nominal[1:]), ("supply_after", nominal)):
            lower[program.rows[kind]], upper[program.rows[kind]] = -1 - volts, 1 - volts
    return lower, upper


def state(problem: TransientProblem) -> Statement:
    """Numbers of one problem for the program of its shape."""
    shape, stage, kelvin = program_shape(problem), linear_stage(problem), _kelvin(problem)
    lower_x, upper_x = _variable_bounds(problem, shape, stage, kelvin)
    lower_g, upper_g = _row_bounds(problem, shape, stage)
    p = _parameters(problem, shape, stage, kelvin)
    return Statement(problem, shape, stage, kelvin, p, lower_x, upper_x, lower_g, upper_g)


def _by_stage(statement: Statement, x: FloatArray) -> FloatArray:
    """(N, variables) of a program point."""
    return x[statement.shape.first :].reshape(statement.shape.stages, statement.shape.variables)


def command(statement: Statement, x: FloatArray) -> FloatArray:
    """(N,) the commands of a program point [A], moved by rounding only: into the box; zero over a plain hand-over."""
    problem = statement.problem
    c = _by_stage(statement, x)[:, statement.shape.command] * statement.stage.current_A
    c = np.clip(c, -problem.limits.command_bound_A, problem.limits.command_bound_A)
    if problem.wall is None:
        c[problem.free_stages :] = 0.0
    return np.asarray(c)


def multipliers(statement: Statement, lam_x: FloatArray, lam_g: FloatArray) -> Multipliers:
    """CasADi's multipliers (grad f + J' lam_g + lam_x = 0) as multipliers of J in SI, clipped to their sign."""
    problem, shape = statement.problem, statement.shape
    N, rows = shape.stages, state_program(shape).rows
    unit = OBJECTIVE_SCALE / statement.stage.current_A
    boxes = _by_stage(statement, lam_x)
    zero = np.zeros(N)
    on_command = boxes[:, shape.command] * unit
    if problem.limits.command_A is None:
        on_current, on_command = on_command, zero
    else:
        # The variable of stage k is the current at tau_(k+1); the current at tau_0 is zero and has no limit.
        on_current = np.append(0.0, boxes[:-1, shape.controls + shape.layout.current]) * unit
    on_movement = boxes[:, 0] * unit if problem.limits.slew_A_per_s is not None else zero
    before, after = zero, zero
    if problem.supply is not None:
        per_volt = OBJECTIVE_SCALE / problem.supply.limit_V
        before = np.append(0.0, lam_g[rows["supply_before"]]) * per_volt
        after = lam_g[rows["supply_after"]] * per_volt
    sign = zero
    if shape.nodes:
        above, below = (np.maximum(-lam_g[rows[kind]], 0.0) for kind in ("size_above", "size_below"))
        # The two share what the size is worth; where it is worth nothing any sign will do.
        sign = (above - below) / np.maximum(above + below, np.finfo(float).tiny)
    on_winding = zero if shape.nodes == 0 else boxes[:, shape.command + 1] * OBJECTIVE_SCALE / statement.kelvin
    return Multipliers(
        current_lower=-on_current,
        current_upper=on_current,
        command_lower=-on_command,
        command_upper=on_command,
        slew_lower=-on_movement,
        slew_upper=on_movement,
        supply_before_lower=-before,
        supply_before_upper=before,
        supply_after_lower=-after,
        supply_after_upper=after,
        temperature_upper=on_winding,
        current_sign=sign,
        hand_over=lam_g[rows["hand_over"]] * unit,
    ).clipped()


@dataclass(frozen=True)
class Size:
    """How large a solved program was: states per stage, rows and nonzeros of the constraints' Jacobian."""

    states: int
    variables: int
    rows: int
    nonzeros: int


@lru_cache(maxsize=16)
def _size(shape: Shape) -> Size:
    program = state_program(shape)
    if not program.nlp_only:
        nonzeros = program.qp_data.sparsity_out("A").nnz()
    else:
        nonzeros = ca.Function("rows", [program.x, program.p], [program.g]).jac_sparsity(0, 0).nnz()
    return Size(shape.variables - shape.controls, program.x.numel(), program.g.numel(), nonzeros)


def size(problem: TransientProblem) -> Size:
    """Size of the program that states this problem."""
    return _size(program_shape(problem))
