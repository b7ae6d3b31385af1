"""Places to run a study's tasks: this process, worker processes of this machine, a dask cluster.

All three are executors as `concurrent.futures` defines them, and so may be one of the caller's own.
"""

import multiprocessing
import os
import queue
import signal
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import BrokenExecutor, Executor, Future
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from multiprocessing import connection, resource_tracker
from multiprocessing.process import BaseProcess
from typing import Any, ParamSpec, TypeVar

from transopt.base.errors import InputError
from transopt.base.files import ctrl_c_waits
from transopt.base.threads import one_thread

P = ParamSpec("P")
T = TypeVar("T")

LAST_WORDS_S = 1.0  # between a closed line and the exit code of the worker at its other end
_one_at_a_time = threading.Lock()  # of all executors here: a worker's start changes this process's environment


@dataclass(frozen=True)
class Pool:
    """An executor, and what a long run needs to know of it.

    Attributes
    ----------
    name : what messages call it.
    executor : of `concurrent.futures`.
    workers : how many tasks run at a time; asked again and again, because a cluster may grow and shrink.
    finish : called when the pool is closed, after the executor is shut down.
    """

    name: str
    executor: Executor
    workers: Callable[[], int]
    finish: Callable[[], Any] = lambda: None

    @classmethod
    def of(cls, executor: Executor, workers: int) -> "Pool":
        """A pool of the caller's own executor, which is shut down when the pool is closed."""
        return cls(type(executor).__name__, executor, lambda: workers)

    def close(self) -> None:
        """Shut the executor down without waiting for what it has under way."""
        self.executor.shutdown(wait=False)
        self.finish()


class Serial(Executor):
    """Runs each call where it is submitted."""

    def submit(self, fn: Callable[P, T], /, *args: P.args, **kwargs: P.kwargs) -> "Future[T]":
        future: Future[T] = Future()
        try:
            future.set_result(fn(*args, **kwargs))
        except Exception as error:
            future.set_exception(error)
        return future


@contextmanager
def _starting() -> Iterator[None]:
    """Processes started inside use one thread each, and a Ctrl-C, which is this process's own, passes them by."""
    lacking = one_thread(os.environ)
    os.environ.update(lacking)
    try:
        with ctrl_c_waits():
            yield
    finally:
        for name in lacking:
            del os.environ[name]


def _end_with_parent() -> None:
    """End this process when its parent is gone, however that ended."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        connection.wait([parent.sentinel])
        os._exit(1)


def _work(line: "connection.Connection[Any, Any]") -> None:
    """What a worker process does: take a call from the line, send back its result or exception, and so on."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the parent's, which ends the workers
    if hasattr(signal, "pthread_sigmask"):
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
    threading.Thread(target=_end_with_parent, daemon=True).start()
    with suppress(EOFError, OSError):  # the other end was closed
        while True:
            call, args, kwargs = line.recv()
            answer: tuple[Any, Exception | None]
            try:
                answer = (call(*args, **kwargs), None)
            except Exception as error:
                answer = (None, error)
            line.send(answer)


@dataclass(frozen=True, eq=False)
class _Worker:
    """A worker process, and this process's end of the line to it."""

    process: BaseProcess
    line: "connection.Connection[Any, Any]"


