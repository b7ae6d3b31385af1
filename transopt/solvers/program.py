"""The optimal-control problem as one sparse program in CasADi.

PIQP, IPOPT and the sparse KKT system read their data from this statement. The project's own method uses `stage_data`
instead, computed from the same linear stage and the same rows of limits.

Variables are stage-wise [dc_k, e_k, x_(k+1), th_(k+1)], k = 0..N-1: the movement of each command and the scaled
states of `linear_stage`; with a temperature limit also the magnitude e_k of the mean current and the temperature
rises of the thermal nodes. x_0 = 0 is not a variable; th_0 is one, placed first, where taps repeat. Current, command
and movement are single variables, so that their limits are boxes. No states are eliminated.
"""

from dataclasses import dataclass, fields
from functools import lru_cache

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from transopt.base.signals import FloatArray
from transopt.problem.answer import OBJECTIVE_SCALE
from transopt.problem.heat import mean_current, mean_square, next_rise
from transopt.problem.stage import Layout
from transopt.solvers.shape import Shape

REPEATED_WEIGHT = 1e3


@dataclass(frozen=True)
class Program:
    """The statement as CasADi expressions and the functions that solvers and certificates read.

    Attributes
    ----------
    x : MX (variables, 1), stage by stage. p : MX, all parameters.
    parameters : names of the parameters in the order of p.
    f : MX, J in units of `OBJECTIVE_SCALE`. g : MX, constraint rows, grouped by kind.
    rows : kind -> slice of g: "dynamics", "heat", "size_above", "size_below", "pause", "hand_over", and the name of
        every row of `shape.rows`.
    qp_data : Function p -> (H sparse, q, A sparse) of 1/2 x'Hx + q'x, lb <= A x <= ub; undefined for a problem with
        the temperature.
    """

    shape: Shape
    x: ca.MX
    p: ca.MX
    parameters: tuple[str, ...]
    f: ca.MX
    g: ca.MX
    rows: dict[str, slice]
    _qp_data: ca.Function | None

    @property
    def qp_data(self) -> ca.Function:
        assert self._qp_data is not None
        return self._qp_data


def _sparse_symbol(name: str, mask: NDArray[np.bool_]) -> tuple[ca.MX, ca.MX]:
    """A symbol for the nonzeros, column by column, and the sparse matrix made of them."""
    rows, columns = np.nonzero(mask.T)[::-1]
    sparsity = ca.Sparsity.triplet(mask.shape[0], mask.shape[1], rows.tolist(), columns.tolist())
    nonzeros = ca.MX.sym(name, int(mask.sum()))
    return nonzeros, ca.MX(sparsity, nonzeros)


def nonzeros(matrix: FloatArray, mask: NDArray[np.bool_]) -> FloatArray:
    """Entries of a matrix under a mask, column by column: the values of `_sparse_symbol`'s nonzeros."""
    return np.asarray(matrix.T[mask.T])


def feedback_mask(where: Layout) -> NDArray[np.bool_]:
    """(1, n) mask of the states that determine the hand-over's command."""
    mask = np.zeros((1, where.states), dtype=bool)
    mask[0, where.wall] = True
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
        found: ca.MX = mean_current(self.share, self.decay, current, command)
        return found

    def mean_square(self, current: ca.MX, command: ca.MX, size: ca.MX) -> ca.MX:
        """Mean of i_eff^2 over a period; `heat.Heating.mean_square` with |mean i| as a separate variable `size`."""
        found: ca.MX = mean_square(self.square, self.decay, self.ripple, current, command, size)
        return found


@dataclass(frozen=True)
class Stage:
    """One stage of the program as expressions, for states (n, K) and movements (m, K) at K stages side by side.

    Attributes
    ----------
    A, B, C, E : MX, the matrices of `problem.stage.LinearStage`.
    rows : name of a limit's row -> MX derivatives of its value by x and by one movement, and that movement's index.
    heat : parameters of the temperature recursion; None without temperature.
    symbols : name -> symbol, in the order of the values in `statement`.
    """

    layout: Layout
    A: ca.MX
    B: ca.MX
    C: ca.MX
    E: ca.MX
    rows: dict[str, tuple[ca.MX, ca.MX, int]]
    heat: HeatSymbols | None
    symbols: dict[str, ca.MX]

    @classmethod
    def make(cls, shape: Shape) -> "Stage":
        where = shape.layout
        A_values, A = _sparse_symbol("A", where.dynamics_mask())
        C_values, C = _sparse_symbol("C", where.output_mask())
        # The column B of a single motor is dense; with several motors each column has its own sparsity.
        B_values = B = ca.MX.sym("B", where.states)
        if where.motors > 1:
            B_values, B = _sparse_symbol("B", where.dynamics_mask()[:, -where.motors :])
        E = ca.MX.sym("E", where.outputs, where.motors)
        symbols = {"A": A_values, "B": B_values, "C": C_values, "E": E}
        heat = HeatSymbols.make(shape) if shape.nodes else None
        if heat is not None:
            symbols |= {field.name: getattr(heat, field.name) for field in fields(HeatSymbols)}
        rows = {}
        for row in shape.rows:
            values, G = _sparse_symbol(f"G_{row.name}", row.mask)
            d = ca.MX.sym(f"d_{row.name}")
            symbols |= {f"G_{row.name}": values, f"d_{row.name}": d}
            rows[row.name] = (G, d, row.motor)
        return cls(where, A, B, C, E, rows, heat, symbols)

    def after(self, before: ca.MX, movement: ca.MX) -> ca.MX:
        """(n, K) states one period later."""
        return self.A @ before + self.B @ movement

    def outputs(self, before: ca.MX, movement: ca.MX) -> ca.MX:
        """(S, K) tracked outputs."""
        found = self.C @ before
        return found if self.layout.amplifier else found + self.E @ movement

    def value(self, row: str, before: ca.MX, movement: ca.MX) -> ca.MX:
        """(1, K) value of a limit's row, divided by the stated limit and without its offset."""
        G, d, motor = self.rows[row]
        return G @ before + d * movement[motor, :]

    def current(self, before: ca.MX) -> ca.MX:
        """(1, K) current; zero for an ideal amplifier, whose current is the command."""
        return before[self.layout.current, :] if self.layout.amplifier else ca.MX(1, before.size2())

    def mean_current(self, before: ca.MX, movement: ca.MX) -> ca.MX:
        assert self.heat is not None
        return self.heat.mean_current(self.current(before), before[-1, :] + movement)

    def warmer(self, before: ca.MX, movement: ca.MX, size: ca.MX, rise: ca.MX, gain: ca.MX) -> ca.MX:
        """(m, K) temperature rises one period later; `gain` is the (1, K) resistance at the unpowered temperature."""
        assert self.heat is not None
        square = self.heat.mean_square(self.current(before), before[-1, :] + movement, size)
        heat = self.heat
        found: ca.MX = next_rise(heat.M, heat.b, gain, heat.copper, rise, rise[0, :], square)
        return found


