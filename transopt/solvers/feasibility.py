"""The least factor by which linear limits would have to be wider, by the project's own method in a single search.

The factor 1 + t is a decision of the program: its stages get one more motor, whose held command is t.

    minimise    1/2 (1 + t_N)^2 + 1/2 STILL sum_(k > 0) (t_k - t_(k-1))^2 + 1/2 REST |u|^2
    subject to  dynamics and hand-over,  lower - w t_k <= G x_k + d u_k <= upper + w t_k,  t_0 >= least

with the width w of a limit's row, which is 0 for limits that are not widened. The second term makes t one number for
all stages; the third selects, of the commands that are feasible with that factor, the one that moves least. The
search diverges where no factor is enough.
"""

from collections.abc import Collection
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from transopt.base.signals import FloatArray
from transopt.problem.answer import Multipliers
from transopt.problem.limits.row import Row
from transopt.problem.problem import TransientProblem
from transopt.problem.stage import layout
from transopt.proof.effect import boxes
from transopt.solvers.native.extension import ACCURACY, Answer, available, interior_points, takes
from transopt.solvers.stage_data import Stages, stages

NO_PRICE = 1e-6  # a limit with a smaller share of what the factor costs is not to blame
SLACK = 1e-7  # relative excess up to which limits count as met
TOLERANCE = 1e-9  # of the search, on residuals and on the gap relative to the square of the factor
MOST_ITERATIONS = 60  # a search that converges takes half of it
STILL, REST = 1e10, 1e-10  # weights
ROOM = 2.0  # a second search begins at this factor times the excess that the first one has left


class Widening(NamedTuple):
    """The least widening of limits.

    Attributes
    ----------
    factor : >= 1. command : (N,) one that is feasible with it, or (m, N) with m motors.
    blamed : names of those limits whose multipliers, or whose values before the first command acts, prove that a
        smaller factor is not enough. The proof holds whatever the width of any other limit: none of these is enough
        if it alone is widened.
    """

    factor: float
    command: FloatArray
    blamed: frozenset[str]


def can_widen(problem: TransientProblem) -> bool:
    """Whether the extension exists and takes the problem with one more motor and each row's two sides apart."""
    where = layout(_with_linear_limits(problem))
    return available and takes(where.states + 1, where.motors + 1, 2 * len(problem.rows()) + 1)


def _with_linear_limits(problem: TransientProblem) -> TransientProblem:
    """The problem without nonlinear limits, and without error filters: they decide nothing and double the work."""
    unfiltered = tuple(replace(term, error_filter=None) for term in problem.terms[:1])
    return replace(problem.without(*problem.nonlinear), terms=unfiltered, intensity=0.0)


@np.errstate(over="ignore", invalid="ignore")  # extreme numbers overflow; the search breaks down then
def least_widening(problem: TransientProblem, limits: Collection[str]) -> Widening | None:
    """Least factor by which the named limits have to be widened together, and a command that is feasible with it.

    Nonlinear limits are ignored. None if no factor is enough, or if none was found. The problem is one that
    `can_widen`.

    Parameters
    ----------
    limits : names of the limits to widen; all others stay as they are.

    Raises
    ------
    InputError : invalid bounds of a limit (`check_bounds`).
    """
    # Values before the first command acts are fixed and have no row in the stages; their excess bounds the factor.
    least, blamed, ideal = 0.0, set[str](), problem.stage.amplifier is None
    for limit, row in problem.rows():
        over = _first_excess(row) / limit.stated if row.linear and row.waits(ideal=ideal) else 0.0
        if over > SLACK and limit.name not in limits:
            return None
        if over > SLACK:
            blamed.add(limit.name)
        least = max(least, over)
    problem = _with_linear_limits(problem)
    given = stages(problem)
    widths = {row.name: row.share if limit.name in limits else 0.0 for limit, row in problem.rows()}
    width = np.array([widths[kind] for kind in given.limits.kinds]) / given.limits.unit
    found, shift = _search(given, width, least), 0.0
    if found.code > ACCURACY and width.all():
        # From far outside of all limits no step is long enough: a larger factor to begin with puts it inside.
        command = _command(given, found)
        courses = boxes(problem, command, problem.stage.motion(command), Multipliers.zero(problem))
        shift = ROOM * float(np.max([box.excess.max() / box.limit.stated for box in courses]))
        found = _search(given, width, least, shift) if np.isfinite(shift) else found
    if found.code > ACCURACY:
        return None
    widened = shift + float(found.command[-1].max())
    price = (found.upper[:, : width.size] + found.lower[:, width.size : -1]).sum(axis=0) * width
    share = dict(zip(given.limits.kinds, price / (1 + widened), strict=True))
    for limit in problem.limits:
        if widened > SLACK and sum(share[row.name] for row in limit.rows(problem)) > NO_PRICE:
            blamed.add(limit.name)
    return Widening(1.0 + (widened if widened > SLACK else 0.0), _command(given, found), frozenset(blamed))


