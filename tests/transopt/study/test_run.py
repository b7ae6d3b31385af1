"""Executors that agree, workers that die, stops, and rows that outlive them."""

import itertools
import os
import shutil
import signal
import sqlite3
import sys
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import BrokenExecutor, Executor, Future, ThreadPoolExecutor
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.benches.study import assert_same_rows, plain, read, serial
from transopt.base.apart import Processes
from transopt.base.errors import InputError
from transopt.study import run, store
from transopt.study.axes import parse_axis
from transopt.study.executors import Pool, executor_pool, processes
from transopt.study.plan import Plan
from transopt.study.recordings import StudyRecordings
from transopt.study.rows import Row
from transopt.study.run import AHEAD, execute
from transopt.study.session import definition, run_plan
from transopt.study.store import Store


class Dying(Executor):
    """Runs calls in place; some of them end as if their worker process had died."""

    def __init__(self, dies: Iterator[bool]) -> None:
        self.dies = dies

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> "Future[Any]":
        future: Future[Any] = Future()
        if next(self.dies):
            future.set_exception(BrokenExecutor("died"))
        else:
            future.set_result(fn(*args, **kwargs))
        return future


def _wait_for(seconds: float) -> None:
    threading.Event().wait(seconds)


class TestExecutors:
    def test_all_give_the_same_rows(self, small: Plan, finished: Path, tmp_path: Path) -> None:
        pools = {"processes": processes(2)}
        with ThreadPoolExecutor(2) as threads:
            pools["threads"] = Pool.of(threads, 2)
            for name, pool in pools.items():
                run_plan(small, tmp_path / name, pool)
                pool.close()
                assert_same_rows(tmp_path / name / "rows.csv", finished / "rows.csv")

    def test_workers_that_die_again_and_again(self, small: Plan, finished: Path, tmp_path: Path) -> None:
        dies = itertools.chain([False], itertools.repeat(True))
        pool = Pool.of(Dying(dies), 1)
        with pytest.raises(InputError, match=r"Dying: a worker died 4 times in a row .*the same command goes on"):
            run_plan(small, tmp_path, pool)
        assert 0 < len(read(tmp_path / "rows.csv")) < 24
        run_plan(small, tmp_path, serial())
        assert_same_rows(tmp_path / "rows.csv", finished / "rows.csv")

    def test_a_killed_process(self, small: Plan, finished: Path, tmp_path: Path) -> None:
        killed: list[int] = []

        with closing(processes(1)) as pool:

            def kill(done: int) -> None:
                assert isinstance(pool.executor, Processes)
                for number in pool.executor.numbers if not killed else []:
                    killed.append(number)
                    os.kill(number, signal.SIGTERM)

            run_plan(small, tmp_path, pool, watch=kill)
        assert killed
        assert_same_rows(tmp_path / "rows.csv", finished / "rows.csv")

    @pytest.mark.skipif(os.name != "posix", reason="asks the system by a signal")
    def test_workers_end_when_they_are_let_go_in_the_middle_of_a_task(self) -> None:
        pool = processes(1)
        number = pool.executor.submit(os.getpid).result()
        pool.executor.submit(_wait_for, 3600.0)
        assert number != os.getpid()
        pool.close()
        with pytest.raises(ProcessLookupError):
            os.kill(number, 0)

    def test_what_a_call_raises_is_raised_here(self) -> None:
        with closing(processes(1)) as pool, pytest.raises(ZeroDivisionError):
            pool.executor.submit(divmod, 1, 0).result()

    @pytest.mark.parametrize("stop", [KeyboardInterrupt, SystemExit])
    def test_a_stop_keeps_what_is_done(
        self,
        small: Plan,
        finished: Path,
        tmp_path: Path,
        stop: type[BaseException],
        monkeypatch: pytest.MonkeyPatch,
        capsys: pytest.CaptureFixture[str],
    ) -> None:
        """The first task is written when the stop comes, the second has finished, the third has not begun."""
        monkeypatch.setattr("transopt.study.plan.TOGETHER", 4)

        def now(done: int) -> None:
            raise stop

        with pytest.raises(stop):
            run_plan(small, tmp_path, serial(), watch=now)
        kept = read(tmp_path / "rows.csv")
        assert 0 < len(kept) < 24
        assert f"stopped: {len(kept)} of 24 entries are in" in capsys.readouterr().err
        run_plan(small, tmp_path, serial())
        assert_same_rows(tmp_path / "rows.csv", finished / "rows.csv")

    def test_tasks_under_way_are_bounded(self, small: Plan) -> None:
        taken: list[Any] = []

        def tasks() -> Iterator[Any]:
            for number in range(50):
                taken.append(number)
                yield number

        class Idle(Executor):
            def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> "Future[Any]":
                future: Future[Any] = Future()
                waiting.append(future)
                if len(waiting) == AHEAD * 2:
                    for each in waiting:
                        each.set_result([])
                    waiting.clear()
                return future

        waiting: list[Future[Any]] = []
        finished: list[int] = []
        execute(Pool.of(Idle(), 2), itertools.islice(tasks(), 48), lambda o: finished.append(len(taken)))
        assert len(finished) == 48
        assert all(count - j <= 2 * AHEAD for j, count in enumerate(finished))

    @pytest.mark.parametrize(
        ("text", "jobs", "words"),
        [
            ("mpi", 1, "--executor mpi: must be processes, serial or dask://HOST:PORT"),
            ("processes", 0, "--jobs 0: must be at least 1"),
        ],
    )
    def test_refusals(self, text: str, jobs: int, words: str) -> None:
        with pytest.raises(InputError, match=words):
            executor_pool(text, jobs)

    def test_dask_that_is_not_installed(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setitem(sys.modules, "distributed", None)
        with pytest.raises(InputError, match=r"pip install 'transopt\[cluster\]'"):
            executor_pool("dask://127.0.0.1:1", 1)


def store_of(plan: Plan, folder: Path) -> Store:
    recorded = StudyRecordings(plan.scene, plan.axes)
    return Store(folder, definition(plan, recorded), [axis.key for axis in plan.axes], plan.entries)


@pytest.fixture
def copy(finished: Path, tmp_path: Path) -> Path:
    """The finished study in a folder of its own."""
    return Path(shutil.copytree(finished, tmp_path / "copy"))


class TestRows:
    def test_every_row_is_certified_and_in_order(self, finished: Path) -> None:
        rows = read(finished / "rows.csv")
        assert [int(row["index"]) for row in rows] == list(range(24))
        assert {row["status"] for row in rows} == {"OPTIMAL"}
        assert max(float(row["relative_gap"]) for row in rows) <= 1e-6
        assert {row["limits.current_A"] for row in rows} == {"1.5", "2.75", "4.0"}
        saturated = [row for row in rows if row["binding"] != "none"]
        assert saturated
        assert all(float(row["mu_current_1_A"]) > 0 for row in saturated)

    def test_rows_that_are_there_are_kept_and_the_others_solved(
        self, small: Plan, finished: Path, copy: Path
    ) -> None:
        random = np.random.default_rng(3)
        lost = random.choice(24, 15, replace=False)
        with closing(sqlite3.connect(copy / "study.sqlite")) as file, file:
            file.executemany('DELETE FROM rows WHERE "index" = ?', [[int(j)] for j in lost])
        rows = run_plan(small, copy, serial())
        assert plain(copy / "rows.csv") == plain(finished / "rows.csv")
        before = read(finished / "rows.csv")
        assert all(rows[j] == before[j] for j in range(24) if j not in lost)  # times included

    def test_rows_come_in_any_order_and_twice(self, small: Plan, finished: Path, tmp_path: Path) -> None:
        rows: list[Row] = read(finished / "rows.csv")
        with store_of(small, tmp_path) as there:
            assert there.add(rows[5:7][::-1]) == 2
            assert there.add(rows[3:6]) == 2
            assert (there.done, there.has(4), there.has(7)) == (4, True, False)
            assert there.read(4, 2) == rows[4:6]
        assert read(tmp_path / "rows.csv") == rows[3:7]

    def test_a_row_that_is_half_written_is_not_there(self, small: Plan, finished: Path, tmp_path: Path) -> None:
        rows: list[Row] = read(finished / "rows.csv")
        with store_of(small, tmp_path) as there:
            with pytest.raises(KeyError):
                there.add([rows[0], {**rows[1], "index": "1", "status": "OPTIMAL"}, {"index": "2"}])
            assert there.done == 0
            assert there.read() == []

    def test_nothing_is_solved_twice(
        self, small: Plan, finished: Path, copy: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.setattr(run, "run_task", lambda task: pytest.fail("solved again"))
        assert len(run_plan(small, copy, serial())) == 24
        assert (copy / "rows.csv").read_bytes() == (finished / "rows.csv").read_bytes()


class TestRefusals:
    @pytest.mark.parametrize(
        ("change", "words"),
        [
            (lambda plan: replace(plan, grips_N=(1.0, 4.0)), "grips_N"),
            (
                lambda plan: replace(plan, scene=plan.scene.model_copy(update={"hand_over_samples": 9})),
                "hand_over_samples 10 there, 9 now",
            ),
            (
                lambda plan: replace(plan, axes=(parse_axis(plan.scene, "", "limits.current_A=1,2"), plan.axes[1])),
                "axes.limits.current_A",
            ),
        ],
    )
    def test_another_study(self, small: Plan, finished: Path, change: Callable[[Plan], Plan], words: str) -> None:
        before = {path.name: path.read_bytes() for path in finished.iterdir()}
        with pytest.raises(InputError, match="holds another study") as refusal:
            run_plan(change(small), finished, serial())
        assert words in str(refusal.value)
        assert "\n" not in str(refusal.value)
        assert {path.name: path.read_bytes() for path in finished.iterdir()} == before

    def test_other_versions(self, small: Plan, finished: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(store, "versions", lambda *names: {"casadi": "0.1"})
        with pytest.raises(InputError, match="holds another study: versions"):
            run_plan(small, finished, serial())

    def test_rows_of_something_else(self, small: Plan, tmp_path: Path) -> None:
        (tmp_path / "rows.csv").write_text("precious\n", encoding="utf-8")
        with pytest.raises(InputError, match=r"rows.csv without study.sqlite; choose another folder"):
            run_plan(small, tmp_path, serial())
        assert [path.name for path in tmp_path.iterdir()] == ["rows.csv"]

    @pytest.mark.parametrize(
        "damage", [lambda whole: b"not a database" * 100, lambda whole: whole[:4096] + bytes(len(whole) - 4096)]
    )
    def test_damage_that_no_kill_can_do(self, small: Plan, copy: Path, damage: Callable[[bytes], bytes]) -> None:
        path = copy / "study.sqlite"
        path.write_bytes(damage(path.read_bytes()))
        with pytest.raises(InputError, match=r"study.sqlite: damaged .*; choose another --out folder") as refusal:
            run_plan(small, copy, serial())
        assert "\n" not in str(refusal.value)

    def test_a_folder_that_is_a_file(self, small: Plan, tmp_path: Path) -> None:
        (tmp_path / "out").write_text("here already", encoding="utf-8")
        with pytest.raises(InputError, match=r"--out .*out: cannot be written \(.*\); choose another folder"):
            run_plan(small, tmp_path / "out", serial())

    def test_two_runs_at_a_time(self, small: Plan, copy: Path) -> None:
        with (
            store_of(small, copy),
            pytest.raises(InputError, match="another run is writing there: wait for it or stop it"),
        ):
            run_plan(small, copy, serial())
        run_plan(small, copy, serial())
