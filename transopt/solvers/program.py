"""The optimal-control problem, stated once, in CasADi (DESIGN 4).

Every solver reads its data from this statement. Variables are stage-wise [dc_k, e_k, x_(k+1), th_(k+1)], k = 0..N-1:
the command's movement, the linear states of `linear` in physical scale, and where the temperature is in the problem
the size e_k of the mean current and the nodes' rises. x_0 = 0 is not a variable; th_0 is one, in front, where taps
repeat. Current, command and movement are single variables, so that their limits are boxes. Nothing is condensed.
"""

from dataclasses import dataclass, fields, replace
from functools import lru_cache

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from transopt.base.signals import FloatArray
from transopt.problem.problem import OBJECTIVE_SCALE, TransientProblem
from transopt.problem.stage import Layout, layout

REPEATED_WEIGHT = 1e3


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
    x : MX (variables, 1), stage by stage. p : MX, all parameters.
    parameters : their names, in the order in which they stand in p.
    f : MX, J in units of `OBJECTIVE_SCALE`. g : MX, rows kind by kind.
    rows : kind -> where it stands in g: "dynamics", "heat", "size_above", "size_below", "pause", "hand_over",
        "supply_before", "supply_after".
    qp_data : Function p -> (H sparse, q, A sparse) of 1/2 x'Hx + q'x, lb <= A x <= ub. With the temperature
        (`nlp_only`) there is none.
    """

    shape: Shape
    x: ca.MX
    p: ca.MX
    parameters: tuple[str, ...]
    f: ca.MX
    g: ca.MX
    rows: dict[str, slice]
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


def nonzeros(matrix: FloatArray, mask: NDArray[np.bool_]) -> FloatArray:
    """Entries under a mask, column by column, as the program's symbols take them."""
    return np.asarray(matrix.T[mask.T])


def feedback_mask(where: Layout) -> NDArray[np.bool_]:
    """(1, n) states that the hand-over's command depends on."""
    mask = np.zeros((1, where.states), dtype=bool)
    mask[0, where.wall] = True
    return mask


def supply_mask(where: Layout) -> NDArray[np.bool_]:
    """(1, n) states that the terminal voltage depends on."""
    mask = np.zeros((1, where.states), dtype=bool)
    mask[0, where.plant(0)] = mask[0, where.current] = mask[0, -1] = True
    return mask


@dataclass(frozen=True)
class HeatSymbols:
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
    def make(cls, shape: Shape) -> "HeatSymbols":
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


@dataclass(frozen=True)
class Stage:
    """What happens at a stage, as expressions; for states (n, K) and movements (1, K) at K stages side by side.

    Attributes
    ----------
    A, B, C, E : MX of `linear.LinearStage`. S, direct : of the terminal voltage; None without supply rows.
    heat : None without temperature. symbols : in the order in which `statement` gives their values.
    """

    layout: Layout
    A: ca.MX
    B: ca.MX
    C: ca.MX
    E: ca.MX
    S: ca.MX | None
    direct: ca.MX | None
    heat: HeatSymbols | None
    symbols: dict[str, ca.MX]

    @classmethod
    def make(cls, shape: Shape) -> "Stage":
        where = shape.layout
        A_values, A = _sparse_symbol("A", where.dynamics_mask())
        C_values, C = _sparse_symbol("C", where.output_mask())
        B, E = ca.MX.sym("B", where.states), ca.MX.sym("E", where.devices)
        symbols = {"A": A_values, "B": B, "C": C_values, "E": E}
        heat = HeatSymbols.make(shape) if shape.nodes else None
        if heat is not None:
            symbols |= {field.name: getattr(heat, field.name) for field in fields(HeatSymbols)}
        S = direct = None
        if shape.supply:
            S_values, S = _sparse_symbol("S", supply_mask(where))
            direct = ca.MX.sym("S_direct")
            symbols |= {"S": S_values, "S_direct": direct}
        return cls(where, A, B, C, E, S, direct, heat, symbols)

    def after(self, before: ca.MX, movement: ca.MX) -> ca.MX:
        """(n, K) states one period later."""
        return self.A @ before + self.B @ movement

    def outputs(self, before: ca.MX, movement: ca.MX) -> ca.MX:
        """(S, K) tracked outputs."""
        found = self.C @ before
        return found if self.layout.amplifier else found + self.E @ movement

    def voltage_before(self, state: ca.MX) -> ca.MX:
        """(1, K) just before the switching instant that the state belongs to, without the nominal motion's."""
        assert self.S is not None
        return self.S @ state

    def voltage_after(self, before: ca.MX, movement: ca.MX) -> ca.MX:
        assert self.S is not None
        assert self.direct is not None
        return self.S @ before + self.direct * movement

    def current(self, before: ca.MX) -> ca.MX:
        """(1, K) zero for an ideal amplifier, whose current is the command."""
        return before[self.layout.current, :] if self.layout.amplifier else ca.MX(1, before.size2())

    def mean_current(self, before: ca.MX, movement: ca.MX) -> ca.MX:
        assert self.heat is not None
        return self.heat.mean_current(self.current(before), before[-1, :] + movement)

    def warmer(self, before: ca.MX, movement: ca.MX, size: ca.MX, rise: ca.MX, gain: ca.MX) -> ca.MX:
        """(m, K) rises one period later; `gain` (1, K) resistance at the unpowered temperature."""
        assert self.heat is not None
        square = self.heat.mean_square(self.current(before), before[-1, :] + movement, size)
        return self.heat.M @ rise + self.heat.b @ ((gain + self.heat.copper * rise[0, :]) * square)


