"""The project's own method: an interior point over the stages, in C (`riccati.c`), on the statement's stage data.

The extension is optional. Where it could not be built, `available` is False and the CasADi methods take over.
"""

import ctypes as ct
import time
from dataclasses import dataclass
from importlib.util import find_spec

import numpy as np

from transopt.farkas import is_infeasible
from transopt.linear import hand_over_rows
from transopt.problem import OBJECTIVE_SCALE, Solution, Status, TransientProblem
from transopt.signals import FloatArray
from transopt.solvers.options import EXTENSION, SolverOptions
from transopt.statement import Statement, state
from transopt.transcribe import program_shape, stage_data, stage_shape, state_program

DOUBLES = ct.POINTER(ct.c_double)
MOST_STATES = 48  # of riccati.c
NEEDED_DIGITS = 10.0  # the residuals of slacks are asked for this much more loosely than the gap


class _Problem(ct.Structure):
    """`tr_problem` of riccati.c."""

    _fields_ = (
        *[(name, ct.c_int) for name in ("stages", "free_stages", "states", "outputs", "rows", "nodes")],
        *[(name, ct.c_int) for name in ("current", "repeated")],
        *[(name, DOUBLES) for name in ("A", "C", "E", "weight", "reference", "rule_gain", "rule_offset")],
        *[(name, DOUBLES) for name in ("G", "d", "d_size", "lower", "upper")],
        *[(name, DOUBLES) for name in ("M", "b", "gain", "square", "F", "f")],
        *[(name, ct.c_double) for name in ("movement_weight", "decay", "ripple", "copper", "command_bound")],
    )


class _Options(ct.Structure):
    _fields_ = (("max_iterations", ct.c_int), ("tolerance", ct.c_double))


class _Result(ct.Structure):
    _fields_ = (
        *[(name, DOUBLES) for name in ("movement", "size", "lower", "upper", "gradient", "start")],
        ("iterations", ct.c_int),
        *[(name, ct.c_double) for name in ("objective", "gap", "residual")],
    )


# What `tr_solve` returns.
STATUS = (
    (Status.OPTIMAL, "solved"),
    (Status.OPTIMAL, "solved to what rounding leaves"),
    (Status.ITERATION_LIMIT, "iteration limit"),
    (Status.NUMERICAL_FAILURE, "no step left"),
    (Status.NUMERICAL_FAILURE, "a factorisation broke down"),
    (Status.NUMERICAL_FAILURE, "too many states"),
)


def _library() -> ct.CDLL | None:
    found = find_spec(EXTENSION)
    if found is None or found.origin is None:
        return None
    library = ct.CDLL(found.origin)
    library.tr_workspace.restype = ct.c_size_t
    return library


_LIBRARY = _library()
available = _LIBRARY is not None


@dataclass(frozen=True)
class Rows:
    """Limits as rows lower_k <= G x_k + d dc_k + d_size e_k <= upper_k, k = 0..N, and where their multipliers go.

    Attributes
    ----------
    G : (rows, n). d, d_size : (rows,). lower, upper : (N + 1, rows), infinite where there is no limit.
    unit : (rows,) of a row, in units of the program: the largest of its bounds, so that limits are of order one.
    variables, constraints : (rows, N + 1) index of the limited variable or row of the program, -1 for none.
    """

    G: FloatArray
    d: FloatArray
    d_size: FloatArray
    lower: FloatArray
    upper: FloatArray
    unit: FloatArray
    variables: FloatArray
    constraints: FloatArray


