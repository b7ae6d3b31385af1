"""The single path from a problem to an entry: solve, certify, replay, admit."""

import math
from collections.abc import Callable, Sequence

import numpy as np

from transopt.base.threads import one_blas_thread
from transopt.design.batch import Batch
from transopt.design.context import Posed
from transopt.design.cool import at_share_of_heat
from transopt.design.entry import Entry
from transopt.design.intensity import best
from transopt.problem.objective.tracking import filter_together
from transopt.proof.designed import Designed
from transopt.solvers.options import SolverOptions
from transopt.solvers.side_by_side import Search, together

# Problems in one batch of the solver: fewer leave lanes of the compiled method idle, the working memory of more would
# set the peak of memory.
SOLVED_TOGETHER = 128
PLAYED_TOGETHER = 64  # answers in one simulation; the courses of more at fine steps would set the peak of memory


@one_blas_thread()
def design(
    problems: Sequence[Posed],
    *,
    rivals: bool = False,
    options: SolverOptions | None = None,
    failed: Callable[[Posed, Exception], None] | None = None,
) -> list[Entry]:
    """Solve and certify problems; replay and admission of the entries are computed when first read.

    Problems of equal sizes are solved side by side, and answers of the same device are replayed in one simulation.
    Results that only some readers need, such as prices or the errors of the baselines, are computed on first access
    (`transopt.design.entry`).

    Parameters
    ----------
    problems : in any order.
    rivals : whether the baselines' errors will be read for all entries; the baselines then share the simulation.
    options : solver and its tolerance.
    failed : called with a problem whose solution raised an exception, and with the exception; its entry is then left
        out. Without `failed` the exception is raised.

    Returns
    -------
    The entries in the order of the problems.
    """
    options = SolverOptions() if options is None else options
    found: list[Designed | None] = []
    for part in np.array_split(np.arange(len(problems)), math.ceil(len(problems) / SOLVED_TOGETHER) or 1):
        some = [problems[number] for number in part]
        filter_together([posed.problem.tracking for posed in some])
        found += together([_solved(posed, options, failed) for posed in some])
    solved = {number: designed for number, designed in enumerate(found) if designed is not None}
    entries: dict[int, Entry] = {}
    played: dict[tuple[object, ...], list[int]] = {}
    for number, designed in solved.items():
        played.setdefault(_played_with(problems[number], designed), []).append(number)
    batches = [
        group[at : at + PLAYED_TOGETHER] for group in played.values() for at in range(0, len(group), PLAYED_TOGETHER)
    ]
    for numbers in batches:
        first = problems[numbers[0]]
        uncorrected = [problems[n].uncorrected or solved[n].problem.target for n in numbers]
        batch = Batch([solved[n] for n in numbers], first.coil, first.steady_input, uncorrected, with_rivals=rivals)
        for index, n in enumerate(numbers):
            posed = problems[n]
            tap = (posed.speed_m_s, posed.grip_N, posed.target)
            told_by = (posed.repeatability, options, posed.objective)
            entries[n] = Entry(*tap, solved[n], batch, index, *told_by, spot=posed.place)
    return [entries[number] for number in sorted(entries)]


def _solved(
    posed: Posed, options: SolverOptions, failed: Callable[[Posed, Exception], None] | None
) -> Search[Designed | None]:
    try:
        if posed.warmer is not None:
            return (yield from at_share_of_heat(posed, posed.warmer, posed.cool_share, options))
        if posed.plant is None:
            return (yield from best(posed.problem, options, objective=posed.objective))
        # Imported here, so that IPOPT is loaded only for a nonlinear plant.
        from transopt.design.nonlinear import nonlinear_optimum

        return nonlinear_optimum(posed, options)
    except Exception as error:
        if failed is None:
            raise
        failed(posed, error)
        return None


def _played_with(posed: Posed, designed: Designed) -> tuple[object, ...]:
    """The key of a batch: answers with equal keys can be replayed in one simulation."""
    problem = designed.problem
    return (
        *map(id, (problem.stage, *problem.spread)),
        problem.grid,
        problem.hand_over_samples,
        posed.coil,
        posed.steady_input,
        None if problem.thermal is None else problem.thermal.budget.tap_rate_Hz,
        tuple(limit.name for limit in problem.limits),
        problem.wall is None,
        designed.nonlinear is None,
    )
