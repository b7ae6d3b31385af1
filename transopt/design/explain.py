"""Why an entry is refused: which limit is missed, by how much and when; and the type of a remedy.

The excess stated "at the least" comes from the least factor by which limits have to be wider, and is not a proposal:
at that least width only a single command is feasible, which solvers miss and whose replay exceeds the limit. Remedies
are found by solving the entry again with other numbers (`transopt.design.remedy`).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import islice

import numpy as np

from transopt.base.signals import FloatArray
from transopt.problem.answer import Status
from transopt.problem.limits.limit import Limit
from transopt.problem.problem import TransientProblem
from transopt.proof.certify import certify
from transopt.proof.effect import Box, Effect, farthest_out
from transopt.solvers import unlimited
from transopt.solvers.choose import capable, solve
from transopt.solvers.feasibility import Widening, alone, can_widen, least_widening
from transopt.solvers.options import SolverOptions

WIDEST = 64.0  # largest factor by which one limit is widened; more would not be a sensible remedy
MOST_ITERATIONS = 100
MOST_SOLVERS = 2  # number of solvers tried on the question whether a limit can be met
PRECISION = 0.005  # relative accuracy to which bisection finds a limit's least width


@dataclass(frozen=True)
class Change:
    """A change of one number of a scene.

    Attributes
    ----------
    key : dotted key in the scene; the key of a whole table if the table is removed.
    value : the new number; None removes the key.
    unit : unit of the value.
    """

    key: str
    value: float | None
    unit: str

    def __str__(self) -> str:
        return f"no {self.key}" if self.value is None else f"{self.key} = {self.value:.10g} {self.unit}".rstrip()


@dataclass(frozen=True)
class Remedy:
    """Changes that together make a refused entry possible, or that were tried in vain.

    Attributes
    ----------
    changes : at least one change.
    solved : whether the entry with exactly these changes was solved, certified and replayed without a violation; if
        not, they are the largest changes that were tried.
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
    """One sentence on the solved remedies or, if there are none, on those tried in vain; empty without any."""
    solved = [str(remedy) for remedy in remedies if remedy.solved]
    if solved:
        return f"{', or '.join(solved)} would do"
    tried = ", ".join(str(remedy) for remedy in remedies)
    return f"tried in vain, as far as {tried}" if tried else ""


def unavoidable(problem: TransientProblem) -> list[str]:
    """Sentences on limits that every command violates, as far as this is known without a solve."""
    return [reason for limit in reversed(problem.limits.members) if (reason := limit.unavoidable(problem))]


def _feasible(problem: TransientProblem, options: SolverOptions) -> FloatArray | None:
    """A feasible command, optimal or not; None if a solver proves infeasibility or no solver finds one."""
    briefly = replace(options, max_iterations=min(options.max_iterations, MOST_ITERATIONS))
    for name in islice(capable(problem), MOST_SOLVERS):
        answer = solve(problem, replace(briefly, solver=name))
        if certify(problem, answer.command, answer.multipliers).excess <= 1:
            return answer.command
        if answer.status is Status.INFEASIBLE:
            return None
    return None


def infeasibility(problem: TransientProblem, options: SolverOptions) -> list[str]:
    """Explain infeasibility: a sentence for each limit whose widening alone makes the problem feasible.

    If no single limit suffices, all linear limits are widened together; the result is empty if even that is not
    enough. Only if the linear limits can all be met is the nonlinear one (the temperature) to blame. The command that
    just meets the widened limit shows by how much and when the stated limit is missed.
    """
    bare, linear = (
        problem.without(*problem.nonlinear),
        [each for each in reversed(problem.limits.members) if each.linear],
    )
    together = _least_widening(bare, linear, options)
    if together is None:
        return _proven(bare, linear, options)
    if together.factor > 1:
        each = [(limit, _alone(bare, limit, together, options)) for limit in linear if limit.name in together.blamed]
        found = [_sentence(problem, limit, least.command) for limit, least in each if least is not None]
        if found:
            return found
        there = Effect(problem, together.command)
        missed = [limit for limit in linear if farthest_out(there, limit).most > 0]
        return [f"{_sentence(problem, limit, together.command)}, all limits wider at once" for limit in missed]
    for limit in problem.limits:
        if not limit.linear and (least := _least_widening(problem, [limit], options)) is not None:
            return [_sentence(problem, limit, least.command)]
    return []


def _proven(problem: TransientProblem, linear: Sequence[Limit], options: SolverOptions) -> list[str]:
    """Let a solver prove the linear limits infeasible, where no widening was found.

    The sentence compares the limits with the peaks of the unlimited optimum. Empty without a proof.
    """
    if solve(problem, options).status is not Status.INFEASIBLE:
        return []
    free = unlimited.solve([problem])[0].command
    there = Effect(problem, free)
    worst = [farthest_out(there, limit) for limit in linear]
    passed = [box for box in worst if not box.most <= 0]
    taken = " and ".join(
        f"a {box.limit.label} of {_bound(box, by=box.most, digits=3)}, limit {_bound(box)}" for box in passed
    )
    names = ", ".join(box.limit.label for box in passed or worst)
    without = f": without limits the optimum takes {taken}" if passed else ""
    return [f"{names}: proven that no command keeps all limits and ends in what the wall asks for{without}"]


def _least_widening(problem: TransientProblem, limits: Sequence[Limit], options: SolverOptions) -> Widening | None:
    """The least factor by which limits have to be widened together; None if none was found.

    In one search by the project's own method, if it takes the problem, or by bisection: to within `PRECISION` then,
    up to `WIDEST`, and with all of them to blame.
    """
    names = frozenset(limit.name for limit in limits)
    if not problem.nonlinear and can_widen(problem):
        return least_widening(problem, names)

    def tried(factor: float) -> FloatArray | None:
        wider = problem
        for limit in limits:
            wider = wider.replaced(limit.wider(factor))
        return _feasible(wider, options)

    low, high = 1.0, 1.0 if (command := tried(1.0)) is not None else WIDEST
    if command is None and (command := tried(WIDEST)) is None:
        return None
    while high / low > 1 + PRECISION:
        middle = float(np.sqrt(low * high))
        nearer = tried(middle)
        if nearer is None:
            low = middle
        else:
            high, command = middle, nearer
    return Widening(high, command, names)


def _alone(problem: TransientProblem, limit: Limit, together: Widening, options: SolverOptions) -> Widening | None:
    """The least factor for one of the limits that were widened together."""
    if can_widen(problem):
        return alone(problem, limit.name, together)
    return _least_widening(problem, [limit], options)


def _sentence(problem: TransientProblem, limit: Limit, command: FloatArray) -> str:
    return f"{farthest_out(Effect(problem, command), limit).missed(problem.grid)} at the least"


def _bound(box: Box, by: float = 0.0, digits: int = 8) -> str:
    """The bound at which a row is farthest out, raised by so much, with its unit, as its scene key states it."""
    return f"{box.limit.written(by, lower=box.below):.{digits}g} {box.limit.key_unit()}"
