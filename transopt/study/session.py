"""One study from its plan to its rows: resumes where it stopped, shows progress and remaining time."""

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Any

from transopt.base import terminal
from transopt.study.executors import Pool
from transopt.study.inverse import Answer, Question, answer, plan_at
from transopt.study.plan import Plan
from transopt.study.recordings import StudyRecordings
from transopt.study.rows import Outcome, Row, row_of
from transopt.study.run import execute
from transopt.study.store import Store

MOST_VALUES = 200  # most values of a scan and a bisection; sixty halvings exhaust a double
LINE_S = 15.0  # time between lines of progress if there is no terminal for a bar

Advance = Callable[[int], None]


def definition(plan: Plan, recorded: StudyRecordings) -> dict[str, Any]:
    """Everything about a plan that its rows depend on, as JSON values."""
    return {
        "scene": plan.scene.model_dump(mode="json"),
        "recordings_sha256": recorded.of({})[1],
        "axes": {
            axis.key: {"values": list(axis.labels), "limits": axis.limits, "log": axis.log} for axis in plan.axes
        },
        "sample": plan.sample,
        "seed": None if plan.sample is None else plan.seed,
        "speeds_m_s": list(plan.speeds_m_s),
        "grips_N": list(plan.grips_N),
        "full": plan.rivals,
        "solver": asdict(plan.options),
        "together": plan.together,
    }


@contextmanager
def progress(name: str, total: int, done: int) -> Iterator[Advance]:
    """A progress bar on the terminal, or else lines at intervals; `done` entries exist already.

    Yields a function to call with the number of further entries.
    """
    if not sys.stderr.isatty():
        started = last = time.perf_counter()
        now = done

        def advance(count: int) -> None:
            nonlocal now, last
            now += count
            if (moment := time.perf_counter()) - last > LINE_S:
                last = moment
                left_s = (moment - started) / max(now - done, 1) * (total - now)
                print(f"{name}: {now} of {total} entries, {left_s:.0f} s to go", file=sys.stderr, flush=True)

        yield advance
        return
    with terminal.progress() as bar:
        task = bar.add_task(name, total=total, completed=done)
        yield lambda count: bar.advance(task, count)


@contextmanager
def _stop_reported(store: Store, total: int | None) -> Iterator[None]:
    """On a stop, print how far the study came and where its rows are kept."""
    try:
        yield
    except (KeyboardInterrupt, SystemExit):
        of = "" if total is None else f" of {total}"
        line = f"stopped: {store.done}{of} entries are in {store.path}; the same command goes on from there"
        print(line, file=sys.stderr)
        raise


def run_plan(
    plan: Plan, folder: Path, pool: Pool, *, name: str = "entries", watch: Callable[[int], None] = lambda done: None
) -> list[Row]:
    """Solve the rows of a plan that a folder lacks.

    Parameters
    ----------
    folder : receives study.sqlite, from which the study resumes, and rows.csv.
    name : shown beside the progress.
    watch : called with the number of rows after every task.

    Returns
    -------
    All rows by index. Apart from times they are equal for all executors, however often the run was stopped.

    Raises
    ------
    InputError : the folder holds another study or cannot be written, or the workers are gone.
    """
    keys, recorded = [axis.key for axis in plan.axes], StudyRecordings(plan.scene, plan.axes)
    with Store(folder, definition(plan, recorded), keys, plan.entries) as store:
        with _stop_reported(store, plan.entries), progress(name, plan.entries, store.done) as advance:

            def write(outcomes: list[Outcome]) -> None:
                points = [plan.point_of(outcome["index"]) for outcome in outcomes]
                advance(store.add([row_of(o, p, plan.labels(p)) for o, p in zip(outcomes, points, strict=True)]))
                watch(store.done)

            execute(pool, plan.tasks(store.has, recorded), write)
        return store.read()


def run_question(plan: Plan, question: Question, folder: Path, pool: Pool) -> Answer:
    """Solve what a folder lacks for an answer; a stopped run resumes with the same values in the same order.

    Raises
    ------
    InputError : see `run_plan`.
    """
    ends = plan_at(plan, question, [question.low, question.high])
    recorded = StudyRecordings(plan.scene, ends.axes)
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
    whole = {**definition(ends, recorded), **about}
    with Store(folder, whole, [question.key.path], MOST_VALUES * per_value) as store:

        def solve(new: list[float]) -> list[list[Row]]:
            nonlocal values
            own, first = plan_at(plan, question, new), values * per_value
            values += len(new)
            there = sum(store.has(first + j) for j in range(own.entries))
            with progress(f"{question.key.path}, {values} values", own.entries, there) as advance:

                def write(outcomes: list[Outcome]) -> None:
                    found = []
                    for outcome in outcomes:
                        labels, index = own.labels(own.point_of(outcome["index"])), outcome["index"] + first
                        found.append(row_of({**outcome, "index": index}, index // per_value, labels))
                    advance(store.add(found))

                execute(pool, own.tasks(lambda index: store.has(index + first), recorded), write)
            rows = store.read(first, own.entries)
            return [rows[j : j + per_value] for j in range(0, own.entries, per_value)]

        with _stop_reported(store, None):
            return answer(question, solve)
