"""Removal of the limits of a problem that no admissible command can reach."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

from transopt.plant.discretise import StageModel, discretise
from transopt.problem.problem import BESIDES_THE_TARGET, TransientProblem


@dataclass(frozen=True)
class Reduced:
    """A smaller problem with the same optimum.

    Attributes
    ----------
    left_out : removed part -> the bound that proves it redundant, in words.
    """

    problem: TransientProblem
    left_out: dict[str, str]


def leave_out_all(problems: Sequence[TransientProblem]) -> list[Reduced]:
    """`leave_out` of several problems, once for those under the same limits without a wall."""
    known, found = dict[tuple[int, ...], Reduced](), list[Reduced]()
    for problem in problems:
        alike = known.get(key := tuple(map(id, BESIDES_THE_TARGET(problem))))
        if alike is None or problem.wall is not None:
            found.append(leave_out(problem))
            known[key] = found[-1]
        else:
            found.append(Reduced(alike.problem.aiming_as(problem), alike.left_out))
    return found


def leave_out(problem: TransientProblem) -> Reduced:
    """Remove every limit, and every row of a limit, that is proven redundant."""
    reasons = dict[str, str]()
    for limit in problem.limits:
        reason = limit.cannot_bind(problem)
        if reason:
            reasons[limit.name] = reason
            problem = problem.without(limit.name)
            continue
        needed, of_rows = limit.needed(problem)
        if of_rows:
            reasons |= of_rows
            problem = problem.replaced(needed)
    if problem.wall is not None and not problem.wall.pressing[max(problem.free_stages - 1, 0) :].any():
        reasons["feedback"] = "the stylus is above the surface from the hand-over on: the wall asks for nothing there"
        problem = replace(problem, wall=None, stage=without_position(problem.stage))
    return Reduced(problem, reasons)


def without_position(stage: StageModel) -> StageModel:
    """The stage model without the encoder's position and without the states that only this output needs."""
    bare = discretise(stage.plant, stage.amplifier, stage.dt_s, outputs=tuple(stage.outputs))
    return bare.within(stage.instants)
