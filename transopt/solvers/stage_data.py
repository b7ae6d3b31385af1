"""One problem's numbers stage by stage, as the project's own method takes them (`solvers/native/riccati.c`).

They come from the linear stage and from the rows of the limits, as those of the CasADi program do
(`solvers.program`), and need no CasADi: the runtime solves a tap with them.
"""

from dataclasses import dataclass

import numpy as np

from transopt.base.signals import FloatArray
from transopt.problem.answer import OBJECTIVE_SCALE, Multipliers
from transopt.problem.heat import mean_current
from transopt.problem.limits import hand_over
from transopt.problem.limits.limit import COMMAND, HELD, INPUT
from transopt.problem.limits.temperature import TemperatureLimit
from transopt.problem.objective.tail import tail
from transopt.problem.problem import TransientProblem
from transopt.problem.stage import LinearStage, layout, linear_stage

SIZE_BOUND = 2.0  # of the limit current
# Condition of the modes up to which the method works in them. The built-in scenes have up to 330, a wall's delay line
# has no modes; whatever rounding does is seen by the certificate, which knows of none.
MOST_CONDITION = 1e4
WINDING = "winding"  # row of the recursion's first state


def kelvin(problem: TransientProblem) -> float:
    """Unit of the rises: the largest headroom; 0 without temperature."""
    if problem.thermal is None:
        return 0.0
    headroom = problem.thermal.model.headroom_K
    return max(float(headroom[np.isfinite(headroom)].max()), 1e-9)


def tracking_values(problem: TransientProblem, stage: LinearStage) -> dict[str, FloatArray]:
    """What the statement says of the objective: the tracked outputs in units of sqrt(E), the input in its own.

    What each output is led to and its weight (N, outputs) within the window, the movement's weight (1,), what is led
    from x_N where to after it (`objective.tail`), and the constant (1,) beside all this.
    """
    term, after = problem.tracking, tail(problem, stage)
    S = len(problem.devices)
    # One column a device and term, the terms of one device side by side.
    wanted = np.tile(term.solved_wanted.T, (1, S))
    weights = np.ascontiguousarray(np.hstack([share * term.solved_weights.T for share in problem.shared]))
    if problem.heat_price > 0:
        price = problem.heat_price * stage.input_scale**2
        wanted, weights = (
            np.pad(a, ((0, 0), (0, 1)), constant_values=v) for a, v in ((wanted, 0.0), (weights, price))
        )
    return {
        "r": wanted,
        "w": weights,
        "rho": np.array([problem.movement.weight * stage.input_scale**2]),
        "end_gain": after.gain,
        "end_target": after.target,
        "constant": np.array([term.constant + after.rest]),
    }


def heat_values(problem: TransientProblem, input_scale: float) -> dict[str, FloatArray]:
    """Numbers of the temperature recursion, in units of `input_scale` and `kelvin`, matrices as they are written."""
    assert problem.thermal is not None
    model, unit = problem.thermal.model, kelvin(problem)
    F, f = (np.zeros_like(model.M), np.zeros_like(model.b)) if model.closure is None else model.closure
    return {
        "M": model.M,
        "b": model.b * input_scale**2 / unit,
        "gain": model.gain,
        "copper": np.array([model.copper * unit]),
        "square": model.heating.square,
        "share": np.array([model.heating.share]),
        "decay": np.array([model.heating.decay]),
        "ripple": np.array([model.heating.ripple_A / input_scale]),
        "F": F,
        "f": f / unit,
    }


def held(problem: TransientProblem, command: FloatArray) -> FloatArray:
    """(N,) commands moved by rounding only: into the box, zero at a plain hand-over."""
    c = np.clip(command, -problem.command_bound, problem.command_bound)
    if problem.wall is None:
        c[problem.free_stages :] = 0.0
    return np.asarray(c)


@dataclass(frozen=True)
class StatedRow:
    """A limit's row as the methods take it: divided by `unit`, what its limit states.

    Attributes
    ----------
    G, d : (n,), scalar of the value by x_k and by dc_k.
    lower, upper : (N,) less the offset, infinite where the row asks for nothing that is not decided already.
    single : the variable that the row alone bounds, "current", "command" or "movement"; empty for a sum of several.
    """

    name: str
    unit: float
    G: FloatArray
    d: float
    lower: FloatArray
    upper: FloatArray
    single: str


