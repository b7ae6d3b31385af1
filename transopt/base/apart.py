"""Calls that run in worker processes, which can be killed at any instant.

A method in native code may search for minutes, may never return, and may even crash its process. Python handles a
signal only between two of its own instructions, so a Ctrl-C has to wait until such a method returns. In a worker
process the method blocks nobody: the waiting caller can be interrupted, and then kills the worker.

`call` bounds the processor time of one call, so that a busy machine does not change an answer. `Processes` is an
executor of `concurrent.futures` for parallel tasks. The executors of the standard library and of loky do not suffice:
there the death of one process also ends the tasks of all others, and no further task can be submitted.

Each worker is a plain Python process that communicates through its standard input and output. It is not forked, since
a fork would copy locks held by other threads but not these threads. It loads the caller's main program only to find a
function of that program. It has its own process group: a Ctrl-C in the terminal reaches only the caller, which ends
the workers.
"""

import atexit
import faulthandler
import math
import os
import pickle
import queue
import signal
import subprocess
import sys
import threading
import warnings
import weakref
from collections.abc import Callable, Iterator
from concurrent.futures import BrokenExecutor, Executor, Future, wait
from contextlib import contextmanager, suppress
from pathlib import Path
from time import monotonic, process_time
from typing import Any, ParamSpec, TypeVar

from transopt.base.threads import one_thread

try:
    import resource
except ImportError:  # Windows, where only elapsed time bounds a call
    resource = None  # type: ignore[assignment]

P = ParamSpec("P")
T = TypeVar("T")

START_S = 120.0  # time for a worker to start and import; about a second on an idle machine
SHARED = 10.0  # largest ratio of elapsed to processor time of a call, since others use the processor too
LOOK_S = 0.1  # polling period while waiting; on Windows a Ctrl-C is only handled between two polls
ORPHANED_S = 5.0  # time after the caller's deadline at which a worker without a caller ends itself
LAST_WORDS_S = 1.0  # time to wait for a worker's exit code after its pipe was closed
OUT_OF_TIME = -getattr(signal, "SIGXCPU", 0)  # exit code of a worker that used up its processor time
Outcome = tuple[Any, Exception | None, list[tuple[type[Warning], str]]]  # value, what was raised, warnings


class UnansweredError(BrokenExecutor):
    """A call whose worker gave no answer in time, or ended without one; the message says which."""


class LateError(UnansweredError):
    """A call that has used up its processor time."""


class _Process:
    """A worker process, which executes one call at a time."""

    def __init__(self, quiet: bool) -> None:
        if _main_loads.is_set():
            raise RuntimeError(
                "the main program starts processes while it is loaded: do so below `if __name__ == ...`"
            )
        self._of = os.getpid()
        program = f"import sys; sys.path[:] = {sys.path!r}; from {__name__} import serve; serve()"
        alone: dict[str, Any] = {"process_group": 0} if os.name == "posix" else {"creationflags": 0x200}
        self._popen = subprocess.Popen(
            [sys.executable, "-c", program],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL if quiet else None,
            env={**os.environ, **one_thread(os.environ)},
            **alone,
        )
        assert self._popen.stdin is not None
        assert self._popen.stdout is not None
        self.number, self._asked, self._answers = self._popen.pid, self._popen.stdin, self._popen.stdout

    def answer(self, message: bytes) -> Outcome:
        """Send a call and wait for its outcome.

        Raises
        ------
        UnansweredError : the worker ended without an answer.
        """
        said = None
        with suppress(OSError, ValueError, EOFError, pickle.UnpicklingError):
            pickle.dump(message, self._asked)
            self._asked.flush()
            said = pickle.load(self._answers)
        if said is None:
            with suppress(subprocess.TimeoutExpired):
                self._popen.wait(LAST_WORDS_S)
            self.close()
            if OUT_OF_TIME and self._popen.returncode == OUT_OF_TIME:
                raise LateError
            raise UnansweredError(f"its process ended with code {self._popen.returncode}")
        outcome: Outcome = pickle.loads(said)
        return outcome

    @property
    def ended(self) -> bool:
        """Whether the worker is known to have ended."""
        return self._popen.returncode is not None

    def end(self) -> None:
        """Kill the worker and wait for its end, which is immediate; in a forked copy of the caller do nothing."""
        if self._of == os.getpid():
            self._popen.kill()
            self._popen.wait()

    def close(self) -> None:
        """End the worker and close its pipes; only for the thread that reads from it."""
        self.end()
        for line in (self._asked, self._answers):
            with suppress(OSError):
                line.close()