class Processes(Executor):
    """Worker processes, each served by a thread of this process that sends it a call and waits for the answer.

    When a worker dies, its call ends in BrokenExecutor, the other workers go on, and a new one takes its place with
    the next call. `shutdown(wait=False)` ends the workers in the middle of whatever they do. A ProcessPoolExecutor
    does neither: one death breaks all of it, and it waits for calls that have started.
    """

    def __init__(self, workers: int) -> None:
        self._workers = workers
        self._calls: queue.SimpleQueue[tuple[Future[Any], Any] | None] = queue.SimpleQueue()
        self._threads: list[threading.Thread] = []
        self._live: set[_Worker] = set()
        self._ended = False

    def submit(self, fn: Callable[P, T], /, *args: P.args, **kwargs: P.kwargs) -> "Future[T]":
        future: Future[T] = Future()
        self._calls.put((future, (fn, args, kwargs)))
        if len(self._threads) < self._workers:
            # A daemon: a thread that waits for a worker to start, or for its answer, does not keep this process up.
            thread = threading.Thread(target=self._serve, daemon=True)
            self._threads.append(thread)
            thread.start()
        return future

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Wait for all calls, or with `wait=False` cancel those that have not started and end the workers."""
        if cancel_futures or not wait:
            with suppress(queue.Empty):
                while (waiting := self._calls.get_nowait()) is not None:
                    waiting[0].cancel()
        for _ in self._threads:
            self._calls.put(None)
        if wait:
            for thread in self._threads:
                thread.join()
        self._ended = True
        for worker in self._live.copy():
            worker.process.kill()

    def _serve(self) -> None:
        """What a thread does: one call after the other, each by the worker process of this thread."""
        worker: _Worker | None = None
        while (waiting := self._calls.get()) is not None:
            future, call = waiting
            if not future.set_running_or_notify_cancel():
                continue
            try:
                worker = self._start() if worker is None else worker
                worker.line.send(call)
                result, raised = worker.line.recv()
            except (EOFError, OSError) as error:
                cause = "could not be started" if worker is None else "died"
                if worker is not None:
                    self._live.discard(worker)
                    worker.process.join(LAST_WORDS_S)
                    cause += f" with exit code {worker.process.exitcode}"
                worker = None
                future.set_exception(BrokenExecutor(f"a worker process {cause} ({error or type(error).__name__})"))
            except Exception as unsent:  # a call or a result that cannot be sent
                future.set_exception(unsent)
            else:
                if raised is None:
                    future.set_result(result)
                else:
                    future.set_exception(raised)

    def _start(self) -> _Worker:
        with _one_at_a_time:
            # Started by itself: what a fork server is asked for it starts only when it has loaded everything, which
            # a Ctrl-C would have to wait for. And a fork of this process would copy its threads half-alive.
            spawn = multiprocessing.get_context("spawn")
            resource_tracker.ensure_running()  # if it were started with a worker, it would let a Ctrl-C through to it
            ours, theirs = spawn.Pipe()
            with _starting(), theirs:
                process = spawn.Process(target=_work, args=(theirs,), daemon=True)
                process.start()
        worker = _Worker(process, ours)
        self._live.add(worker)
        if self._ended:
            process.kill()
        return worker


def processes(workers: int) -> Pool:
    """Worker processes of this machine.

    Raises
    ------
    InputError : fewer than one.
    """
    if workers < 1:
        raise InputError(f"--jobs {workers}: must be at least 1")
    name = f"{workers} process{'es' if workers > 1 else ''}"
    return Pool(name, Processes(workers), lambda: workers)


def dask(address: str, timeout_s: float = 10.0) -> Pool:
    """Workers of a dask scheduler, `dask://HOST:PORT`; transopt must be installed there, of the same version.

    Raises
    ------
    InputError : dask.distributed is not installed, nobody answers, no worker is there.
    """
    try:
        import distributed
    except ImportError:
        raise InputError(
            f"--executor {address}: dask.distributed is not installed; pip install 'transopt[cluster]'"
        ) from None
    connect: Callable[..., Any] = distributed.Client
    try:
        client = connect(address.replace("dask://", "tcp://"), timeout=timeout_s, set_as_default=False)
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
    return Pool(address, client.get_executor(pure=False), workers, client.close)


def executor_pool(text: str, jobs: int) -> Pool:
    """What --executor and --jobs name.

    Raises
    ------
    InputError : no such executor, or it cannot be had.
    """
    if text.startswith("dask://"):
        return dask(text)
    if text == "serial":
        return Pool("this process", Serial(), lambda: 1)
    if text != "processes":
        raise InputError(f"--executor {text}: must be processes, serial or dask://HOST:PORT")
    return processes(jobs)
