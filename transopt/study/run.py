"""Tasks through any executor of concurrent.futures: a bounded window, dead workers, a clean stop."""

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Executor, Future, ProcessPoolExecutor, wait
from contextlib import contextmanager
from multiprocessing import connection
from types import FrameType
from typing import Any, ParamSpec, TypeVar

from transopt.base.errors import InputError
from transopt.base.files import ctrl_c_waits
from transopt.design.sweep import Outcome, Task, run_task

AHEAD = 3  # tasks under way or waiting per worker: none idles while results are written, and memory stays flat
MOST_DEATHS = 3  # of worker processes without a finished task in between
LOOK_S = 5.0  # between looks at a cluster that gives no answer
MOST_LOOKS = 12
P, T = ParamSpec("P"), TypeVar("T")


class Serial(Executor):
    """Runs each call where it is submitted."""

    def submit(self, fn: Callable[P, T], /, *args: P.args, **kwargs: P.kwargs) -> "Future[T]":
        future: Future[T] = Future()
        try:
            future.set_result(fn(*args, **kwargs))
        except Exception as error:
            future.set_exception(error)
        return future


class Pool:
    """Where tasks run, from study to study: an executor, and how to come by a new one.

    Parameters
    ----------
    make : a new executor. workers : how many tasks it runs at a time; asked again and again, clusters grow.
    revived : whether a new executor may take a broken one's place. close : called when all is done.
    """

    def __init__(
        self,
        name: str,
        make: Callable[[], Executor],
        workers: Callable[[], int],
        *,
        revived: bool = False,
        close: Callable[[], Any] = lambda: None,
    ) -> None:
        self.name, self.workers, self.revived = name, workers, revived
        self._make, self._close = make, close
        self._executor: Executor | None = None

    @classmethod
    def of(cls, executor: Executor, workers: int) -> "Pool":
        """A pool of the caller's own executor."""
        return cls(type(executor).__name__, lambda: executor, lambda: workers)

    @property
    def executor(self) -> Executor:
        """The one there is, made when it is first wanted."""
        if self._executor is None:
            self._executor = self._make()
        return self._executor

    def drop(self) -> None:
        """Let the executor go: the next one is new."""
        if self._executor is not None:
            self._executor.shutdown(wait=False)
        self._executor = None

    def close(self) -> None:
        self.drop()
        self._close()