def rows(statement: Statement, V: FloatArray, v: FloatArray) -> Rows:
    """Every limit of the statement, the winding's first; `V`, `v` as `transcribe.stage_data` gives them."""
    problem, shape = statement.problem, statement.shape
    N, n, where = shape.stages, shape.layout.states, shape.layout
    place = shape.first + np.arange(N * shape.variables).reshape(N, shape.variables)
    of_kind = state_program(shape).rows
    states = np.eye(n)
    found: list[tuple[FloatArray, float, float, FloatArray, FloatArray]] = []

    def row(
        G: FloatArray, d: float, d_size: float, *, first: int, variables: object = None, constraints: object = None
    ) -> None:
        """One row from stage `first` on; `variables` or `constraints` as many as it has stages."""
        at = np.full((2, N + 1), -1)
        for kind, indices in enumerate((variables, constraints)):
            if indices is not None:
                index = np.asarray(indices)
                at[kind, first : first + index.size] = index
        found.append((G, d, d_size, at[0], at[1]))

    if shape.nodes:
        start = [0] if shape.repeated else []
        row(0 * states[0], 0.0, 0.0, first=1 - len(start), variables=[*start, *place[:, shape.command + 1]])
    free = slice(0, problem.free_stages if problem.wall is None else N)  # a plain hand-over's commands are zero
    row(states[-1], 1.0, 0.0, first=0, variables=place[free, shape.command])
    if where.amplifier:
        row(states[where.current], 0.0, 0.0, first=1, variables=place[:-1, shape.controls + where.current])
    if problem.limits.slew_A_per_s is not None:
        row(0 * states[0], 1.0, 0.0, first=0, variables=place[:, 0])
    if shape.supply:
        for kind, (first, j) in {"supply_before": (1, 0), "supply_after": (0, 1)}.items():
            row(V[j], v[j], 0.0, first=first, constraints=np.arange(of_kind[kind].start, of_kind[kind].stop))
    if shape.nodes:
        for kind, sign in {"size_above": -1.0, "size_below": 1.0}.items():
            row(
                sign * V[2], sign * v[2], 1.0, first=0, constraints=np.arange(of_kind[kind].start, of_kind[kind].stop)
            )
        row(0 * states[0], 0.0, 1.0, first=0, variables=place[:, 1])

    G, d, d_size, variables, constraints = (np.array(each) for each in zip(*found, strict=True))
    lower, upper = np.full(variables.shape, -np.inf), np.full(variables.shape, np.inf)
    for index, low, high in (
        (variables, statement.lower_x, statement.upper_x),
        (constraints, statement.lower_g, statement.upper_g),
    ):
        stated = index >= 0
        lower[stated], upper[stated] = low[index[stated]], high[index[stated]]
    bounds = np.concatenate([lower, upper], axis=1)
    unit = np.abs(np.where(np.isfinite(bounds), bounds, 0.0)).max(axis=1)
    # The winding's row is a state of the recursion, whose unit is the largest headroom already.
    unit = np.where((unit > 0) & (np.arange(unit.size) >= min(shape.nodes, 1)), unit, 1.0)
    by = unit[:, None]
    return Rows(G / by, d / unit, d_size / unit, (lower / by).T, (upper / by).T, unit, variables, constraints)


