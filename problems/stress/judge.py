"""How a stress case ends: certified and replayed clean, or refused by the name of its cause; all else is bad."""

import re
import time
import traceback
import warnings
from dataclasses import dataclass, fields, replace

import numpy as np

from problems.stress.cases import StressCase
from problems.stress.oracle import admits_a_command
from transopt.base.errors import InputError
from transopt.design.design import design
from transopt.design.entry import Entry
from transopt.design.explain import what_would_do
from transopt.design.remedy import remedies
from transopt.problem.answer import Certificate, Multipliers, Status
from transopt.problem.problem import TransientProblem
from transopt.proof.admit import admit
from transopt.proof.designed import Designed
from transopt.proof.replay import Replay, replay
from transopt.solvers.options import SolverOptions

CERTIFIED = "certified"
UNCHECKED = ", unchecked"  # a claim that no command keeps all limits, which the independent method could not decide
# Refusals that may stand, by what their remarks must name: a limit with amount and unit.
REMARKS = {
    Status.INFEASIBLE: r"(coil|supply|slew|command|current)\b.*\d.* (A|V|C|K)\b|coil: no steady state|"
    r"proven that no command",
    Status.HAND_OVER: r"hand-over: .*\d.* A.* limit ",
    Status.PRECISION: r"precision: the gap of .*",
    Status.UNSTABLE_WALL: r"feedback: .*grows \d.* per tick, with feedback",
    Status.UNRESOLVED: r"(coil|supply|stroke|velocity|coil current) \d.* (K|V|m|m/s|A) over its .*: time.dt_s = \d",
    Status.NOT_GLOBAL: r"J lies .*% above the convex lower bound",
}
# A field, its value, and what it must be.
INPUT = r"^[A-Za-z][\w. :-]*\b.*(must|expected|not finite|lower it|above|choose|has shape)"


@dataclass(frozen=True)
class Outcome:
    """How one case ended.

    Attributes
    ----------
    kind : `CERTIFIED`, "refused: ..." by its name, or "bad: ...".
    detail : the message or the shortfall.
    gap : bound on J - optimum over max(J, 1e-3).
    difference : between replayed and predicted acceleration over the peak; this and `gap` are NaN unless certified.
    elapsed_s : for building, solving and replaying.
    """

    kind: str
    detail: str
    gap: float
    difference: float
    elapsed_s: float

    @property
    def bad(self) -> bool:
        """Whether the case ended in neither of the two ways that it may."""
        return self.kind.startswith("bad")


def played(problem: TransientProblem, command_A: np.ndarray) -> Replay:
    """The replay of one command (N,) [A] as a library's entry gets it."""
    thermal, wall = problem.thermal, problem.wall
    (run,) = replay(
        problem.stage,
        problem.grid,
        problem.transient_command(command_A)[None],
        [problem.target],
        None if thermal is None else thermal.coil,
        limits=[problem.limits],
        walls=None if wall is None else [wall],
        budgets=None if thermal is None else [thermal.budget],
        spread=problem.spread,
    )
    return run


def _numbers(result: Designed | Certificate | Multipliers | Replay, but: tuple[str, ...] = ()) -> bool:
    """Whether every number in the fields of a result, but those named, is finite."""
    values = [getattr(result, field.name) for field in fields(result) if field.name not in but]
    if isinstance(result, Multipliers):
        values += result.arrays()
    return all(bool(np.all(np.isfinite(v))) for v in values if isinstance(v, float | np.ndarray))


