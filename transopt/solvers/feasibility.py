"""Feasibility of the linear limits, and the least factor by which they would have to be wider: a linear program.

HiGHS decides feasibility, not the solvers of the problem itself: without a feasible point these search until their
iteration limit and their last iterate says little. A vertex of a linear program decides.

The program is scaled to suit HiGHS's absolute tolerances. It is stated in the units of the stage, in which every row
and every column has a coefficient of order one. All variables are divided by the largest bound, which is large where
a wall asks for far more than the limit. Coefficients below `NOTHING` are dropped, as HiGHS would do itself: beside
variables of order one they are below its tolerance. Presolve is off: on some of these programs it writes outside its
memory (with scipy 1.17 and 1.18), whatever their scale. For the same reason HiGHS runs in a process of its own.
"""

from collections.abc import Collection
from typing import Any, Literal, NamedTuple

import numpy as np
import scipy

from transopt.base import apart
from transopt.base.signals import FloatArray
from transopt.problem.limits.row import Row
from transopt.problem.problem import TransientProblem
from transopt.solvers.program import state_program
from transopt.solvers.sparse_kkt import pattern
from transopt.solvers.statement import Statement, state, variable

NO_PRICE = 1e-9  # a limit with a smaller share of what the factor costs is not to blame
SLACK = 1e-9  # relative excess up to which limits count as met
TOLERANCE = 1e-9  # primal and dual feasibility tolerance of HiGHS
NOTHING = 1e-9  # coefficients below this are dropped
MOST_TIME_S = 30.0
LATE_S = 20.0  # time beyond the time limits of both methods after which their process is ended
# Without presolve the interior point is the faster method; its crossover yields a vertex. If it stops undecided, the
# simplex method is tried.
METHODS: tuple[Literal["highs-ipm", "highs"], ...] = ("highs-ipm", "highs")
DECIDED = (0, 2)  # scipy's status codes for an optimum and for a proof of infeasibility


class Widening(NamedTuple):
    """The least widening of limits.

    Attributes
    ----------
    factor : >= 1. command : (N,) one that is feasible with it.
    blamed : names of those limits whose multipliers in the linear program, or whose values before the first command
        acts, prove that a smaller factor is not enough. The proof holds whatever the width of any other limit: none
        of these is enough if it alone is widened.
    """

    factor: float
    command: FloatArray
    blamed: frozenset[str]


def least_widening(problem: TransientProblem, limits: Collection[str]) -> Widening | None:
    """Least factor by which the named limits have to be widened together, and a command that is feasible with it.

    Nonlinear limits are ignored. None if no factor is enough, or if none was found in time.

    Parameters
    ----------
    limits : names of the limits to widen; all others stay as they are.

    Raises
    ------
    InputError : invalid bounds of a limit (`check_bounds`).
    """
    try:
        return apart.call(_found, problem, tuple(limits), within_s=MOST_TIME_S * len(METHODS) + LATE_S)
    except apart.UnansweredError:
        return None