class Processes(Executor):
    """An executor with worker processes, each served by a thread of this process that waits for its answers.

    A worker is started by the first call that needs it and reused, so that imports and solver objects are prepared
    only once. If a worker dies, its call raises an `UnansweredError` that says how, the others continue, and the next
    call starts a new worker. Warnings of a call are issued again in this process.

    Parameters
    ----------
    workers : largest number of calls at a time.
    quiet : whether the workers' output is dropped; otherwise it goes to the standard error of this process.
    """

    def __init__(self, workers: int, *, quiet: bool = False) -> None:
        self._workers, self._quiet, self.of = workers, quiet, os.getpid()
        self._calls: queue.SimpleQueue[tuple[Future[Any], Any] | None] = queue.SimpleQueue()
        self._threads: list[threading.Thread] = []
        self._live: set[_Process] = set()
        self._closed = self._killed = False
        _executors.add(self)

    @property
    def numbers(self) -> list[int]:
        """Process ids of the running workers."""
        return [process.number for process in self._live.copy()]

    def submit(self, fn: Callable[P, T], /, *args: P.args, **kwargs: P.kwargs) -> "Future[T]":
        if self._closed:
            raise RuntimeError("no call can be submitted after the shutdown")
        future: Future[T] = Future()
        self._calls.put((future, (fn, args, kwargs)))
        if len(self._threads) < self._workers:
            # A daemon thread: waiting for a worker does not keep this process from ending.
            thread = threading.Thread(target=self._serve, daemon=True)
            self._threads.append(thread)
            thread.start()
        return future

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Wait for all calls; with `wait=False` cancel those that have not started, and kill the workers."""
        self._closed, self._killed = True, self._killed or not wait
        if cancel_futures or not wait:
            with suppress(queue.Empty):
                while (waiting := self._calls.get_nowait()) is not None:
                    waiting[0].cancel()
        for _ in self._threads:
            self._calls.put(None)
        if wait:
            for thread in self._threads:
                thread.join()
        for process in self._live.copy():
            process.end()

    def _serve(self) -> None:
        """Body of a thread: execute one call after the other, each in this thread's worker."""
        process: _Process | None = None
        while (waiting := self._calls.get()) is not None:
            future, call = waiting
            if not future.set_running_or_notify_cancel():
                continue
            outcome: Outcome
            try:
                message = _packed(call)
                process = process or self._started()
                outcome = process.answer(message)
            except Exception as error:  # the worker died, or the call or its answer cannot be pickled
                outcome = (None, error, [])
                if process is not None and process.ended:
                    self._live.discard(process)
                    process = None
            try:
                future.set_result(_told(*outcome))
            except Exception as error:
                future.set_exception(error)
        if process is not None:
            process.close()
            self._live.discard(process)

    def _started(self) -> _Process:
        try:
            process = _Process(self._quiet)
        except OSError as error:
            raise UnansweredError(f"its process could not be started ({error})") from None
        self._live.add(process)
        if self._killed:
            process.end()
        return process


def _told(value: Any, error: Exception | None, warned: list[tuple[type[Warning], str]]) -> Any:
    """Issue a call's warnings again, then return its value or raise its exception."""
    for category, text in warned:
        warnings.warn(text, category, stacklevel=3)
    if error is not None:
        raise error
    return value


_one_at_a_time = threading.Lock()
_kept: list[Processes] = []  # the executor of `call`, once it has been started
_executors: "weakref.WeakSet[Processes]" = weakref.WeakSet()


def _running() -> Processes:
    """The executor of `call`; a new one is created on first use, and after a fork of this process."""
    if not _kept or _kept[0].of != os.getpid():
        _kept[:] = [Processes(1, quiet=True)]
    return _kept[0]


@atexit.register
def end() -> None:
    """End all workers of this process; the next `call` starts a new one."""
    for executor in list(_executors):
        executor.shutdown(wait=False)
    _kept.clear()


