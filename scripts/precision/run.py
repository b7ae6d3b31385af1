"""Measuring: every setting of every method on one case, in turns, judged afterwards."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from common.measuring import elapsed_ms, forget, take_turns, threads

from precision.cases import FAILED, Case, Verdict, judge, replayed_tap_errors
from precision.methods import TIME_LIMIT_S, Answer, Kind, Method, Prepared, Setting, error_line, failed
from transopt.base.signals import FloatArray
from transopt.proof.certify import certify
from transopt.solvers import program
from transopt.solvers.shape import program_shape

MOST_A = 1e3  # commands beyond this are not worth a replay


@dataclass(frozen=True)
class Row:
    """One point of a work-precision diagram.

    Attributes
    ----------
    kind, level : values of `methods.Kind` and `Level`. tolerance : NaN for a method's own defaults.
    setup_ms : what is done once per shape. solve_ms, q25_ms, q75_ms : median and quartiles of `runs`.
    gap, violation, error : `cases.Verdict`, relative. tap_error_excess : tap error after replay less the reference's.
    certificate : relative duality gap by the method's own multipliers; NaN where it gives none.
    reference : one of the two that the error is measured from: that it has none, or almost none, says nothing.
    """

    case: str
    method: str
    kind: str
    level: str
    version: str
    options: str
    tolerance: float
    iterations: int
    status: str
    setup_ms: float
    solve_ms: float
    q25_ms: float
    q75_ms: float
    runs: int
    threads: int
    gap: float
    violation: float
    tap_error_excess: float
    error: float
    certificate: float
    reference: bool = False


@dataclass(frozen=True)
class Effort:
    """How long each setting is measured: so many runs as fit into `budget_ms`, between `least` and `most`."""

    budget_ms: float = 400.0
    least: int = 3
    most: int = 15

    def runs(self, one_ms: float) -> int:
        return int(np.clip(self.budget_ms / max(one_ms, 1e-3), self.least, self.most))


def set_up_and_run_ms(run: Callable[[], object]) -> tuple[float, float]:
    """What the first of two runs takes longer, which belongs to the set-up, and what the second one takes."""
    first_ms = elapsed_ms(run)
    # Once more even if it was late: the set-up may have been, or the machine.
    second_ms = first_ms if first_ms > 10e3 * TIME_LIMIT_S else elapsed_ms(run)
    return max(first_ms - second_ms, 0.0), second_ms


def time_columns(times_ms: FloatArray, setup_ms: float) -> dict[str, Any]:
    """Columns of a row that tell of time."""
    q25, median, q75 = (float(value) for value in np.percentile(times_ms, [25, 50, 75]))
    spread = {"solve_ms": median, "q25_ms": q25, "q75_ms": q75}
    return {"setup_ms": setup_ms, **spread, "runs": int(times_ms.size), "threads": threads()}


class Attempt:
    """One setting of one method: its run, the last answer, and what went wrong if anything did."""

    def __init__(self, case: Case, method: Method, setting: Setting) -> None:
        self.case, self.method, self.setting = case, method, setting
        self.prepared: Prepared | None = None
        self.returned: object = None
        self.error = ""
        self.setup_ms = self.first_ms = float("nan")

    def run(self) -> None:
        if self.error or self.prepared is None:
            return
        try:
            self.returned = self.prepared.run()
        # Whatever a method raises is an answer about that method.
        except Exception as error:
            self.error = error_line(error)

    def start(self) -> None:
        """Prepare and run twice: what the first run takes longer belongs to the set-up."""
        # The project's set-up includes its statement.
        program.state_program.cache_clear()
        begun = time.perf_counter()
        try:
            self.prepared = self.method.prepare(self.case, self.setting)
        except Exception as error:
            self.error = error_line(error)
            return
        prepared_ms = 1e3 * (time.perf_counter() - begun)
        more_ms, self.first_ms = set_up_and_run_ms(self.run)
        self.setup_ms = prepared_ms + more_ms

    @property
    def late(self) -> bool:
        return self.first_ms > 1e3 * TIME_LIMIT_S

    def answer(self) -> Answer:
        if self.error or self.prepared is None:
            return failed(self.case, self.error)
        try:
            return self.prepared.read(self.returned)
        except Exception as error:
            return failed(self.case, error_line(error))


def measure(
    case: Case,
    methods: Sequence[Method],
    effort: Effort,
    *,
    told: Callable[[str, float], None] = lambda text, steps: None,
) -> list[Row]:
    """Rows of every setting that can take the case.

    Parameters
    ----------
    told : called with what is being done and the steps just finished; two for each setting in all.
    """
    forget()
    attempts = [Attempt(case, method, setting) for method in methods for setting in method.settings(case)]
    for attempt in attempts:
        told(f"{case.name}: {attempt.method.name}", 0)
        attempt.start()
        told(f"{case.name}: {attempt.method.name}", 1)
    timed = {str(j): attempt for j, attempt in enumerate(attempts) if not attempt.error and not attempt.late}
    runs = {name: effort.runs(attempt.first_ms) for name, attempt in timed.items()}
    program.state_program(program_shape(case.small))
    share = len(attempts) / max(sum(runs.values()), 1)
    times = take_turns(
        {name: attempt.run for name, attempt in timed.items()},
        runs,
        lambda: told(f"{case.name}: taking turns", share),
    )
    answers = [attempt.answer() for attempt in attempts]
    excesses = tap_error_excesses(case, [answer.command_A for answer in answers])
    return [
        _row(attempt, answer, times.get(str(j), np.array([attempt.first_ms])), excess)
        for j, (attempt, answer, excess) in enumerate(zip(attempts, answers, excesses, strict=True))
    ]


def tap_error_excesses(case: Case, commands_A: Sequence[FloatArray]) -> FloatArray:
    """Tap errors after replay less the reference's, infinite for commands that are none."""
    found = np.full(len(commands_A), np.inf)
    shape = case.problem.reference_m_s2.shape
    sane = [j for j, c in enumerate(commands_A) if c.shape == shape and np.all(np.abs(c) < MOST_A)]
    if sane:
        found[sane] = (
            replayed_tap_errors(case.problem, np.stack([commands_A[j] for j in sane])) - case.optimum.tap_error
        )
    return found


def _row(attempt: Attempt, answer: Answer, times_ms: FloatArray, excess: float) -> Row:
    case, method, setting = attempt.case, attempt.method, attempt.setting
    verdict: Verdict = judge(case.problem, answer.command_A, case.optimum.objective)
    if attempt.late:
        verdict = FAILED
    certificate = float("nan")
    if answer.multipliers is not None:
        certificate = certify(case.small, answer.command_A, answer.multipliers).relative_gap
    return Row(
        case=case.name,
        method=method.name,
        kind=method.kind.value,
        level=setting.level.value,
        version=method.version,
        options=setting.options,
        tolerance=setting.tolerance,
        iterations=answer.iterations,
        status=f"time limit of {TIME_LIMIT_S:g} s" if attempt.late else answer.status,
        gap=verdict.gap,
        violation=verdict.violation,
        tap_error_excess=float("inf") if verdict is FAILED else float(excess),
        error=verdict.error,
        certificate=certificate,
        reference=method.kind is Kind.SOLVER and case.optimum.is_reference(method.name, setting.tolerance),
        **time_columns(times_ms, attempt.setup_ms),
    )
