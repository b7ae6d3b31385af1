"""What a problem does not need: limits that no admissible command can reach."""

from dataclasses import dataclass, replace

from transopt.plant.discretise import StageModel, discretise
from transopt.problem.problem import TransientProblem


@dataclass(frozen=True)
class Reduced:
    """A smaller problem with the same answer, and part -> why it may be missing."""

    problem: TransientProblem
    left_out: dict[str, str]


def leave_out(problem: TransientProblem) -> Reduced:
    """The problem without the limits, and without the rows of limits, that cannot matter, each with its proof."""
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
    """Leave out the encoder's position, and the states of the device that only it depends on."""
    bare = discretise(stage.plant, stage.amplifier, stage.dt_s, outputs=tuple(stage.outputs))
    return bare.within(stage.instants)
