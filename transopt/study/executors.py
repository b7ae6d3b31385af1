"""Where the tasks of a study run: in this process, in worker processes of this machine, on a dask cluster.

All three are executors as `concurrent.futures` defines them, and so may be one of the caller's own.
"""

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future, ProcessPoolExecutor
from contextlib import contextmanager
from multiprocessing import connection
from multiprocessing.context import BaseContext
from typing import Any, ParamSpec, TypeVar

from transopt.base.errors import InputError
from transopt.base.files import ctrl_c_waits

P = ParamSpec("P")
T = TypeVar("T")

# The workers multiply small matrices: threads of theirs would only wait for each other.
THREADS = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")
# What a task takes; scipy loads its parts when they are first used.
LOADED = ("transopt.design.sweep", "scipy.fft", "scipy.integrate", "scipy.interpolate")


class Pool:
    """An executor, and what a long run needs to know of it.

    Attributes
    ----------
    name : what messages call it.
    workers : how many tasks run at a time; asked again and again, because a cluster may grow and shrink.
    revived : whether a new executor may take the place of one whose worker died.
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
        """Nothing is started before the first task.

        Parameters
        ----------
        make : starts an executor.
        close : called when all is done.
        """
        self.name, self.workers, self.revived = name, workers, revived
        self._make, self._close = make, close
        self._executor: Executor | None = None

    @classmethod
    def of(cls, executor: Executor, workers: int) -> "Pool":
        """A pool of the caller's own executor, which is shut down when the pool is closed."""
        return cls(type(executor).__name__, lambda: executor, lambda: workers)

    def submit(self, work: Callable[[T], Any], argument: T) -> "Future[Any]":
        """Hand one call to the executor.

        Raises
        ------
        BrokenExecutor : a worker died; `drop` it, and the next call starts another.
        """
        if self._executor is None:
            self._executor = self._make()
        return self._executor.submit(work, argument)

    def drop(self) -> None:
        """Let the executor go, with whatever it has under way."""
        if self._executor is not None:
            self._executor.shutdown(wait=False)
        self._executor = None

    def close(self) -> None:
        """Let the executor go for good."""
        self.drop()
        self._close()


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
    lacking = [name for name in THREADS if name not in os.environ]
    os.environ.update(dict.fromkeys(lacking, "1"))
    try:
        with ctrl_c_waits():
            yield
    finally:
        for name in lacking:
            del os.environ[name]


def _end_when_let_go(line: connection.Connection) -> None:
    connection.wait([line])
    os._exit(1)


def _start_worker(line: connection.Connection) -> None:
    """Leave Ctrl-C to the parent, and end as soon as nobody holds the other end of the line."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if hasattr(signal, "pthread_sigmask"):
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
    threading.Thread(target=_end_when_let_go, args=[line], daemon=True).start()


def _context() -> BaseContext:
    """How workers start: where that is possible, forked from a server process that has loaded what a task takes.

    They are not forked from this process, whose solver objects and threads a fork would copy half-alive. And they
    are not started from nothing each, which takes as long as solving a hundred entries.
    """
    if "forkserver" not in multiprocessing.get_all_start_methods():
        return multiprocessing.get_context("spawn")
    from multiprocessing import forkserver, resource_tracker

    forks = multiprocessing.get_context("forkserver")
    forks.set_forkserver_preload(list(LOADED))
    resource_tracker.ensure_running()  # which would unblock Ctrl-C again if it were started with the server
    with _starting():
        forkserver.ensure_running()
    return forks


class Processes(ProcessPoolExecutor):
    """Worker processes that end at once when they are let go, or when this process ends, however it does.

    Each holds one end of a pipe, a line to this process. When the other end is closed, by `shutdown` or because
    this process is gone, the worker ends in the middle of whatever it does.
    """

    def __init__(self, workers: int) -> None:
        context = _context()
        self._theirs, self._ours = context.Pipe(duplex=False)
        super().__init__(workers, context, _start_worker, (self._theirs,))

    def submit(self, fn: Callable[P, T], /, *args: P.args, **kwargs: P.kwargs) -> "Future[T]":
        with _starting():  # workers start when there is something to do
            return super().submit(fn, *args, **kwargs)

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Wait for the tasks that have started, or with `wait=False` end their workers."""
        if wait:
            super().shutdown(wait=True, cancel_futures=cancel_futures)
        self._ours.close()
        self._theirs.close()
        super().shutdown(wait=False, cancel_futures=cancel_futures)


def processes(workers: int) -> Pool:
    """Worker processes of this machine.

    Raises
    ------
    InputError : fewer than one.
    """
    if workers < 1:
        raise InputError(f"--jobs {workers}: must be at least 1")
    name = f"{workers} process{'es' if workers > 1 else ''}"
    return Pool(name, lambda: Processes(workers), lambda: workers, revived=True)


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
    return Pool(address, lambda: client.get_executor(pure=False), workers, close=client.close)


def executor_pool(text: str, jobs: int) -> Pool:
    """What --executor and --jobs name.

    Raises
    ------
    InputError : no such executor, or it cannot be had.
    """
    if text.startswith("dask://"):
        return dask(text)
    if text == "serial":
        return Pool("this process", Serial, lambda: 1)
    if text != "processes":
        raise InputError(f"--executor {text}: must be processes, serial or dask://HOST:PORT")
    return processes(jobs)
