"""Run the stress suite in worker processes and say how it went.

The workers import this module by its name, which `__main__` would not let them.

Every case has to end in one of two ways: a certified, cleanly replayed optimum, or a refusal that names its cause.
Anything else, a warning, a NaN, a hang and the death of a worker included, is bad and makes the exit code 1.
"""

import os
import secrets
import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Future, wait
from pathlib import Path
from time import monotonic
from typing import Annotated

from rich.console import Console
from rich.progress import MofNCompleteColumn, Progress, TimeRemainingColumn
from rich.table import Table
from typer import Option

from problems.stress.cases import StressCase
from problems.stress.draw import drawn
from problems.stress.families import directed, long_cases
from problems.stress.judge import CERTIFIED, Outcome, judge
from transopt.base import terminal
from transopt.base.errors import InputError
from transopt.base.writing import write_text
from transopt.study.executors import Processes

LIMIT_S = 120  # per case; the slowest honest one takes a fraction of it
SEEDS = 2**32  # as many as one is drawn from where none is stated
LOG_EVERY = 50  # cases, where there is no terminal for the progress bar


def _quietly(outcome_of: Callable[[StressCase], Outcome], case: StressCase) -> Outcome:
    """Judge a case in a worker; what a library prints by itself makes the outcome bad, as a warning would."""
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
    """What came of a case whose worker has answered, has died, or is late."""
    if not future.done():
        return _lost("bad: hang", f"no answer within {limit_s:g} s", limit_s)
    try:
        return future.result()
    except BrokenExecutor as death:
        return _lost("bad: worker died", str(death), limit_s)


def run_cases(
    cases: Sequence[StressCase],
    jobs: int,
    limit_s: float = LIMIT_S,
    outcome_of: Callable[[StressCase], Outcome] = judge,
) -> Iterator[tuple[int, Outcome]]:
    """Index and outcome of every case, each in one of `jobs` processes, in the order in which they end.

    A worker that takes longer than `limit_s`, its start included, is killed, and one that dies is replaced: both are
    outcomes of the case that it had.
    """
    waiting = iter(enumerate(cases))
    # Of each case under way: its index, the worker that has it, and until when that one may be silent.
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
    """Counts of each outcome as a table, and the lines below it."""
    table = Table(title=f"{len(cases)} cases")
    table.add_column("outcome")
    table.add_column("cases", justify="right")
    counts = Counter(outcome.kind for outcome in outcomes.values())
    for kind, count in sorted(counts.items(), key=lambda item: (item[0].startswith("bad"), item[0])):
        table.add_row(kind, str(count))
    certified = [outcome for outcome in outcomes.values() if outcome.kind == CERTIFIED]
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


def stress(
    cases: Annotated[int, Option(min=1, help="Random cases.")] = 1000,
    seed: Annotated[int | None, Option(min=0, help="Of the random cases; another one every time by default.")] = None,
    jobs: Annotated[int, Option(min=1, help="Worker processes.")] = os.cpu_count() or 1,
    case: Annotated[int | None, Option(min=0, help="Only the case of this index, in every detail.")] = None,
    families: Annotated[bool, Option("--directed", help="The directed families in place of random cases.")] = False,
    limit_s: Annotated[int, Option(min=1, help="Seconds that one case may take.")] = LIMIT_S,
    write: Annotated[Path | None, Option(help="File for the verdict on every case, a line each.")] = None,
) -> int:
    """Judge hard cases: each ends certified or refused by name, or the exit code is 1."""
    output = terminal.console()
    command = "python -m problems.stress"
    if families:
        command += " --directed"
        chosen = [*directed(), *long_cases()]
    else:
        seed = secrets.randbelow(SEEDS) if seed is None else seed
        output.print(f"seed {seed}, again by {command} --seed {seed} --cases {cases}", soft_wrap=True)
        command += f" --seed {seed}"
        chosen = [drawn(seed, index) for index in range(cases)]
    if case is not None:
        if families and case >= len(chosen):
            raise InputError(f"--case {case}: there are {len(chosen)} directed cases, from 0 on")
        one = chosen[case] if seed is None else drawn(seed, case)
        found = judge(one)
        output.print(f"{one}\n{one!r}\n{found.kind} in {found.elapsed_s:.1f} s: {found.detail}", soft_wrap=True)
        if found.kind == CERTIFIED:
            output.print(f"gap {found.gap:.1e}, replay difference {found.difference:.1e}")
        return int(found.bad)
    outcomes: dict[int, Outcome] = {}
    columns = (*Progress.get_default_columns()[:2], MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as progress:
        task = progress.add_task("stress", total=len(chosen))
        for index, outcome in run_cases(chosen, jobs, limit_s):
            outcomes[index] = outcome
            progress.advance(task)
            if not progress.console.is_terminal and len(outcomes) % LOG_EVERY == 0:
                progress.console.print(f"{len(outcomes)} of {len(chosen)} cases")
            if outcome.bad:
                progress.console.print(f"{command} --case {index}: {outcome.kind}", soft_wrap=True)
    table, lines = summary(chosen, outcomes, command)
    output.print(table)
    for line in lines:
        output.print(line, soft_wrap=True)
    if write is not None:
        write_text("".join(f"{index} {outcomes[index].kind}\n" for index in sorted(outcomes)), write)
    return int(any(outcome.bad for outcome in outcomes.values()))