@lru_cache(maxsize=16)
def state_program(shape: Shape) -> Program:
    """State the problem for one shape; all numbers are parameters."""
    N, n, m, h, where = shape.stages, shape.layout.states, shape.nodes, shape.hand_over_samples, shape.layout
    variables = ca.MX.sym("stages", shape.variables, N)
    first = ca.MX.sym("start", shape.first)
    movement, after = variables[0, :], variables[shape.controls : shape.controls + n, :]
    rise = variables[shape.controls + n :, :]
    stage = Stage.make(shape)
    reference, weights = ca.MX.sym("r", 1, N), ca.MX.sym("w", 1, N)
    movement_weight = ca.MX.sym("rho")
    symbols = {**stage.symbols, "r": reference, "w": weights, "rho": movement_weight}

    before = ca.horzcat(ca.MX(n, 1), after[:, :-1])
    error = stage.outputs(before, movement) - ca.repmat(reference, where.devices, 1)
    tracking = sum(ca.dot(weights, error[s, :] ** 2) for s in range(where.devices)) / where.devices
    objective = tracking + movement_weight * ca.dot(movement, movement)

    rows = {"dynamics": ca.vec(after - stage.after(before, movement))}
    if stage.heat is not None:
        warm = ca.horzcat(first if shape.repeated else ca.MX(m, 1), rise[:, :-1])
        size = variables[1, :]
        # A step's own rise is tiny beside the headroom of taps that repeat: the row is weighed to be met as exactly.
        weight = REPEATED_WEIGHT if shape.repeated else 1.0
        warmer = stage.warmer(before, movement, size, warm, stage.heat.gain)
        rows["heat"] = ca.vec(weight * (rise - warmer))
        # size >= |mean i|: the kink of Eq. 7 as two rows, on which Newton does not stumble.
        mean = stage.mean_current(before, movement)
        rows["size_above"] = ca.vec(size - mean)
        rows["size_below"] = ca.vec(size + mean)
        if shape.repeated:
            rows["pause"] = weight * (first - stage.heat.F @ rise[:, -1] - stage.heat.f)
    if where.feedback_delay is None:
        rows["hand_over"] = ca.vec(after[-1, N - h :])
    else:
        mask = np.repeat(feedback_mask(where), h, axis=0).T
        symbols["T"], T = _sparse_symbol("T", mask)
        asked = before[-1, N - h :] + movement[N - h :] - ca.sum1(T * before[:, N - h :])
        rows["hand_over"] = ca.vec(asked)
    if shape.supply:
        rows["supply_before"] = ca.vec(stage.voltage_before(after[:, :-1]))
        rows["supply_after"] = ca.vec(stage.voltage_after(before, movement))

    ends = np.cumsum([0, *(kind.numel() for kind in rows.values())])
    x = ca.veccat(first, variables)
    f = objective / OBJECTIVE_SCALE
    g = ca.vertcat(*rows.values())
    p = ca.veccat(*symbols.values())
    qp_data = None
    if not m:
        hessian, gradient = ca.hessian(f, x)
        at_zero = ca.substitute(gradient, x, ca.DM.zeros(x.numel()))
        qp_data = ca.Function("qp_data", [p], [hessian, at_zero, ca.jacobian(g, x)], ["p"], ["H", "q", "A"])
    rows_of = {name: slice(int(ends[j]), int(ends[j + 1])) for j, name in enumerate(rows)}
    return Program(shape, x, p, tuple(symbols), f, g, rows_of, qp_data is None, qp_data)


def stage_shape(shape: Shape) -> Shape:
    """What of a shape one stage depends on."""
    return replace(shape, stages=1, hand_over_samples=1)


@lru_cache(maxsize=16)
def stage_data(shape: Shape) -> ca.Function:
    """The same statement for a method that takes it stage by stage: matrices of one stage from its parameters.

    Function of those symbols that they depend on (of a `stage_shape`) to the dense derivatives of the states one
    period later by x (n, n), of the outputs by x (S, n) and dc (S,), and of voltage before and after a switching
    instant and mean current by x (3, n) and dc (3,), zero where there is none.
    """
    stage = Stage.make(shape)
    x, movement = ca.MX.sym("x", shape.layout.states), ca.MX.sym("dc")
    outputs = stage.outputs(x, movement)
    rows = [
        stage.voltage_before(x) if shape.supply else ca.MX(1, 1),
        stage.voltage_after(x, movement) if shape.supply else ca.MX(1, 1),
        stage.mean_current(x, movement) if shape.nodes else ca.MX(1, 1),
    ]
    limits = ca.vertcat(*rows)
    found = [ca.jacobian(stage.after(x, movement), x), ca.jacobian(outputs, x), ca.jacobian(outputs, movement)]
    found += [ca.jacobian(limits, x), ca.jacobian(limits, movement)]
    dense = [ca.densify(each) for each in found]
    names = [
        "A",
        "B",
        "C",
        "E",
        *(["S", "S_direct"] if shape.supply else []),
        *(["share", "decay"] if shape.nodes else []),
    ]
    results = ["states", "outputs", "outputs_movement", "limits", "limits_movement"]
    return ca.Function("stage_data", [stage.symbols[name] for name in names], dense, names, results)


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