SINGLE = {(INPUT,): INPUT, (COMMAND,): COMMAND, (COMMAND, HELD): "movement"}


def stated_rows(problem: TransientProblem, stage: LinearStage) -> list[StatedRow]:
    """Every row of every limit, in units of what its limit states."""
    N, found = problem.grid.stages, list[StatedRow]()
    for limit, row in problem.rows():
        if not row.linear:
            continue
        G, d = stage.row(row)
        lower, upper = np.full(N, -np.inf), np.full(N, np.inf)
        # At tau_0 the device rests and nothing is held. A plain hand-over's commands are zero.
        first = 1 if row.waits else 0
        last = problem.free_stages if problem.wall is None and tuple(row.outputs) == (COMMAND,) else N
        at = slice(first, last)
        for asked, bound in zip((lower, upper), row.bounds(N), strict=True):
            asked[at] = ((bound - row.offset) / limit.stated)[at]
        single = SINGLE.get(tuple(row.outputs), "")
        if single == "movement" and row.outputs[HELD] != -row.outputs[COMMAND]:
            single = ""
        # One variable has one box, and so one multiplier on either side.
        single = "" if any(other.single == single for other in found) else single
        found.append(StatedRow(row.name, limit.stated, G / limit.stated, d / limit.stated, lower, upper, single))
    return found


@dataclass(frozen=True)
class Rows:
    """Limits as rows lower_k <= G x_k + d dc_k + d_size e_k <= upper_k, k = 0..N.

    Attributes
    ----------
    kinds : their names, the winding's first where there is one.
    G : (rows, n). d, d_size : (rows,). lower, upper : (N + 1, rows), infinite where there is no limit.
    unit : (rows,) of a row, in units of the program: the largest of its bounds, so that limits are of order one.
    """

    kinds: tuple[str, ...]
    G: FloatArray
    d: FloatArray
    d_size: FloatArray
    lower: FloatArray
    upper: FloatArray
    unit: FloatArray


def _rows(problem: TransientProblem, stage: LinearStage) -> Rows:
    N, thermal = problem.grid.stages, problem.thermal
    none, every = np.zeros(stage.units.size), slice(N)
    kinds: list[str] = []
    found: list[tuple[FloatArray, float, float, FloatArray, FloatArray]] = []

    def row(
        kind: str,
        G: FloatArray,
        d: float,
        d_size: float,
        lower: FloatArray | float,
        upper: FloatArray | float,
        stages: slice,
    ) -> None:
        """One row with limits at some stages."""
        bounds = np.array([np.full(N + 1, -np.inf), np.full(N + 1, np.inf)])
        bounds[0, stages], bounds[1, stages] = lower, upper
        kinds.append(kind)
        found.append((G, d, d_size, bounds[0], bounds[1]))

    if thermal is not None:
        row(WINDING, none, 0.0, 0.0, -np.inf, thermal.model.headroom_K / kelvin(problem), slice(1, N + 1))
        if thermal.model.closure is not None:
            # Taps that repeat never cool below the surroundings: colder fixed points are those of a runaway.
            found[-1][3][0] = 0.0
    for stated in stated_rows(problem, stage):
        row(stated.name, stated.G, stated.d, 0.0, stated.lower, stated.upper, every)
    if thermal is not None:
        # size >= |mean i|: the kink of Eq. 7 as two rows, on which Newton does not stumble.
        # In units of the input scale, as the named outputs are.
        heating, flows, asked = thermal.model.heating, stage.outputs[0][INPUT], stage.outputs[0][COMMAND]
        G, d = (mean_current(heating.share, heating.decay, i, c) for i, c in zip(flows, asked, strict=True))
        for kind, sign in {"size_above": -1.0, "size_below": 1.0}.items():
            row(kind, sign * G, float(sign * d), 1.0, 0.0, np.inf, every)
        size = SIZE_BOUND * problem.limits.input_limit / stage.input_scale
        row("size", none, 0.0, 1.0, -size, size, every)

    G, d, d_size, lower, upper = (np.array(each) for each in zip(*found, strict=True))
    bounds = np.concatenate([lower, upper], axis=1)
    unit = np.abs(np.where(np.isfinite(bounds), bounds, 0.0)).max(axis=1)
    # The winding's row is a state of the recursion, whose unit is the largest headroom already.
    unit = np.where((unit > 0) & (np.array(kinds) != WINDING), unit, 1.0)
    by = unit[:, None]
    return Rows(tuple(kinds), G / by, d / unit, d_size / unit, (lower / by).T, (upper / by).T, unit)


