"""Rows of all limits as solvers take them: in the linear stage's states, in units that make them of order one."""

from dataclasses import dataclass

import numpy as np

from transopt.base.signals import FloatArray
from transopt.problem.heat import mean_current
from transopt.problem.limits.row import COMMAND, HELD, INPUT
from transopt.problem.problem import TransientProblem
from transopt.problem.stage import LinearStage

SIZE_BOUND = 2.0  # bound of the mean current's magnitude, relative to the limit current
WINDING = "winding"  # name of the row that limits the thermal recursion's first state


def kelvin(problem: TransientProblem) -> float:
    """Unit of the temperature rises [K]: the largest headroom; 0 without a temperature limit."""
    if problem.thermal is None:
        return 0.0
    headroom = problem.thermal.model.headroom_K
    return max(float(headroom[np.isfinite(headroom)].max()), 1e-9)


@dataclass(frozen=True)
class StatedRow:
    """A limit's row as input of the solvers: value and bounds divided by `unit`, the stated limit.

    Attributes
    ----------
    G, d : (n,), scalar; derivatives of the value by x_k and by dc_k, with several motors by that of `motor`.
    motor : index of the motor, from 0.
    asked : (2, N) lower and upper bounds less the offset.
    lower, upper : (N,) these bounds, but infinite where the value is fixed before any decision.
    single : the single variable that the row bounds, "current", "command" or "movement"; empty for a sum of several.
    """

    name: str
    unit: float
    G: FloatArray
    d: float
    motor: int
    asked: FloatArray
    lower: FloatArray
    upper: FloatArray
    single: str


SINGLE = {(INPUT,): INPUT, (COMMAND,): COMMAND, (COMMAND, HELD): "movement"}


def stated_rows(problem: TransientProblem, stage: LinearStage) -> list[StatedRow]:
    """All rows of all limits, each divided by its stated limit."""
    N, ideal, found = problem.grid.stages, problem.stage.amplifier is None, list[StatedRow]()
    for limit, row in problem.rows():
        if not row.linear:
            continue
        G, d = stage.row(row)
        asked = (np.stack(row.bounds(N)) - row.offset) / limit.stated
        lower, upper = asked.copy()
        # Fixed values: at tau_0 the device is at rest; commands of a hand-over without a wall are zero. Bounds that
        # exclude this zero stay, so that infeasibility is proven.
        decided, end = [slice(1 if row.waits(ideal=ideal) else 0)], slice(problem.free_stages, N)
        if (
            problem.wall is None
            and tuple(row.outputs) == (COMMAND,)
            and np.all(lower[end] <= 0)
            and np.all(upper[end] >= 0)
        ):
            decided.append(end)
        for at in decided:
            lower[at], upper[at] = -np.inf, np.inf
        single = SINGLE.get(tuple(row.outputs), "")
        if (single == "movement" and row.outputs[HELD] != -row.outputs[COMMAND]) or (single == INPUT and ideal):
            single = ""
        # A variable has one box, and so one multiplier on each side.
        by, motor = limit.stated, row.motor or 0
        single = "" if any((other.single, other.motor) == (single, motor) for other in found) else single
        found.append(StatedRow(row.name, by, G / by, d / by, motor, asked, lower, upper, single))
    return found


@dataclass(frozen=True)
class Rows:
    """Limits as rows lower_k <= G x_k + d dc_k + d_size e_k <= upper_k, k = 0..N.

    Attributes
    ----------
    kinds : names of the rows; the winding's row is the first if there is one.
    G : (rows, n). d : (rows, m). d_size : (rows,). lower, upper : (N + 1, rows), infinite where there is no limit.
    asked : (2, N, rows) bounds for certification, stated also at instants at which the value is fixed; only for
        problems without temperature.
    unit : (rows,) divisor of a row: its largest bound in units of the program, so that limits are of order one.
    """

    kinds: tuple[str, ...]
    G: FloatArray
    d: FloatArray
    d_size: FloatArray
    lower: FloatArray
    upper: FloatArray
    asked: FloatArray
    unit: FloatArray


def rows_of(problem: TransientProblem, stage: LinearStage) -> Rows:
    """All rows of the stage data, those of the temperature included."""
    N, thermal = problem.grid.stages, problem.thermal
    none, every = np.zeros(stage.units.size), slice(N)
    kinds: list[str] = []
    values: list[tuple[FloatArray, float, float, int]] = []  # G, d, d_size and the motor of d
    sides: list[tuple[FloatArray | float, FloatArray | float, slice]] = []  # lower and upper bound at some stages
    if thermal is not None:
        kinds.append(WINDING)
        values.append((none, 0.0, 0.0, 0))
        sides.append((-np.inf, thermal.model.headroom_K / kelvin(problem), slice(1, N + 1)))
    every_row = stated_rows(problem, stage)
    for stated in every_row:
        kinds.append(stated.name)
        values.append((stated.G, stated.d, 0.0, stated.motor))
        sides.append((stated.lower, stated.upper, every))
    if thermal is not None:
        # size >= |mean i|: the kink of Eq. 7 as two smooth rows, which Newton's method can handle.
        # The unit is the input scale, as for the named outputs.
        heating, flows, asked = thermal.model.heating, stage.outputs[0][INPUT], stage.outputs[0][COMMAND]
        G, d = (mean_current(heating.share, heating.decay, i, c) for i, c in zip(flows, asked, strict=True))
        size = SIZE_BOUND * problem.limits.input_limit / stage.input_scale
        kinds += ["size_above", "size_below", "size"]
        values += [(-G, -float(d), 1.0, 0), (G, float(d), 1.0, 0), (none, 0.0, 1.0, 0)]
        sides += [(0.0, np.inf, every), (0.0, np.inf, every), (-size, size, every)]

    G, d, d_size = (np.array([row[j] for row in values]) for j in range(3))
    d = d[:, None] * (np.arange(stage.motors) == [[row[3]] for row in values])
    bounds = np.empty((2, len(kinds), N + 1))
    bounds[0], bounds[1] = -np.inf, np.inf
    for j, (lower, upper, stages) in enumerate(sides):
        bounds[0, j, stages], bounds[1, j, stages] = lower, upper
    if thermal is not None and thermal.model.closure is not None:
        # Taps that repeat never cool below the surroundings: colder fixed points are those of a runaway.
        bounds[0, 0, 0] = 0.0
    unit = np.abs(np.where(np.isfinite(bounds), bounds, 0.0)).max(axis=(0, 2))
    # The winding's row is a thermal state, already in units of the largest headroom.
    unit = np.where((unit > 0) & (np.array(kinds) != WINDING), unit, 1.0)
    whole = np.zeros((2, N, 0))
    if thermal is None:
        whole = np.ascontiguousarray(np.stack([stated.asked for stated in every_row], axis=-1) / unit)
    by = unit[:, None]
    lower, upper = np.ascontiguousarray(np.swapaxes(bounds / by, 1, 2))
    return Rows(tuple(kinds), G / by, d / by, d_size / unit, lower, upper, whole, unit)