def call(function: Callable[..., T], *arguments: Any, within_s: float) -> T:
    """Call a function in a worker process and return its value.

    Warnings of the function are issued again in this process. Its output is dropped: native code prints to it.

    Parameters
    ----------
    function : a function that its module contains under its name. It, its arguments, its value and its exceptions
        have to be picklable.
    within_s : limit of the processor time [s] without the worker's start, rounded up to whole seconds. The elapsed
        time may be `SHARED` times as long; on Windows only the elapsed time is bounded.

    Raises
    ------
    UnansweredError : there is no answer in time, or the worker ended without one. The worker is gone then.
    Exception : any exception of the function.
    """
    with _one_at_a_time:
        try:
            _wait(_running().submit(_loaded, function), START_S)
            answer = _running().submit(bounded, within_s, function, *arguments)
            _wait(answer, within_s if resource is None else SHARED * within_s)
        except BaseException:
            # Interrupted or late: the answer is no longer wanted, so the worker is ended.
            while _kept:
                _kept.pop().shutdown(wait=False)
            raise
    try:
        found: T = answer.result()
    except LateError:
        raise UnansweredError(f"no answer within {within_s:.3g} s of a processor") from None
    return found


def _wait(answer: "Future[Any]", within_s: float) -> None:
    deadline = monotonic() + within_s
    while not answer.done():
        if (left := deadline - monotonic()) <= 0:
            raise UnansweredError(f"no answer within {within_s:.3g} s")
        wait([answer], min(left, LOOK_S))


def bounded(within_s: float, function: Callable[..., T], *arguments: Any) -> T:
    """Call a function inside a worker that ends by itself when its time is over.

    The operating system ends it when its processor time is used up. A worker whose caller is gone notices the closed
    pipe, unless native code blocks its other threads; it then ends some time after the caller's deadline.
    """
    faulthandler.dump_traceback_later(SHARED * within_s + ORPHANED_S, exit=True)
    try:
        with _limited(within_s):
            return function(*arguments)
    finally:
        faulthandler.cancel_dump_traceback_later()


@contextmanager
def _limited(more_s: float) -> Iterator[None]:
    """Limit this process's further processor time by the operating system, where that is supported."""
    if resource is None:
        yield
        return
    before = resource.getrlimit(resource.RLIMIT_CPU)
    allowed = [end for end in before if end != resource.RLIM_INFINITY]
    until = min([math.ceil(process_time() + more_s), *allowed])
    resource.setrlimit(resource.RLIMIT_CPU, (until, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_CPU, before)


def _loaded(function: Callable[..., Any]) -> None:
    """Do nothing; as a call, it makes the worker load the function's module."""


def serve() -> None:
    """Main loop of a worker: read a call from the input, write its outcome to the output, repeat."""
    asked, answers = os.fdopen(os.dup(0), "rb"), os.fdopen(os.dup(1), "wb")
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    os.dup2(2, 1)  # output of native code must not mix with the answers
    sys.stdout = sys.stderr
    calls: queue.SimpleQueue[bytes] = queue.SimpleQueue()

    def listen() -> None:
        """Read calls while the caller lives; when it is gone, end this process even during a call."""
        with suppress(EOFError, pickle.UnpicklingError):
            while True:
                calls.put(pickle.load(asked))
        os._exit(0)

    threading.Thread(target=listen, daemon=True).start()
    while True:
        pickle.dump(_answered(calls.get()), answers)
        answers.flush()


def _answered(message: bytes) -> bytes:
    """Execute a pickled call; its pickled outcome."""
    value, error = None, None
    with warnings.catch_warnings(record=True) as warned:
        warnings.simplefilter("always")
        try:
            main, packed = pickle.loads(message)
            _load_main(main)
            function, args, kwargs = pickle.loads(packed)
            value = function(*args, **kwargs)
        except Exception as raised:
            error = raised
    try:
        return pickle.dumps((value, error, [(one.category, str(one.message)) for one in warned]))
    except Exception as unsent:  # an outcome that cannot be pickled is reported as an error
        return pickle.dumps((None, RuntimeError(f"{type(unsent).__name__}: {unsent}"), []))


def _packed(call: Any) -> bytes:
    """The pickled call, with the path of the main program if the call refers to an object of it."""
    packed, main = pickle.dumps(call), {}
    if b"__main__" in packed:
        program = sys.modules["__main__"]
        if name := getattr(program.__spec__, "name", None):
            main = {"init_main_from_name": name}
        elif path := getattr(program, "__file__", None):
            main = {"init_main_from_path": str(Path(path).resolve())}
    return pickle.dumps((main, packed))


_main_loads = threading.Event()


def _load_main(main: dict[str, str]) -> None:
    """Load the caller's main program under another name than `__main__`, as `multiprocessing` does."""
    if main:
        from multiprocessing.spawn import prepare

        _main_loads.set()
        try:
            prepare(main)
        finally:
            _main_loads.clear()