@lru_cache(maxsize=16)
def state_program(shape: Shape) -> Program:
    """State the program of one shape; all numbers are parameters."""
    N, n, m, h, where = shape.stages, shape.layout.states, shape.nodes, shape.hand_over_samples, shape.layout
    variables = ca.MX.sym("stages", shape.variables, N)
    first = ca.MX.sym("start", shape.first)
    movement, after = variables[: where.motors, :], variables[shape.controls : shape.controls + n, :]
    rise = variables[shape.controls + n :, :]
    stage = Stage.make(shape)
    reference, weights = (ca.MX.sym(name, N, where.outputs) for name in "rw")
    movement_weight = ca.MX.sym("rho")
    end_gain, end_target = ca.MX.sym("end_gain", shape.ends, n), ca.MX.sym("end_target", shape.ends)
    constant = ca.MX.sym("constant")
    symbols = {
        **stage.symbols,
        "r": reference,
        "w": weights,
        "rho": movement_weight,
        "end_gain": end_gain,
        "end_target": end_target,
        "constant": constant,
    }

    before = ca.horzcat(ca.MX(n, 1), after[:, :-1])
    error = stage.outputs(before, movement) - reference.T
    objective = ca.dot(weights.T, error**2) + movement_weight * ca.dot(movement, movement) + constant
    if shape.ends:
        objective += ca.sumsqr(end_gain @ after[:, -1] - end_target)

    rows = {"dynamics": ca.vec(after - stage.after(before, movement))}
    if stage.heat is not None:
        warm = ca.horzcat(first if shape.repeated else ca.MX(m, 1), rise[:, :-1])
        size = variables[1, :]
        # The rise of one step is tiny beside the headroom of taps that repeat: without a weight the row's residual
        # would be too coarse.
        weight = REPEATED_WEIGHT if shape.repeated else 1.0
        warmer = stage.warmer(before, movement, size, warm, stage.heat.gain)
        rows["heat"] = ca.vec(weight * (rise - warmer))
        # size >= |mean i|: the kink of Eq. 7 as two smooth rows, which Newton's method can handle.
        mean = stage.mean_current(before, movement)
        rows["size_above"] = ca.vec(size - mean)
        rows["size_below"] = ca.vec(size + mean)
        if shape.repeated:
            rows["pause"] = weight * (first - stage.heat.F @ rise[:, -1] - stage.heat.f)
    if where.feedback_delay is None:
        rows["hand_over"] = ca.vec(after[-where.motors :, N - h :].T)
    else:
        mask = np.repeat(feedback_mask(where), h, axis=0).T
        symbols["T"], T = _sparse_symbol("T", mask)
        asked = before[-1, N - h :] + movement[N - h :] - ca.sum1(T * before[:, N - h :])
        rows["hand_over"] = ca.vec(asked)
    for row in shape.rows:
        rows[row.name] = ca.vec(stage.value(row.name, before[:, row.first :], movement[:, row.first :]))
    for law in shape.laws:
        outputs = law.outputs
        G, d = ca.MX.sym(f"G_{law.name}", outputs, n), ca.MX.sym(f"d_{law.name}", outputs)
        nominal, unit = ca.MX.sym(f"nominal_{law.name}", outputs, N), ca.MX.sym(f"unit_{law.name}")
        symbols |= {f"G_{law.name}": G, f"d_{law.name}": d, f"nominal_{law.name}": nominal, f"unit_{law.name}": unit}
        function = ca.Function.deserialize(law.text).map(N)
        value = function(G @ before + d @ movement + nominal, ca.DM(np.arange(N)[None]))
        rows[law.name] = ca.vec(value) / unit

    ends = np.cumsum([0, *(kind.numel() for kind in rows.values())])
    x = ca.veccat(first, variables)
    f = objective / OBJECTIVE_SCALE
    g = ca.vertcat(*rows.values())
    p = ca.veccat(*symbols.values())
    qp_data = None
    if not m and not shape.laws:
        hessian, gradient = ca.hessian(f, x)
        at_zero = ca.substitute(gradient, x, ca.DM.zeros(x.numel()))
        qp_data = ca.Function("qp_data", [p], [hessian, at_zero, ca.jacobian(g, x)], ["p"], ["H", "q", "A"])
    rows_of = {name: slice(int(ends[j]), int(ends[j + 1])) for j, name in enumerate(rows)}
    return Program(shape, x, p, tuple(symbols), f, g, rows_of, qp_data)