def _no_rows(n: int) -> Rows:
    none = np.zeros(0)
    return Rows((), np.zeros((0, n)), none, none, np.zeros((0, 0)), np.zeros((0, 0)), none)


@dataclass(frozen=True)
class Stages:
    """One problem as the method takes it, in the statement's units.

    Attributes
    ----------
    input_scale, kelvin : units of commands and of rises.
    sizes, numbers, arrays : integers, scalars and arrays of `tr_problem`, by name; the arrays contiguous.
    """

    problem: TransientProblem
    input_scale: float
    kelvin: float
    limits: Rows
    sizes: dict[str, int]
    numbers: dict[str, float]
    arrays: dict[str, FloatArray]

    def command(self, scaled: FloatArray) -> FloatArray:
        """(N,) commands [A] of those in scaled units (N,), as `held`."""
        return held(self.problem, scaled * self.input_scale)

    def multipliers(self, by_row: FloatArray, gradient: FloatArray) -> Multipliers:
        """Multipliers of J in SI from upper less lower ones (N + 1, rows) and the gradient (N,) by the movements."""
        problem, N = self.problem, self.sizes["stages"]
        scaled = dict(zip(self.limits.kinds, (by_row / self.limits.unit).T, strict=True))
        pairs, slope = {}, np.zeros(N)
        for limit, row in problem.rows():
            if not row.linear:
                continue
            mu = scaled[row.name][:N] * (OBJECTIVE_SCALE / limit.stated)
            pairs[row.name] = (-mu, mu)
        if problem.thermal is not None:
            slope = slope_of(-scaled["size_above"][:N], -scaled["size_below"][:N])
            mu = scaled[WINDING][1:] * (OBJECTIVE_SCALE / self.kelvin)
            pairs[problem.thermal.row_names[0]] = (np.zeros(N), mu)
        tail = -gradient[problem.free_stages :] * (OBJECTIVE_SCALE / self.input_scale)
        return Multipliers(N, pairs, tail, slope).clipped()


@dataclass(frozen=True)
class _Modes:
    """States as sums of modes, x = T z, for all problems of one linear stage.

    Attributes
    ----------
    of : A of the linear stage, by which it is known again.
    T : (n, n); the identity where modes are ill conditioned.
    A : (n, n) of z: complex modes in pairs, then the real ones, each driven by the held command, the last state.
    current : which of them is the current; -1 without an amplifier.
    """

    of: FloatArray
    T: FloatArray
    A: FloatArray
    current: int


def _modes(problem: TransientProblem, stage: LinearStage) -> _Modes:
    """The modes of a linear stage, kept with the device for the next problem."""
    derived = problem.stage.derived
    found = derived.get(_Modes)
    if not (isinstance(found, _Modes) and found.of is stage.A):
        where = layout(problem)
        found = derived[_Modes] = _modes_of(stage.A, where.current if where.amplifier else -1)
    return found


