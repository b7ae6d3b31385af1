"""Classifies the outcome of a stress case: certified and replayed, or refused with a named cause; all else is bad."""

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
WITHOUT_FLOOR = "certified, floor unknown"  # the optimum without limits was found by no method
UNCHECKED = ", unchecked"  # suffix of a claim of infeasibility that the independent method could not decide
# Refusals that may stand, by what their remarks must name: a limit with amount and unit.
REMARKS = {
    Status.INFEASIBLE: r"(coil|supply|slew|command|current)\b.*\d.* (A|V|C|K)\b|coil: no steady state|"
    r"proven that no command",
    Status.HAND_OVER: r"hand-over: .*\d.* A.* limit ",
    Status.PRECISION: r"precision: the gap of .*",
    Status.UNSTABLE_WALL: r"feedback: .*grows \d.* per tick, with feedback",
    Status.UNRESOLVED: r"(coil|supply|stroke|velocity|coil current) \d.* (K|V|m|m/s|A) over its limit .* "
    r"at time.dt_s = \d",
    Status.NOT_GLOBAL: r"J lies .*% above the convex lower bound",
}
# A field, its value, and what it must be.
INPUT = r"^[A-Za-z][\w. :-]*\b.*(must|expected|not finite|lower it|above|choose|has shape)"


@dataclass(frozen=True)
class Outcome:
    """The outcome of one case.

    Attributes
    ----------
    kind : `CERTIFIED`, `WITHOUT_FLOOR`, "refused: ..." with the cause, or "bad: ...".
    detail : the message or the shortfall.
    gap : bound on J - optimum over max(J, 1e-3); NaN unless certified.
    difference : difference of replayed and predicted acceleration over the peak; NaN unless certified.
    elapsed_s : time for building, solving and replaying.
    """

    kind: str
    detail: str
    gap: float
    difference: float
    elapsed_s: float

    @property
    def certified(self) -> bool:
        """Whether the case ended with a proven answer."""
        return self.kind in (CERTIFIED, WITHOUT_FLOOR)

    @property
    def bad(self) -> bool:
        """Whether the outcome is neither certified nor a named refusal."""
        return self.kind.startswith("bad")


def played(problem: TransientProblem, command_A: np.ndarray) -> Replay:
    """The replay of one command (N,) [A], as for an entry of a library."""
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
    """Whether all numbers in the fields of a result are finite, except for the named fields."""
    values = [getattr(result, field.name) for field in fields(result) if field.name not in but]
    if isinstance(result, Multipliers):
        values += result.arrays()
    return all(bool(np.all(np.isfinite(v))) for v in values if isinstance(v, float | np.ndarray))


def judge_design(designed: Designed, run: Replay) -> Outcome:
    """The outcome of an answer and its replay; the caller fills in `elapsed_s`."""
    problem, solution, proof = designed.problem, designed.solution, designed.certificate
    nothing = float("nan")
    predicted, _ = problem.stage.rollout(solution.command)
    status, shortfalls = admit(designed, run)
    said = "; ".join(shortfalls)
    if status is Status.OPTIMAL:
        # Relative to a tap of zero over the intention the error of any motion is infinite, as that of the wall alone
        # or of a tap that begins later. A window may also end before contact.
        made = np.ones_like(designed.effect.lasting.acceleration_m_s2)
        any_motion = problem.yardstick.tap_error(problem.target, made)
        whole = _numbers(designed, ("floor", "unlimited_objective")) and _numbers(proof)
        whole = whole and _numbers(solution.multipliers) and _numbers(run, ("winding_C", "housing_C"))
        whole = whole and bool(np.isnan(designed.floor) or np.isfinite(designed.unlimited_objective))
        if 0 < any_motion < np.inf:
            whole = whole and bool(np.all(np.isfinite((run.figures.tap_error, run.figures.error_after))))
            whole = whole and not np.isinf(designed.floor)
        if not (whole and np.all(np.isfinite(solution.command))):
            return Outcome("bad: NaN", "a figure of a certified answer is not finite", nothing, nothing, 0.0)
        if not np.all(np.isfinite(list(run.reached.values()))):
            return Outcome("bad: NaN", "a largest value of a certified answer", nothing, nothing, 0.0)
        if problem.thermal is not None and not (np.isfinite(run.winding_C) and np.isfinite(run.housing_C)):
            return Outcome("bad: NaN", "temperature of a certified answer", nothing, nothing, 0.0)
        attained = designed.attained
        # If there is a temperature limit or a wall, the energy may jump over the required one.
        smooth = problem.thermal is None and problem.wall is None
        if attained is not None and smooth and attained.is_stray:
            return Outcome("bad: intensity", attained.sentence, nothing, nothing, 0.0)
        difference = float(np.abs(run.acceleration_m_s2 - predicted).max()) / run.scale_m_s2
        kind = WITHOUT_FLOOR if np.isnan(designed.floor) and 0 < any_motion < np.inf else CERTIFIED
        return Outcome(kind, solution.solver, proof.relative_gap, difference, 0.0)
    if status not in REMARKS or not re.search(REMARKS[status], said):
        return Outcome(
            f"bad: {status.name}", f"{said} ({solution.solver}: {solution.message})", nothing, nothing, 0.0
        )
    # Other causes concern one replay or the wall alone, not all commands, so the oracle cannot contradict them.
    unchecked = ""
    if status is Status.INFEASIBLE or (status is Status.HAND_OVER and "K_p z" in said):
        # If a linear limit is named as the cause, the problem has to be infeasible without the temperature as well.
        linear = any(not remark.startswith("coil") for remark in designed.remarks)
        verdict = admits_a_command(problem, ignoring_heat=linear)
        if verdict.way_out:
            return Outcome("bad: feasible after all", f"{verdict.way_out}, but {said}", nothing, nothing, 0.0)
        unchecked = "" if verdict.decided else UNCHECKED
    return Outcome(f"refused: {status.name}{unchecked}", said, nothing, nothing, 0.0)


def with_remedy(case: StressCase, entry: Entry, found: Outcome) -> Outcome:
    """A refusal with its remedy in the detail; bad if no remedy was found."""
    if not found.kind.startswith("refused"):
        return found
    own = remedies(case, entry, SolverOptions())
    kind = found.kind if any(remedy.solved for remedy in own) else "bad: no remedy"
    return replace(found, kind=kind, detail=f"{found.detail}; {what_would_do(own)}")


def judge(case: StressCase) -> Outcome:
    """Build, solve and replay one case, and classify its outcome.

    Warnings and exceptions are bad outcomes and are not raised.
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
