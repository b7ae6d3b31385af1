"""Runs the stress suite in worker processes and summarises the outcomes.

Every case has to end in one of two ways: an optimum that is certified and replayed within its limits, or a refusal
that names its cause. Anything else is bad and makes the exit code 1: a warning, NaN, a hang, a worker that dies.
"""

import os
import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Future, wait
from time import monotonic

from rich.table import Table

from problems.stress.cases import StressCase
from problems.stress.judge import Outcome, judge
from transopt.base.apart import Processes


def _quietly(outcome_of: Callable[[StressCase], Outcome], case: StressCase) -> Outcome:
    """Judge a case in a worker; output printed by a library makes the outcome bad, as a warning does."""
    with tempfile.TemporaryFile() as printed:
        for stream in (1, 2):
            os.dup2(printed.fileno(), stream)
        outcome = outcome_of(case)
        sys.stdout.flush()
        sys.stderr.flush()
        printed.seek(0)
        said = " ".join(printed.read().decode(errors="replace").split())[:200]
    return _lost("bad: printed", said, outcome.elapsed_s) if said and not outcome.bad else outcome


def _answer(future: "Future[Outcome]", limit_s: float) -> Outcome:
    """The outcome of a case whose worker has answered, has died, or is late."""
    if not future.done():
        return _lost("bad: hang", f"no answer within {limit_s:g} s", limit_s)
    try:
        return future.result()
    except BrokenExecutor as death:
        return _lost("bad: worker died", str(death), limit_s)


def run_cases(
    cases: Sequence[StressCase],
    jobs: int,
    limit_s: float,
    outcome_of: Callable[[StressCase], Outcome] = judge,
) -> Iterator[tuple[int, Outcome]]:
    """Index and outcome of every case in the order in which they end, run by `jobs` processes.

    A worker that takes longer than `limit_s`, its start included, is killed, and one that dies is replaced; both are
    bad outcomes of its case.
    """
    waiting = iter(enumerate(cases))
    # Each running case: its index, its worker, and the worker's deadline.
    busy: dict[Future[Outcome], tuple[int, Processes, float]] = {}

    def give(worker: Processes) -> None:
        index, case = next(waiting, (None, None))
        if index is None or case is None:
            worker.shutdown(wait=False)
        else:
            busy[worker.submit(_quietly, outcome_of, case)] = (index, worker, monotonic() + limit_s)

    try:
        for _ in range(jobs):
            give(Processes(1))
        while busy:
            wait(busy, max(min(end for *_, end in busy.values()) - monotonic(), 0.0), FIRST_COMPLETED)
            for future, (index, worker, end) in list(busy.items()):
                if future.done() or monotonic() >= end:
                    del busy[future]
                    outcome = _answer(future, limit_s)
                    if not future.done():
                        worker.shutdown(wait=False)
                    give(worker if future.done() else Processes(1))
                    yield index, outcome
    finally:
        for _, worker, _ in busy.values():
            worker.shutdown(wait=False)


def _lost(kind: str, detail: str, elapsed_s: float) -> Outcome:
    return Outcome(kind, detail, float("nan"), float("nan"), elapsed_s)


def summary(cases: Sequence[StressCase], outcomes: dict[int, Outcome], command: str) -> tuple[Table, list[str]]:
    """A table of the number of cases by outcome, and the lines below it."""
    table = Table(title=f"{len(cases)} cases")
    table.add_column("outcome")
    table.add_column("cases", justify="right")
    counts = Counter(outcome.kind for outcome in outcomes.values())
    for kind, count in sorted(counts.items(), key=lambda item: (item[0].startswith("bad"), item[0])):
        table.add_row(kind, str(count))
    certified = [outcome for outcome in outcomes.values() if outcome.certified]
    lines = []
    if certified:
        lines.append(f"worst gap {max(o.gap for o in certified):.1e} of max(J, 1e-3)")
        lines.append(f"worst replay difference {max(o.difference for o in certified):.1e} of the peak")
    slowest = max(outcomes, key=lambda index: outcomes[index].elapsed_s)
    lines.append(f"slowest case {slowest}: {outcomes[slowest].elapsed_s:.1f} s, {cases[slowest]}")
    for index in sorted(index for index, outcome in outcomes.items() if outcome.bad):
        bad = outcomes[index]
        lines.append(f"{bad.kind}: {cases[index]}: {bad.detail}")
        lines.append(f"    {command} --case {index}")
    return table, lines