def _modes_of(A: FloatArray, current: int) -> _Modes:
    n, dense = A.shape[0], _Modes(A, np.eye(A.shape[0]), A, current)
    values, vectors = np.linalg.eig(A[:-1, :-1])
    columns, pattern = list[FloatArray](), np.eye(n, dtype=bool)
    pattern[:, -1] = True
    for vector in vectors.T[values.imag > 0]:
        # Real and imaginary part stand at right angles in one of the phases that a complex vector may have.
        turned = vector * np.exp(-0.5j * np.angle(np.sum(vector**2)))
        at = len(columns)
        pattern[at : at + 2, at : at + 2] = True
        columns += [turned.real, turned.imag]
    columns += list(vectors.T[values.imag == 0].real)
    T = np.eye(n)
    T[:-1, :-1] = np.array(columns).T
    T /= np.maximum(np.linalg.norm(T, axis=0), np.finfo(float).tiny)
    if current >= 0:
        # Nothing but the command acts on the current, which is one of the modes, and keeps its unit.
        own = int(np.abs(T[current]).argmax())
        T[:, own] /= T[current, own] or 1.0
        T[current] = np.arange(n) == own
    if not np.linalg.cond(T) <= MOST_CONDITION:
        return dense
    return _Modes(A, T, np.where(pattern, np.linalg.solve(T, A @ T), 0.0), own if current >= 0 else -1)


def slope_of(above: FloatArray, below: FloatArray) -> FloatArray:
    """(N,) slope of |mean i| by the multipliers (N,) of size >= mean i and of size >= -mean i.

    The two share what the size is worth; where it is worth nothing any sign will do.
    """
    above, below = np.maximum(above, 0.0), np.maximum(below, 0.0)
    return np.asarray((above - below) / np.maximum(above + below, np.finfo(float).tiny))


def stages(problem: TransientProblem, *, limited: bool = True) -> Stages:
    """Stage data of a problem; not `limited`, without any row."""
    stage, where = linear_stage(problem), layout(problem)
    m = 0 if problem.thermal is None else problem.thermal.model.nodes
    values = tracking_values(problem, stage)
    limits = _rows(problem, stage) if limited else _no_rows(where.states)
    gains, offsets = hand_over.rows(problem, stage)
    gains[:, -1] -= 1.0  # c_k = rows x_k + constant, so dc_k = that less c_(k-1)
    nothing = np.zeros(4)
    heat = (
        dict.fromkeys(("M", "b", "gain", "square", "F", "f"), nothing)
        if m == 0
        else heat_values(problem, stage.input_scale)
    )
    modes = _modes(problem, stage)
    arrays = {
        "A": modes.A,
        "C": stage.C @ modes.T,
        "E": np.zeros_like(stage.E) if where.amplifier else stage.E,
        "weight": values["w"] * (2 / OBJECTIVE_SCALE),
        "reference": values["r"],
        "rule_gain": gains @ modes.T,
        "rule_offset": offsets,
        "end_gain": values["end_gain"] @ modes.T * np.sqrt(2 / OBJECTIVE_SCALE),
        "end_target": values["end_target"] * np.sqrt(2 / OBJECTIVE_SCALE),
        "G": limits.G @ modes.T,
        **{name: getattr(limits, name) for name in ("d", "d_size", "lower", "upper")},
        **{name: heat[name] for name in ("M", "b", "gain", "square", "F", "f")},
    }
    return Stages(
        problem=problem,
        input_scale=stage.input_scale,
        kelvin=kelvin(problem),
        limits=limits,
        sizes={
            "stages": problem.grid.stages,
            "free_stages": problem.free_stages,
            "states": where.states,
            "outputs": where.outputs,
            "ends": values["end_target"].size,
            "rows": limits.d.size,
            "nodes": m,
            "current": modes.current,
            "repeated": int(m > 0 and problem.thermal is not None and problem.thermal.model.closure is not None),
        },
        numbers={
            "movement_weight": 2 * float(values["rho"][0]) / OBJECTIVE_SCALE,
            "command_bound": problem.command_bound / stage.input_scale,
            "constant": float(values["constant"][0]) / OBJECTIVE_SCALE,
            **{name: float(heat[name][0]) if m else 0.0 for name in ("decay", "ripple", "copper")},
        },
        arrays={name: np.ascontiguousarray(array, dtype=float) for name, array in arrays.items()},
    )


def without_limits(problem: TransientProblem) -> Stages:
    """Stage data of the same problem without rows and temperature: what a linear pass takes."""
    return stages(problem.without(TemperatureLimit.name), limited=False)