def _leave_with_parent() -> None:
    """End this process when its parent is gone, however that ended: a killed study leaves nobody waiting."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        connection.wait([parent.sentinel])
        os._exit(1)


def _start_worker() -> None:
    # Ctrl-C is the parent's; the signal was blocked while this process started, and stays so for nothing it starts.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if hasattr(signal, "pthread_sigmask"):
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
    threading.Thread(target=_leave_with_parent, daemon=True).start()


def processes(jobs: int) -> Pool:
    """Worker processes, one thread each.

    Raises
    ------
    InputError : fewer than one.
    """
    if jobs < 1:
        raise InputError(f"--jobs {jobs}: must be at least 1")
    # Spawned, not forked: the parent has solver objects and threads that a fork would copy half-alive.
    spawn = multiprocessing.get_context("spawn")

    def make() -> Executor:
        # The workers multiply small matrices; threads of theirs would only wait for each other.
        for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
            os.environ.setdefault(name, "1")
        return ProcessPoolExecutor(jobs, spawn, _start_worker)

    return Pool(f"{jobs} process{'es' if jobs > 1 else ''}", make, lambda: jobs, revived=True)


def dask(address: str, timeout_s: float = 10.0) -> Pool:
    """Workers of a dask scheduler, `dask://HOST:PORT`; they need transopt, of the same version.

    Raises
    ------
    InputError : dask.distributed is not installed, nobody answers, no worker is there.
    """
    try:
        from distributed import Client
    except ImportError:
        raise InputError(
            f"--executor {address}: dask.distributed is not installed; pip install 'transopt[cluster]'"
        ) from None
    try:
        client = Client(address.replace("dask://", "tcp://"), timeout=timeout_s, set_as_default=False)
    except (OSError, ValueError, TimeoutError) as error:
        raise InputError(f"--executor {address}: no dask scheduler answers there ({type(error).__name__})") from None

    def workers() -> int:
        try:
            return sum(client.nthreads().values())
        except (OSError, TimeoutError):
            return 0

    if workers() == 0:
        client.close()
        raise InputError(f"--executor {address}: no worker is connected: start some with `dask worker`")
    return Pool(address, lambda: client.get_executor(pure=False), workers, close=client.close)


def executor_pool(text: str, jobs: int) -> Pool:
    """What --executor and --jobs name.

    Raises
    ------
    InputError : no such executor.
    """
    if text.startswith("dask://"):
        return dask(text)
    if text == "serial":
        return Pool("this process", Serial, lambda: 1)
    if text != "processes":
        raise InputError(f"--executor {text}: must be processes, serial or dask://HOST:PORT")
    return processes(jobs)


def kept(text: str) -> str:
    return f"{text}; the rows so far are kept, the same command goes on from there"


class _Window:
    """Tasks under way."""

    def __init__(self, pool: Pool, tasks: Iterator[Task]) -> None:
        self.pool, self.tasks, self.deaths, self.looks = pool, tasks, 0, 0
        self.under_way: dict[Future[list[Outcome]], Task] = {}
        self.again: list[Task] = []

    def fill(self, stop: threading.Event) -> None:
        most = AHEAD * max(self.pool.workers(), 1)
        while len(self.under_way) < most and not stop.is_set():
            task = self.again.pop() if self.again else next(self.tasks, None)
            if task is None:
                return
            try:
                # Workers may start here; they are not to see a Ctrl-C.
                with ctrl_c_waits():
                    future = self.pool.executor.submit(run_task, task)
            except BrokenExecutor:
                self.again.append(task)
                self.revive()
                if self.under_way:
                    return  # what had finished before that is written first
                continue
            self.under_way[future] = task

    def revive(self) -> None:
        """Take what was under way to a new executor, but for what has finished."""
        self.deaths += 1
        if not self.pool.revived or self.deaths > MOST_DEATHS:
            died = f"{self.pool.name}: a worker died" + (f" {self.deaths} times in a row" if self.deaths > 1 else "")
            raise InputError(kept(f"{died} (out of memory? fewer --jobs take less)"))
        finished = {
            future: task
            for future, task in self.under_way.items()
            if future.done() and not future.cancelled() and future.exception() is None
        }
        self.again += [task for future, task in self.under_way.items() if future not in finished]
        self.cancel()
        self.under_way = finished
        self.pool.drop()

    def cancel(self) -> None:
        for future in self.under_way:
            future.cancel()
        self.under_way.clear()

    def finished(self) -> Iterator[list[Outcome]]:
        """What is ready, at least one; or nothing if the workers have died and start again."""
        done, _ = wait(self.under_way, timeout=LOOK_S, return_when=FIRST_COMPLETED)
        if not done and self.pool.workers() == 0:
            self.looks += 1
            if self.looks > MOST_LOOKS:
                raise InputError(kept(f"{self.pool.name}: no worker for {MOST_LOOKS * LOOK_S:g} s"))
            return
        self.looks = 0
        for future in done:
            try:
                outcomes = future.result()
            except BrokenExecutor:
                self.revive()
                return
            except Exception as error:
                reason = " ".join(f"{type(error).__name__}: {error}".split())[:200]
                raise InputError(kept(f"{self.pool.name}: a task could not be run ({reason})")) from None
            del self.under_way[future]
            self.deaths = 0
            yield outcomes

    def drain(self, write: Callable[[list[Outcome]], Any]) -> None:
        """Drop what has not started, wait for what has."""
        for future in [future for future in self.under_way if future.cancel()]:
            del self.under_way[future]
        while self.under_way:
            done, _ = wait(self.under_way, return_when=FIRST_COMPLETED)
            for future in done:
                del self.under_way[future]
                if future.exception() is None:
                    write(future.result())


@contextmanager
def _first_ctrl_c() -> Iterator[threading.Event]:
    """Set by the first Ctrl-C, which stops nothing by itself; the second one is a KeyboardInterrupt."""
    asked = threading.Event()
    if threading.current_thread() is not threading.main_thread():
        yield asked
        return

    def ask(number: int, frame: FrameType | None) -> None:
        asked.set()
        signal.signal(signal.SIGINT, signal.default_int_handler)

    previous = signal.signal(signal.SIGINT, ask)
    try:
        yield asked
    finally:
        signal.signal(signal.SIGINT, previous)


def execute(pool: Pool, tasks: Iterator[Task], write: Callable[[list[Outcome]], Any]) -> None:
    """Run tasks and hand over what comes out, in whatever order that is.

    At a Ctrl-C the tasks that have started are waited for and written; a second one drops them.

    Raises
    ------
    InputError : the workers die again and again, or none is left. KeyboardInterrupt : after that stop.
    """
    window = _Window(pool, tasks)
    try:
        with _first_ctrl_c() as stop:
            window.fill(stop)
            while window.under_way:
                for outcomes in window.finished():
                    write(outcomes)
                if stop.is_set():
                    window.drain(write)
                    raise KeyboardInterrupt
                window.fill(stop)
    finally:
        window.cancel()