def alone(problem: TransientProblem, limit: str, together: Widening | None) -> Widening | None:
    """Least widening of one of the limits that were widened together, which as a rule tells it without a search."""
    if together is not None and together.factor == 1:
        return together
    if together is not None and limit not in together.blamed:
        return None
    if together is not None and together.blamed == {limit}:
        motion = problem.stage.motion(together.command)
        courses = boxes(problem, together.command, motion, Multipliers.zero(problem))
        if all(box.kept for box in courses if box.limit.linear and box.limit.name != limit):
            return together
    return least_widening(problem, (limit,))


def _command(given: Stages, found: Answer) -> FloatArray:
    """(N,) or (m, N) commands of an answer."""
    return given.free_command(found.command[:-1].reshape(given.problem.rest.shape))


def _search(given: Stages, width: FloatArray, least: float, shift: float = 0.0) -> Answer:
    """The answer of the module's program, whose last command is t less `shift`.

    Its rows are those of the problem with their upper bounds, then those with their lower bounds, then t itself.

    Parameters
    ----------
    width : (rows,) increase of each row's bounds per unit of t.
    """
    sizes, arrays = given.sizes, given.arrays
    N, n, motors, rows = (sizes[name] for name in ("stages", "states", "motors", "rows"))
    ruled, free = N - sizes["free_stages"], max(sizes["free_stages"], 1)
    A, last = np.eye(n + 1), np.eye(1, n + 1, n)
    A[:n, :n] = arrays["A"]
    gain, offset = np.zeros((ruled, motors + 1, n + 1)), np.zeros((ruled, motors + 1))
    gain[:, :motors, :n] = arrays["rule_gain"].reshape(ruled, motors, n)
    offset[:, :motors] = arrays["rule_offset"].reshape(ruled, motors)
    weight, reference = np.zeros((2, N, motors + 1))
    weight[1:, motors] = STILL
    if ruled == N:
        # No command is free, but t has to be: a weight takes the place of the rule at the first stage.
        weight[0, :motors], reference[0] = STILL, offset[0]
        gain, offset = gain[1:], offset[1:]
    G, d = (
        np.block([[each.reshape(rows, -1), -width[:, None]], [each.reshape(rows, -1), width[:, None]], [own]])
        for each, own in ((arrays["G"], last), (arrays["d"], np.eye(1, motors + 1, motors)))
    )
    bounds = np.full((2, N + 1, 2 * rows + 1), np.inf) * np.array([-1.0, 1.0])[:, None, None]
    bounds[0, :, rows:-1] = arrays["lower"].reshape(N + 1, rows) - shift * width
    bounds[1, :, :rows] = arrays["upper"].reshape(N + 1, rows) + shift * width
    bounds[0, 0, -1] = least - shift
    changed = {
        **{"A": A, "C": np.zeros((motors + 1, n + 1)), "E": np.eye(motors + 1), "G": G, "d": d},
        **{"weight": weight, "reference": reference, "rule_gain": gain, "rule_offset": offset},
        **{"end_gain": last, "end_target": np.array([-1.0 - shift]), "d_size": np.zeros(2 * rows + 1)},
        **{"lower": bounds[0], "upper": bounds[1]},
    }
    counts = {"states": n + 1, "motors": motors + 1, "outputs": motors + 1, "ends": 1, "rows": 2 * rows + 1}
    asked = replace(
        given,
        sizes=sizes | counts | {"free_stages": free},
        numbers=given.numbers | {"movement_weight": REST, "constant": 0.0},
        arrays=arrays | changed,
    )
    (found,) = interior_points([asked], tolerance=TOLERANCE, max_iterations=MOST_ITERATIONS, first=[N])
    return found


def _first_excess(row: Row) -> float:
    """Excess of a row over its bounds at the first instant, where no command acts yet; negative inside."""
    offset, lower, upper = (float(np.ravel(each)[0]) for each in (row.offset, row.lower, row.upper))
    return max(offset - upper, lower - offset)
