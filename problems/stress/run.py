"""Run the stress suite in worker processes and say how it went.

The workers import this module by its name, which `__main__` would not let them.

Every case has to end in one of two ways: a certified, cleanly replayed optimum, or a refusal that names its cause.
Anything else, a warning, a NaN, a hang and the death of a worker included, is bad and makes the exit code 1.
"""

import argparse
import math
import multiprocessing
import os
import signal
import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing import connection, resource_tracker
from multiprocessing.process import BaseProcess
from time import monotonic
from typing import NoReturn

from rich.console import Console
from rich.progress import MofNCompleteColumn, Progress, TimeRemainingColumn
from rich.table import Table

from problems.stress.cases import StressCase
from problems.stress.draw import drawn
from problems.stress.families import directed, long_cases
from problems.stress.judge import CERTIFIED, Outcome, judge
from transopt.base import terminal
from transopt.base.errors import InputError
from transopt.base.files import ctrl_c_waits

LIMIT_S = 120.0  # per case; the slowest honest one takes a fraction of it
START_S = 120.0  # for a worker to be there
LAST_WORDS_S = 5.0  # between a closed pipe and an exit code
READY = "ready"
LOG_EVERY = 50  # cases, where there is no terminal for the progress bar
ONE_THREAD = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


def _worker(pipe: connection.Connection, outcome_of: Callable[[StressCase], Outcome]) -> None:
    """Answer cases as they come; what a library prints by itself makes an outcome bad, as a warning would."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the parent's, which ends the workers
    with tempfile.TemporaryFile() as printed:
        for stream in (1, 2):
            os.dup2(printed.fileno(), stream)
        pipe.send(READY)
        while True:
            try:
                case = pipe.recv()
            except EOFError:
                return
            outcome = outcome_of(case)
            sys.stdout.flush()
            sys.stderr.flush()
            if printed.seek(0, os.SEEK_END):
                printed.seek(0)
                said = " ".join(printed.read().decode(errors="replace").split())[:200]
                printed.seek(0)
                printed.truncate()
                if not outcome.bad:
                    outcome = _lost("bad: printed", said, outcome.elapsed_s)
            pipe.send(outcome)


@dataclass
class _Slot:
    """One worker process.

    Attributes
    ----------
    process, pipe : the worker, and how to talk with it.
    index : of the case that it has, or gets as soon as it is ready.
    deadline : until when it may be silent, on the monotonic clock.
    started : whether it has said that it is ready.
    lost : whether it has died or been silent for too long.
    """

    process: BaseProcess
    pipe: connection.Connection
    index: int
    deadline: float
    started: bool = False
    lost: bool = False

    def give(self, index: int, case: StressCase, limit_s: float) -> None:
        """Hand over a case; `hear` finds a worker that has died meanwhile."""
        self.index, self.deadline = index, monotonic() + limit_s
        with suppress(OSError):
            self.pipe.send(case)

    def hear(self, speaks: bool, limit_s: float) -> Outcome | str | None:
        """`READY`, the outcome of its case, or None as long as it may be silent; a dead or late worker is lost."""
        if speaks:
            try:
                said: Outcome | str = self.pipe.recv()
            except (EOFError, OSError):
                self.lost = True
                self.process.join(LAST_WORDS_S)
                when = "" if self.started else " while it started"
                return _lost("bad: worker died", f"exit code {self.process.exitcode}{when}", limit_s)
            self.started = True
            return said
        if monotonic() < self.deadline:
            return None
        self.lost = True
        if self.started:
            return _lost("bad: hang", f"no answer within {limit_s:g} s", limit_s)
        return _lost("bad: worker did not start", f"not ready within {START_S:g} s", START_S)


def run_cases(
    cases: Sequence[StressCase],
    jobs: int,
    limit_s: float = LIMIT_S,
    outcome_of: Callable[[StressCase], Outcome] = judge,
) -> Iterator[tuple[int, Outcome]]:
    """Index and outcome of every case, each in one of `jobs` processes, in the order in which they end.

    A worker that takes longer than `limit_s`, or `START_S` to start, is killed and one that dies is replaced: all of
    these are outcomes of the case that it had or was to get.
    """
    context = multiprocessing.get_context("spawn")
    resource_tracker.ensure_running()  # if it were started with a worker, it would let a Ctrl-C through to it
    waiting = list(range(len(cases)))[::-1]
    slots: list[_Slot] = []

    def start(index: int) -> _Slot:
        ours, theirs = context.Pipe()
        process = context.Process(target=_worker, args=(theirs, outcome_of), daemon=True)
        with ctrl_c_waits():
            process.start()
        theirs.close()
        return _Slot(process, ours, index, monotonic() + START_S)

    try:
        while waiting or slots:
            while waiting and len(slots) < jobs:
                slots.append(start(waiting.pop()))
            timeout = max(min(slot.deadline for slot in slots) - monotonic(), 0.0)
            ready = connection.wait([slot.pipe for slot in slots], timeout)
            for slot in list(slots):
                index, found = slot.index, slot.hear(slot.pipe in ready, limit_s)
                if isinstance(found, str):
                    # The case's own time begins here: starting Python does not count.
                    slot.give(index, cases[index], limit_s)
                elif found is not None:
                    if waiting and not slot.lost:
                        following = waiting.pop()
                        slot.give(following, cases[following], limit_s)
                    else:
                        slots.remove(slot)
                        _end(slot)
                    yield index, found
    finally:
        for slot in slots:
            _end(slot)


def _end(slot: _Slot) -> None:
    slot.pipe.close()
    slot.process.kill()
    slot.process.join()


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


class _Parser(argparse.ArgumentParser):
    def error(self, message: str) -> NoReturn:
        """Raise what argparse found as an error of one line."""
        raise InputError(f"{message.removeprefix('argument ')}; see --help")


def _at_least(lowest: int, kind: Callable[[str], float]) -> Callable[[str], float]:
    """A type for argparse: numbers of a kind, from `lowest` on."""

    def parsed(text: str) -> float:
        try:
            value = kind(text)
        except ValueError:
            value = math.nan
        if not lowest <= value < math.inf:
            named = "a whole number" if kind is int else "a number"
            raise argparse.ArgumentTypeError(f"{text} must be {named}, at least {lowest}")
        return value

    return parsed


def _parser() -> argparse.ArgumentParser:
    parser = _Parser("python -m problems.stress", description=main.__doc__, allow_abbrev=False)
    parser.add_argument("--cases", type=_at_least(1, int), default=1000, help="random cases (1000)")
    parser.add_argument("--seed", type=_at_least(0, int), default=1, help="of the random cases (1)")
    parser.add_argument("--jobs", type=_at_least(1, int), default=os.cpu_count() or 1, help="worker processes")
    parser.add_argument("--case", type=_at_least(0, int), help="only the case of this index, in every detail")
    parser.add_argument("--directed", action="store_true", help="the directed families in place of random cases")
    parser.add_argument(
        "--limit-s", type=_at_least(1, float), default=LIMIT_S, help=f"seconds that one case may take ({LIMIT_S:g})"
    )
    return parser


def main(arguments: Sequence[str] | None = None) -> int:
    """Judge hard cases: each ends certified or refused by name, or the exit code is 1."""
    options = _parser().parse_args(arguments)
    families, seed, case = options.directed, options.seed, options.case
    chosen = [*directed(), *long_cases()] if families else [drawn(seed, index) for index in range(options.cases)]
    command = "python -m problems.stress " + ("--directed" if families else f"--seed {seed}")
    output = terminal.console()
    if case is not None:
        one = chosen[case] if families and case < len(chosen) else drawn(seed, case)
        if families and case >= len(chosen):
            raise InputError(f"--case {case}: there are {len(chosen)} directed cases, from 0 on")
        found = judge(one)
        output.print(f"{one}\n{one!r}\n{found.kind} in {found.elapsed_s:.1f} s: {found.detail}", soft_wrap=True)
        if found.kind == CERTIFIED:
            output.print(f"gap {found.gap:.1e}, replay difference {found.difference:.1e}")
        return int(found.bad)
    for variable in ONE_THREAD:
        os.environ.setdefault(variable, "1")
    outcomes: dict[int, Outcome] = {}
    columns = (*Progress.get_default_columns()[:2], MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as progress:
        task = progress.add_task("stress", total=len(chosen))
        for index, outcome in run_cases(chosen, options.jobs, options.limit_s):
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
    return int(any(outcome.bad for outcome in outcomes.values()))
