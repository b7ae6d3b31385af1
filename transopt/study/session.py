"""One study from its plan to sorted rows: resumed where it stopped, with progress and remaining time."""

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from transopt.design.sweep import Outcome
from transopt.study.axes import TOGETHER, Plan, Recorder
from transopt.study.inverse import Answer, Question, answer, plan_at
from transopt.study.rows import Row, Rows, row_of
from transopt.study.run import Pool, execute

MOST_VALUES = 200  # that a scan and a bisection can come to; sixty halvings exhaust a double
TOLD_S = 15.0  # between lines of progress where no terminal shows a bar

Tell = Callable[[int], None]


def definition(plan: Plan, takes: Recorder) -> dict[str, Any]:
    """What study.json says of a plan, beside the versions."""
    return {
        "scene": plan.scene.model_dump(mode="json"),
        "recordings_sha256": takes.taken({})[1],
        "axes": {
            axis.key: {"values": list(axis.labels), "limits": axis.limits, "log": axis.log} for axis in plan.axes
        },
        "sample": plan.sample,
        "seed": None if plan.sample is None else plan.seed,
        "speeds_m_s": list(plan.speeds_m_s),
        "grips_N": list(plan.grips_N),
        "full": plan.rivals,
        "solver": asdict(plan.options),
        "together": TOGETHER,
    }


@contextmanager
def progress(name: str, total: int, done: int) -> Iterator[Tell]:
    """A bar on the terminal, or a line now and then; `done` were there before."""
    if not sys.stderr.isatty():
        started = last = time.perf_counter()
        now = done

        def tell(count: int) -> None:
            nonlocal now, last
            now += count
            if (moment := time.perf_counter()) - last > TOLD_S:
                last = moment
                left_s = (moment - started) / max(now - done, 1) * (total - now)
                print(f"{name}: {now} of {total} entries, {left_s:.0f} s to go", file=sys.stderr, flush=True)

        yield tell
        return
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with Progress(*columns, TimeRemainingColumn(), console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(name, total=total, completed=done)
        yield lambda count: bar.advance(task, count)


def run_plan(
    plan: Plan, folder: Path, pool: Pool, *, name: str = "entries", watch: Callable[[int], None] = lambda done: None
) -> list[Row]:
    """Solve what a folder lacks of a plan.

    Parameters
    ----------
    watch : called with the number of rows after every task.

    Returns
    -------
    All rows, sorted: the same whatever the executor and however often the run was stopped, but for the times.

    Raises
    ------
    InputError : the folder holds another study, or the workers are gone. KeyboardInterrupt : stopped.
    """
    keys, takes = [axis.key for axis in plan.axes], Recorder(plan.scene, plan.axes)
    with Rows(folder, definition(plan, takes), keys, plan.entries) as rows:
        if rows.cut:
            print(rows.cut, file=sys.stderr)
        with progress(name, plan.entries, rows.done) as tell:

            def write(outcomes: list[Outcome]) -> None:
                points = [plan.point_of(outcome.index) for outcome in outcomes]
                tell(rows.add([row_of(o, p, plan.labels(p)) for o, p in zip(outcomes, points, strict=True)]))
                watch(rows.done)

            try:
                execute(pool, plan.tasks(rows.has, takes), write)
            except KeyboardInterrupt:
                raise KeyboardInterrupt(_stopped(rows, plan.entries)) from None
        return rows.sort()


def _stopped(rows: Rows, total: int) -> str:
    of = f" of {total}" if total else ""
    return f"stopped: {rows.done}{of} entries are in {rows.path}; the same command goes on from there"


def run_question(plan: Plan, question: Question, folder: Path, pool: Pool) -> Answer:
    """Solve what a folder lacks for an answer: the same values in the same order however often it was stopped.

    Raises
    ------
    InputError : the folder holds another study, or the workers are gone. KeyboardInterrupt : stopped.
    """
    ends = plan_at(plan, question, [question.low, question.high])
    takes = Recorder(plan.scene, ends.axes)
    about = {
        "solve_for": {
            "key": question.key.path,
            "low": question.low,
            "high": question.high,
            "tolerance": question.tolerance,
            "greatest": question.greatest,
        },
        "require": [requirement.text for requirement in question.requirements],
    }
    per_value, values = plan.entries_per_point, 0
    with Rows(folder, {**definition(ends, takes), **about}, [question.key.path], MOST_VALUES * per_value) as rows:
        if rows.cut:
            print(rows.cut, file=sys.stderr)

        def solve(new: list[float]) -> list[list[Row]]:
            nonlocal values
            own, first = plan_at(plan, question, new), values * per_value
            values += len(new)
            lacking = sum(not rows.has(first + j) for j in range(own.entries))
            with progress(f"{question.key.path}, {values} values", own.entries, own.entries - lacking) as tell:

                def write(outcomes: list[Outcome]) -> None:
                    found = []
                    for outcome in outcomes:
                        p = own.point_of(outcome.index)
                        moved = replace(outcome, index=outcome.index + first)
                        found.append(row_of(moved, moved.index // per_value, own.labels(p)))
                    tell(rows.add(found))

                execute(pool, own.tasks(lambda index: rows.has(index + first), takes), write)
            wanted = range(first, first + own.entries)
            there = {int(row["index"]): row for row in rows.read() if int(row["index"]) in wanted}
            return [[there[first + j * per_value + k] for k in range(per_value)] for j in range(len(new))]

        try:
            found = answer(question, solve)
        except KeyboardInterrupt:
            raise KeyboardInterrupt(_stopped(rows, 0)) from None
        rows.sort()
        return found