def judge_design(designed: Designed, run: Replay) -> Outcome:
    """How an answer and its replay end; `elapsed_s` is 0, the caller's to fill in."""
    problem, solution, proof = designed.problem, designed.solution, designed.certificate
    nothing = float("nan")
    predicted, _ = problem.stage.rollout(solution.command)
    status, shortfalls = admit(designed, run)
    said = "; ".join(shortfalls)
    if status is Status.OPTIMAL:
        # Beside a tap that is zero over the intention any motion is infinitely wrong: that of the wall alone, or of a
        # tap that begins later. A window may end before contact, too.
        any_motion = problem.yardstick.tap_error(problem.target, np.ones(predicted.shape[-1]))
        whole = _numbers(designed, ("floor",)) and _numbers(proof) and _numbers(solution.multipliers)
        whole = whole and _numbers(run, ("winding_C", "housing_C"))
        if 0 < any_motion < np.inf:
            told = designed.floor, run.figures.tap_error, run.figures.error_after
            whole = whole and bool(np.all(np.isfinite(told)))
        if not (whole and np.all(np.isfinite(solution.command))):
            return Outcome("bad: NaN", "a figure of a certified answer is not finite", nothing, nothing, 0.0)
        if not np.all(np.isfinite(list(run.reached.values()))):
            return Outcome("bad: NaN", "a largest value of a certified answer", nothing, nothing, 0.0)
        if problem.thermal is not None and not (np.isfinite(run.winding_C) and np.isfinite(run.housing_C)):
            return Outcome("bad: NaN", "temperature of a certified answer", nothing, nothing, 0.0)
        attained = designed.attained
        # If the temperature or a wall is in it the path may jump over what is asked for.
        smooth = problem.thermal is None and problem.wall is None
        if attained is not None and smooth and attained.is_stray:
            return Outcome("bad: intensity", attained.sentence, nothing, nothing, 0.0)
        difference = float(np.abs(run.acceleration_m_s2 - predicted).max()) / run.scale_m_s2
        return Outcome(CERTIFIED, solution.solver, proof.relative_gap, difference, 0.0)
    if status not in REMARKS or not re.search(REMARKS[status], said):
        return Outcome(
            f"bad: {status.name}", f"{said} ({solution.solver}: {solution.message})", nothing, nothing, 0.0
        )
    # The other causes are facts of one replay or of the wall alone, not claims about all commands.
    unchecked = ""
    if status is Status.INFEASIBLE or (status is Status.HAND_OVER and "K_p z" in said):
        # A linear limit that is blamed has to fail without the temperature as well.
        linear = any(not remark.startswith("coil") for remark in designed.remarks)
        verdict = admits_a_command(problem, ignoring_heat=linear)
        if verdict.way_out:
            return Outcome("bad: feasible after all", f"{verdict.way_out}, but {said}", nothing, nothing, 0.0)
        unchecked = "" if verdict.decided else UNCHECKED
    return Outcome(f"refused: {status.name}{unchecked}", said, nothing, nothing, 0.0)


def with_remedy(case: StressCase, entry: Entry, found: Outcome) -> Outcome:
    """A refusal with what would do, or bad where nothing was found that does."""
    if not found.kind.startswith("refused"):
        return found
    own = remedies(case, entry, SolverOptions())
    kind = found.kind if any(remedy.solved for remedy in own) else "bad: no remedy"
    return replace(found, kind=kind, detail=f"{found.detail}; {what_would_do(own)}")


def judge(case: StressCase) -> Outcome:
    """Build, solve and replay one case, and say how it ended.

    Warnings and exceptions are bad outcomes; none is passed on.
    """
    start = time.perf_counter()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        try:
            (entry,) = design([case.posed()])
            found = with_remedy(case, entry, judge_design(entry.designed, entry.played))
        except InputError as error:
            named = re.search(INPUT, str(error)) is not None
            field = re.split(r"[ =]", str(error))[0].rstrip(":")
            kind = f"refused: input {field}" if named else "bad: input without a field"
            found = Outcome(kind, str(error), float("nan"), float("nan"), 0.0)
        except Warning as warning:
            found = Outcome(f"bad: {type(warning).__name__}", _where(warning), float("nan"), float("nan"), 0.0)
        except Exception as error:
            found = Outcome(f"bad: {type(error).__name__}", _where(error), float("nan"), float("nan"), 0.0)
    return replace(found, elapsed_s=time.perf_counter() - start)


def _where(error: BaseException) -> str:
    """Message and innermost places of an exception in one line."""
    last = traceback.extract_tb(error.__traceback__)
    places = [f"{frame.filename.rsplit('/', 1)[-1]}:{frame.lineno}" for frame in last[-3:]]
    return f"{str(error)[:200]} at {' < '.join(reversed(places))}"
