"""The project's own solver: an interior-point method over the stages, in C (`native/riccati.c`).

The extension is optional. Where it could not be built, `available` is False and the CasADi methods take over.
"""

import time
from collections.abc import Sequence

import numpy as np

from transopt.problem.answer import Solution, Status
from transopt.problem.objective.target import Target
from transopt.problem.problem import TransientProblem
from transopt.problem.stage import layout
from transopt.proof.farkas import is_infeasible
from transopt.solvers.native.extension import Answer, available, interior_points, takes
from transopt.solvers.options import SolverOptions, TrialOptions
from transopt.solvers.stage_data import Stages, stages, stages_of

__all__ = ["available", "can_solve", "solve", "stages"]

# Factor by which the tolerances on gap and residuals are looser than `SolverOptions.tolerance`. At the default that
# leaves three digits to the certificate's tolerance; more digits only cost iterations.
LOOSER = 10.0
BOUND = 1e-6  # least multiplier, in scaled units, of a limit that binds; others have about the tolerance
MOST_TARGETS, MOST_LIMITS = 256, 32  # targets of which trials are known, and limits of each

Spans = dict[int, tuple[Target, dict[float, int]]]  # as `TrialOptions.spans`
ROWS_OF_HEAT = 4  # rows beside those of the limits: the winding's temperature, and the magnitude of the mean current

# Status of each code that `tr_solve` returns.
STATUS = (
    (Status.OPTIMAL, "solved"),
    (Status.OPTIMAL, "solved to what rounding leaves"),
    (Status.ITERATION_LIMIT, "iteration limit"),
    (Status.NUMERICAL_FAILURE, "no step left"),
    (Status.NUMERICAL_FAILURE, "a factorisation broke down"),
    (Status.NUMERICAL_FAILURE, "too many states"),
)


def can_solve(problem: TransientProblem) -> bool:
    """Whether the extension exists and the problem fits it; many devices may have too many states or rows."""
    nodes = 0 if problem.thermal is None else problem.thermal.model.nodes
    # The temperature is the only nonlinear limit that the compiled recursion can handle.
    if problem.own_nonlinear:
        return False
    where = layout(problem)
    return available and takes(where.states + nodes, where.motors, len(problem.rows()) + ROWS_OF_HEAT)


def solve(problems: Sequence[TransientProblem], options: SolverOptions) -> list[Solution]:
    """Solve QPs and NLPs stage by stage; INFEASIBLE is returned only with a proof (`farkas`).

    Problems of equal sizes are solved side by side; each is reported with an equal share of the time.
    """
    start = time.perf_counter()
    given = stages_of(problems)
    spans = options.spans if isinstance(options, TrialOptions) else None
    answers = interior_points(
        given,
        tolerance=LOOSER * options.tolerance,
        max_iterations=options.max_iterations,
        first=[] if spans is None else [_known_span(each.problem, spans) for each in given],
    )
    if spans is not None:
        for each, answer in zip(given, answers, strict=True):
            _note(spans, each.problem, _span(answer))
    spent = (time.perf_counter() - start) / max(len(given), 1)
    return [_solution(each, answer, spent) for each, answer in zip(given, answers, strict=True)]


def _note(spans: Spans, problem: TransientProblem, span: int) -> None:
    """Keep up to which stage limits bound in a trial, and forget what is oldest."""
    if len(spans) > MOST_TARGETS:
        spans.clear()
    limit, (_, known) = problem.limits.input_limit, spans.setdefault(id(problem.target), (problem.target, {}))
    known.pop(limit, None)
    known[limit] = span
    if len(known) > MOST_LIMITS:
        del known[next(iter(known))]


def _known_span(problem: TransientProblem, spans: Spans) -> int:
    """Stages up to which limits bound in trials of the same target; 0 where there was none.

    Of the trials under the next lower and the next higher limit the longer counts, since too short a search is begun
    anew.
    """
    _, known = spans.get(id(problem.target), (None, {}))
    limit = problem.limits.input_limit
    lower = max((at for at in known if at <= limit), default=None)
    higher = min((at for at in known if at >= limit), default=None)
    return max((known[at] for at in (lower, higher) if at is not None), default=0)


def _span(answer: Answer) -> int:
    """Stages up to the last at which a limit binds."""
    most = np.maximum(answer.lower, answer.upper).max(axis=1, initial=0.0)
    return 1 + int(np.flatnonzero(most > BOUND).max(initial=-1))


def _solution(given: Stages, answer: Answer, spent_s: float) -> Solution:
    status, message = STATUS[answer.code]
    command = given.command(answer.command)
    multipliers = given.multipliers(answer.upper - answer.lower, answer.gradient)
    if status is not Status.OPTIMAL and is_infeasible(given.problem, command, multipliers):
        status, message = Status.INFEASIBLE, f"{message}: a ray proves that no command meets all limits"
    return Solution(
        status=status,
        command=command,
        multipliers=multipliers,
        solver="riccati",
        message=message,
        iterations=answer.iterations,
        solve_time_s=spent_s,
    )