def _found(problem: TransientProblem, limits: Collection[str]) -> Widening | None:
    # Values before the first command acts are fixed and have no row in the program; their excess bounds the factor.
    least, blamed = 0.0, set[str]()
    for limit, row in problem.rows():
        if row.linear and row.waits:
            over = _first_excess(row) / limit.stated
            if over > SLACK and limit.name not in limits:
                return None
            if over > SLACK:
                blamed.add(limit.name)
            least = max(least, over)
    statement = state(problem.without(*problem.nonlinear))
    shape, program = statement.shape, state_program(statement.shape)
    data = program.qp_data(p=statement.p)
    A = scipy.sparse.csc_array((np.asarray(data["A"].nonzeros()), *pattern(shape, "A")), shape=data["A"].shape)
    wide_x, wide_g = _widths(statement, limits)
    lower_x, upper_x, lower_g, upper_g = (
        np.array(bound) for bound in (statement.lower_x, statement.upper_x, statement.lower_g, statement.upper_g)
    )
    columns = np.flatnonzero(wide_x)
    rows = np.flatnonzero(wide_g)
    equal = lower_g == upper_g
    fixed = np.flatnonzero(~equal & ~wide_g.astype(bool))
    picked = scipy.sparse.csr_array(
        (np.ones(columns.size), (np.arange(columns.size), columns)), shape=(columns.size, A.shape[1])
    )
    A_rows = A.tocsr()
    blocks: list[Any] = []  # typed as Any: the stubs only know dense matrices
    bounds = []
    for matrix, width, upper, lower in (
        (picked, wide_x[columns], upper_x[columns], lower_x[columns]),
        (A_rows[rows], wide_g[rows], upper_g[rows], lower_g[rows]),
        (A_rows[fixed], np.zeros(fixed.size), upper_g[fixed], lower_g[fixed]),
    ):
        if width.size:
            factor = scipy.sparse.csr_array(-width[:, None])
            blocks += [scipy.sparse.hstack([matrix, factor]), scipy.sparse.hstack([-matrix, factor])]
            bounds += [upper, -lower]
    lower_x[columns], upper_x[columns] = -np.inf, np.inf
    inequalities = _without_nothing(scipy.sparse.vstack(blocks)) if blocks else None
    equalities = _without_nothing(
        scipy.sparse.hstack([A_rows[np.flatnonzero(equal)], scipy.sparse.csr_array((int(equal.sum()), 1))])
    )
    above, level = np.concatenate(bounds) if bounds else None, lower_g[equal]
    box: Any = np.column_stack([np.append(lower_x, least), np.append(upper_x, np.inf)])
    unit = max(_largest(each) for each in (np.ones(1), box, level, *bounds))
    options: Any = {"primal_feasibility_tolerance": TOLERANCE, "time_limit": MOST_TIME_S, "presolve": False}
    for method in METHODS:
        found = scipy.optimize.linprog(
            c=np.append(np.zeros(A.shape[1]), 1.0),
            A_ub=inequalities,
            b_ub=None if above is None else above / unit,
            A_eq=equalities,
            b_eq=level / unit,
            bounds=box / unit,
            method=method,
            options=options,
        )
        if found.status in DECIDED:
            break
    if found.status != 0 or found.x is None:
        return None
    x = found.x * unit
    widened = float(x[-1])
    command = x[shape.first : -1].reshape(shape.stages, shape.variables)[:, shape.commands]
    command = np.asarray(command.T * statement.stage.input_scale).reshape(problem.rest.shape)
    if problem.wall is None:
        command[..., problem.free_stages :] = 0.0
    own_x, own_g = (
        np.split(-found.ineqlin.marginals, [2 * columns.size, 2 * (columns.size + rows.size)])[:2]
        if blocks
        else (np.empty(0), np.empty(0))
    )
    for name in limits:
        its_x, its_g = _widths(statement, [name])
        price = (own_x.reshape(2, -1) * its_x[columns]).sum() + (own_g.reshape(2, -1) * its_g[rows]).sum()
        if price > NO_PRICE:
            blamed.add(name)
    return Widening(1.0 + (widened if widened > SLACK else 0.0), command, frozenset(blamed))


def _largest(bounds: FloatArray) -> float:
    return float(np.abs(bounds[np.isfinite(bounds)]).max(initial=0.0))


def _without_nothing(matrix: Any) -> Any:
    matrix = matrix.tocsr()
    matrix.data[np.abs(matrix.data) < NOTHING] = 0.0
    matrix.eliminate_zeros()
    return matrix


def _first_excess(row: Row) -> float:
    """Excess of a row over its bounds at the first instant, where no command acts yet; negative inside."""
    offset, lower, upper = (float(np.ravel(each)[0]) for each in (row.offset, row.lower, row.upper))
    return max(offset - upper, lower - offset)


def _widths(statement: Statement, limits: Collection[str]) -> tuple[FloatArray, FloatArray]:
    """Increase of each bound of the variables and of the rows per unit of widening; zero for unchanged bounds."""
    shape, stage = statement.shape, statement.stage
    wide_x, wide_g = np.zeros((shape.stages, shape.variables)), np.zeros(statement.upper_g.size)
    upper = statement.upper_x[shape.first :].reshape(shape.stages, shape.variables)
    named = {row.name for limit, row in statement.problem.rows() if limit.name in limits}
    for row in statement.rows:
        if row.name not in named:
            continue
        if row.single:
            column = variable(shape, row.single) + row.motor
            wide_x[:, column] = np.where(np.isfinite(upper[:, column]), row.unit / stage.input_scale, 0.0)
        else:
            wide_g[state_program(shape).rows[row.name]] = 1.0
    return np.append(np.zeros(shape.first), wide_x.ravel()), wide_g
