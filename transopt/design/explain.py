"""Why an entry is refused: which limit, by how much, when; and what would do, in numbers of its scene.

What is said to be missed "at the least" comes from linear programs or from a bisection, and is no proposal: at the
least width a single command is feasible, which no method finds and no replay keeps. What would do is found by solving
the entry again (`transopt.design.remedy`), and its type stands here.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import islice

import numpy as np

from transopt.base.signals import FloatArray
from transopt.problem.answer import Multipliers, Status
from transopt.problem.limits.limit import Limit
from transopt.problem.problem import TransientProblem
from transopt.proof.certify import Box, boxes, certify
from transopt.solvers import unlimited
from transopt.solvers.choose import capable, solve
from transopt.solvers.options import SolverOptions

WIDEST = 64.0  # times the limit: beyond, widening it alone is no remedy
MOST_ITERATIONS = 100
MOST_SOLVERS = 2  # asked whether a limit can be met
PRECISION = 0.005  # relative, of the least width of a limit


@dataclass(frozen=True)
class Change:
    """Another number in a scene.

    Attributes
    ----------
    key : dotted, of the scene; a whole table where that is left out.
    value : None for leaving it out.
    unit : of the value.
    """

    key: str
    value: float | None
    unit: str

    def __str__(self) -> str:
        return f"no {self.key}" if self.value is None else f"{self.key} = {self.value:.10g} {self.unit}".rstrip()


@dataclass(frozen=True)
class Remedy:
    """Numbers that together make an entry possible, or were tried for that.

    Attributes
    ----------
    changes : at least one.
    solved : whether the entry with exactly these was solved, certified and replayed clean; if not, they are the
        farthest that was tried.
    """

    changes: tuple[Change, ...]
    solved: bool

    def __str__(self) -> str:
        return " and ".join(map(str, self.changes))

    @property
    def values(self) -> Mapping[str, float | None]:
        """Key -> value."""
        return {change.key: change.value for change in self.changes}


def what_would_do(remedies: Sequence[Remedy]) -> str:
    """The remedies that were solved or, without one, what was tried in vain, in one sentence; empty without any."""
    solved = [str(remedy) for remedy in remedies if remedy.solved]
    if solved:
        return f"{', or '.join(solved)} would do"
    tried = ", ".join(str(remedy) for remedy in remedies)
    return f"tried in vain, as far as {tried}" if tried else ""


def unavoidable(problem: TransientProblem) -> list[str]:
    """Limits that are missed whatever is commanded: known without a solve."""
    return [said for limit in reversed(problem.limits.members) if (said := limit.unavoidable(problem))]


def _feasible(problem: TransientProblem, options: SolverOptions) -> FloatArray | None:
    """A command inside all limits, optimal or not, from the first solver that finds one or says there is none."""
    briefly = replace(options, max_iterations=min(options.max_iterations, MOST_ITERATIONS))
    for name in islice(capable(problem), MOST_SOLVERS):
        answer = solve(problem, replace(briefly, solver=name))
        if certify(problem, answer.command, answer.multipliers).excess <= 1:
            return answer.command
        if answer.status is Status.INFEASIBLE:
            return None
    return None


def infeasibility(problem: TransientProblem, options: SolverOptions) -> list[str]:
    """One sentence for each limit whose widening alone would help or, if none would, for all of them together.

    Empty if even that is not enough. What the linear limits lack is found by linear programs; only where they can be
    met it is the temperature, whose least limit is found by bisection. The command that just meets the wider limit
    tells by how much and when the stated one is missed.
    """
    # The linear program is stated in CasADi, which only a problem without a feasible point needs.
    from transopt.solvers.feasibility import least_widening

    linear = [limit for limit in reversed(problem.limits.members) if limit.linear]
    together = least_widening(problem, [limit.name for limit in linear])
    if together is None:
        return _proven(problem, linear, options)
    if together[0] > 1:
        found = []
        for limit in linear:
            least = least_widening(problem, [limit.name])
            if least is not None:
                found.append(_sentence(problem, limit, least[1]))
        if found:
            return found
        missed = [limit for limit in linear if _worst(problem, limit, together[1])[1] > 0]
        return [f"{_sentence(problem, limit, together[1])}, all limits wider at once" for limit in missed]
    for limit in problem.limits:
        if limit.linear:
            continue
        command = _least(lambda factor, limit=limit: problem.replaced(limit.wider(factor)), options)  # type: ignore[misc]
        if command is not None:
            return [_sentence(problem, limit, command)]
    return []


def _proven(problem: TransientProblem, linear: Sequence[Limit], options: SolverOptions) -> list[str]:
    """Ask a solver to prove that no command keeps all linear limits, where the linear program has found nothing.

    What the optimum without any limit takes tells how far it is from them.
    """
    if solve(problem.without(*problem.nonlinear), options).status is not Status.INFEASIBLE:
        return []
    free = unlimited.solve([problem])[0].command
    motion = problem.stage.motion(free)
    values = boxes(problem, free, motion, Multipliers.zero(problem))
    peaks = {limit.name: max(box.peak for box in values if box.limit.name == limit.name) for limit in linear}
    passed = [limit for limit in linear if not peaks[limit.name] <= limit.stated]
    taken = " and ".join(
        f"a {limit.label} of {peaks[limit.name]:.3g} {limit.unit}, limit {limit.stated:.8g} {limit.unit}"
        for limit in passed
    )
    names = ", ".join(limit.label for limit in passed or linear)
    without = f": without limits the optimum takes {taken}" if passed else ""
    return [f"{names}: proven that no command keeps all limits and ends in what the wall asks for{without}"]


def _least(widen: Callable[[float], TransientProblem], options: SolverOptions) -> FloatArray | None:
    """A command that meets all limits at the least factor, to `PRECISION`, at which one does; None if none does."""
    command = _feasible(widen(WIDEST), options)
    if command is None:
        return None
    low, high = 1.0, WIDEST
    while high / low > 1 + PRECISION:
        middle = float(np.sqrt(low * high))
        tried = _feasible(widen(middle), options)
        if tried is None:
            low = middle
        else:
            high, command = middle, tried
    return command


def _worst(problem: TransientProblem, limit: Limit, command: FloatArray) -> tuple[Box, float]:
    """The row of a limit that a command leaves farthest, and how far; negative inside."""
    motion = problem.stage.motion(command)
    of = [box for box in boxes(problem, command, motion, Multipliers.zero(problem)) if box.limit.name == limit.name]
    worst = max(of, key=lambda box: float(box.excess.max()))
    return worst, float(worst.excess.max())


def _sentence(problem: TransientProblem, limit: Limit, command: FloatArray) -> str:
    worst, by = _worst(problem, limit, command)
    time_ms = problem.grid.switching_times_s[int(np.argmax(worst.excess))] * 1e3
    return (
        f"{limit.label} {by:.3g} {limit.step_unit} over its limit {limit.stated:.8g} {limit.unit} at "
        f"{time_ms:.1f} ms at the least"
    )
