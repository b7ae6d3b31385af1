"""Executors of a study's tasks: this process, worker processes of this machine, a dask cluster.

All three are executors in the sense of `concurrent.futures`; a caller may pass one of its own.
"""

from collections.abc import Callable
from concurrent.futures import Executor, Future
from dataclasses import dataclass
from typing import Any, ParamSpec, TypeVar

from transopt.base.apart import Processes
from transopt.base.errors import InputError

ANSWERS_S = 10.0  # longest wait for a scheduler's answer
P = ParamSpec("P")
T = TypeVar("T")


@dataclass(frozen=True)
class Pool:
    """An executor with the information that a long run needs.

    Attributes
    ----------
    name : its name in messages.
    executor : an executor of `concurrent.futures`.
    workers : number of tasks run at a time; called repeatedly, because a cluster may grow and shrink.
    finish : called when the pool is closed, after the shutdown of the executor.
    """

    name: str
    executor: Executor
    workers: Callable[[], int]
    finish: Callable[[], Any] = lambda: None

    @classmethod
    def of(cls, executor: Executor, workers: int) -> "Pool":
        """A pool from the caller's own executor, which is shut down when the pool is closed."""
        return cls(type(executor).__name__, executor, lambda: workers)

    def close(self) -> None:
        """Shut the executor down without waiting for running tasks."""
        self.executor.shutdown(wait=False)
        self.finish()


class Serial(Executor):
    """Runs each call immediately, in the calling process."""

    def submit(self, fn: Callable[P, T], /, *args: P.args, **kwargs: P.kwargs) -> "Future[T]":
        future: Future[T] = Future()
        try:
            future.set_result(fn(*args, **kwargs))
        except Exception as error:
            future.set_exception(error)
        return future


def processes(workers: int) -> Pool:
    """A pool of worker processes of this machine.

    Raises
    ------
    InputError : fewer than one worker.
    """
    if workers < 1:
        raise InputError(f"--jobs {workers}: must be at least 1")
    name = f"{workers} process{'es' if workers > 1 else ''}"
    return Pool(name, Processes(workers), lambda: workers)


def dask(address: str) -> Pool:
    """A pool of workers of a dask scheduler, `dask://HOST:PORT`, where the same version of transopt is installed.

    Raises
    ------
    InputError : dask.distributed is not installed, the scheduler does not answer, or it has no workers.
    """
    try:
        import distributed
    except ImportError:
        raise InputError(
            f"--executor {address}: dask.distributed is not installed; pip install 'transopt[cluster]'"
        ) from None
    connect: Callable[..., Any] = distributed.Client
    try:
        client = connect(address.replace("dask://", "tcp://"), timeout=ANSWERS_S, set_as_default=False)
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
    """The pool that the options --executor and --jobs name.

    Raises
    ------
    InputError : the executor is unknown or unavailable.
    """
    if text.startswith("dask://"):
        return dask(text)
    if text == "serial":
        return Pool("this process", Serial(), lambda: 1)
    if text != "processes":
        raise InputError(f"--executor {text}: must be processes, serial or dask://HOST:PORT")
    return processes(jobs)