def _multipliers(
    statement: Statement, limits: Rows, by_row: FloatArray, hand_over: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """CasADi's lam_x and lam_g from upper less lower multipliers (N + 1, rows)."""
    program = state_program(statement.shape)
    lam_x, lam_g = np.zeros(statement.lower_x.size), np.zeros(statement.lower_g.size)
    for index, lam in ((limits.variables, lam_x), (limits.constraints, lam_g)):
        stated = index >= 0
        lam[index[stated]] = (by_row / limits.unit).T[stated]
    lam_g[program.rows["hand_over"]] = hand_over
    return lam_x, lam_g


@dataclass(frozen=True)
class Stages:
    """One problem as the method takes it, in the statement's units.

    Attributes
    ----------
    sizes, numbers, arrays : integers, scalars and arrays of `tr_problem`, by name.
    """

    statement: Statement
    limits: Rows
    sizes: dict[str, int]
    numbers: dict[str, float]
    arrays: dict[str, FloatArray]


def stages(problem: TransientProblem) -> Stages:
    """Stage data of a problem, from the CasADi statement."""
    statement = state(problem)
    shape, values, where = statement.shape, statement.values, statement.shape.layout
    function = stage_data(stage_shape(shape))
    data = function(**{name: values[name] for name in function.name_in()})
    A, C, E, V, v = (np.asarray(data[name]) for name in function.name_out())
    limits = rows(statement, V, v.ravel())
    gains, offsets = hand_over_rows(problem, statement.stage)
    gains[:, -1] -= 1.0  # c_k = rows x_k + constant, so dc_k = that less c_(k-1)
    m, nothing = shape.nodes, np.zeros(4)
    heat = {name: values[name] if m else nothing for name in ("b", "gain", "square", "f")}
    heat |= {name: values[name].reshape(m, m).T if m else nothing for name in ("M", "F")}
    arrays = {
        "A": A,
        "C": C,
        "E": E,
        "weight": 2 * values["w"] / (OBJECTIVE_SCALE * where.devices),
        "reference": values["r"],
        "rule_gain": gains,
        "rule_offset": offsets,
        **{name: getattr(limits, name) for name in ("G", "d", "d_size", "lower", "upper")},
        **heat,
    }
    return Stages(
        statement=statement,
        limits=limits,
        sizes={
            "stages": shape.stages,
            "free_stages": problem.free_stages,
            "states": where.states,
            "outputs": where.devices,
            "rows": limits.d.size,
            "nodes": m,
            "current": where.current if where.amplifier else -1,
            "repeated": int(shape.repeated),
        },
        numbers={
            "movement_weight": 2 * float(values["rho"][0]) / OBJECTIVE_SCALE,
            "command_bound": problem.limits.command_bound_A / statement.stage.current_A,
            **{name: float(values[name][0]) if m else 0.0 for name in ("decay", "ripple", "copper")},
        },
        arrays={name: np.ascontiguousarray(array, dtype=float) for name, array in arrays.items()},
    )


def can_solve(problem: TransientProblem) -> bool:
    """Whether the extension is there and the problem small enough: many devices in a spread are too many states."""
    shape = program_shape(problem)
    return available and shape.layout.states + shape.nodes <= MOST_STATES


def solve(problem: TransientProblem, options: SolverOptions) -> Solution:
    """Solve the QP or the NLP stage by stage; infeasibility is claimed only with its proof (`farkas`)."""
    assert _LIBRARY is not None
    start = time.perf_counter()
    given = stages(problem)
    statement, limits, N = given.statement, given.limits, given.sizes["stages"]
    stated = _Problem(
        **given.sizes,
        **given.numbers,
        **{name: array.ctypes.data_as(DOUBLES) for name, array in given.arrays.items()},
    )
    answer = {name: np.zeros(N) for name in ("movement", "size", "gradient")}
    answer.update({name: np.zeros(limits.lower.shape) for name in ("lower", "upper")}, start=np.zeros(4))
    result = _Result(**{name: array.ctypes.data_as(DOUBLES) for name, array in answer.items()})
    asked = _Options(options.max_iterations, NEEDED_DIGITS * options.tolerance)
    workspace = np.empty(_LIBRARY.tr_workspace(ct.byref(stated)))
    code = _LIBRARY.tr_solve(ct.byref(stated), ct.byref(asked), workspace.ctypes.data_as(DOUBLES), ct.byref(result))
    status, message = STATUS[code]
    by_row, tail = answer["upper"] - answer["lower"], answer["gradient"][problem.free_stages :]
    command = statement.held(np.cumsum(answer["movement"]) * statement.stage.current_A)
    multipliers = statement.multipliers(*_multipliers(statement, limits, by_row, -tail))
    if status is not Status.OPTIMAL and is_infeasible(problem, command, multipliers):
        status, message = Status.INFEASIBLE, f"{message}: a ray proves that no command meets all limits"
    return Solution(
        status=status,
        command_A=command,
        multipliers=multipliers,
        solver="riccati",
        message=message,
        iterations=result.iterations,
        solve_time_s=time.perf_counter() - start,
    )
