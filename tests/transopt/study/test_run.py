"""Executors that agree, workers that die, and stops."""

import itertools
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import BrokenExecutor, Executor, Future, ThreadPoolExecutor
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest

from tests.benches.study import assert_same_rows, read, serial
from transopt.base.apart import Processes
from transopt.base.errors import InputError
from transopt.study.executors import Pool, executor_pool, processes
from transopt.study.plan import Plan
from transopt.study.run import AHEAD, execute
from transopt.study.session import run_plan


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
