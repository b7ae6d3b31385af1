"""Calls that run in processes of their own, which can be ended at any instant.

A method in native code may search for minutes, may not return at all, and may even end its process. Python answers a
signal between two of its own instructions only, so a Ctrl-C has to wait until such a method returns. In a second
process the method keeps nobody: whoever waits for the answer can be interrupted, and the process is killed then.

`call` bounds the processor time of one call, so that a busy machine changes no answer. `Processes` is an executor of
`concurrent.futures`, for tasks side by side. The executors of the standard library and of loky do not serve: there
the death of one process ends the tasks of all others too, and no other task can be submitted afterwards.

Each process is a plain Python that speaks through its standard input and output. It needs no fork, which would copy
the threads of this process half-alive. It loads the caller's main program only to find a function of that program.
It has a process group of its own, so that a Ctrl-C in the terminal goes to this process alone, which ends the others.
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
except ImportError:  # Windows, where only the clock on the wall ends a call
    resource = None  # type: ignore[assignment]

P = ParamSpec("P")
T = TypeVar("T")

START_S = 120.0  # for the process to load what a call needs; a second on an idle machine
SHARED = 10.0  # times that a call may take on the clock: others use the processor as well
LOOK_S = 0.1  # between two looks at the clock: on Windows nothing else lets a Ctrl-C through
ORPHANED_S = 5.0  # after the caller's own deadline: whoever had to end the process is gone
LAST_WORDS_S = 1.0  # between a closed line and the exit code of the process at its other end
OUT_OF_TIME = -getattr(signal, "SIGXCPU", 0)  # how a process ends whose processor time is used up
Outcome = tuple[Any, Exception | None, list[tuple[type[Warning], str]]]  # value, what was raised, warnings


class UnansweredError(BrokenExecutor):
    """A call whose process gave no answer in time, or ended without one; the message says which."""


class LateError(UnansweredError):
    """A call that has used up its processor time."""


class _Process:
    """Another process for calls, one at a time."""

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
        """How a call ends.

        Raises
        ------
        UnansweredError : the process ended without an answer.
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
        """Whether its end has been noticed."""
        return self._popen.returncode is not None

    def end(self) -> None:
        """Kill the process and wait for its end, which is immediate; a fork of this one has none to kill."""
        if self._of == os.getpid():
            self._popen.kill()
            self._popen.wait()

    def close(self) -> None:
        """End the process and close the line to it; only for the thread that listens to it."""
        self.end()
        for line in (self._asked, self._answers):
            with suppress(OSError):
                line.close()


class Processes(Executor):
    """Processes for calls side by side, each served by a thread of this one that waits for its answers.

    A process is started by the first call that needs it and kept for the next ones, so that what a call prepares once
    (imports, solver objects) is prepared once. Where one dies, its call ends in an `UnansweredError` that says how,
    the others go on, and the next call starts another. Warnings that a call gives are given here again.

    Parameters
    ----------
    workers : most calls at a time.
    quiet : whether what the processes print is dropped; otherwise it goes to the standard error of this process.
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
        """Numbers of the processes that run, as the system counts them."""
        return [process.number for process in self._live.copy()]

    def submit(self, fn: Callable[P, T], /, *args: P.args, **kwargs: P.kwargs) -> "Future[T]":
        if self._closed:
            raise RuntimeError("no call can be submitted after the shutdown")
        future: Future[T] = Future()
        self._calls.put((future, (fn, args, kwargs)))
        if len(self._threads) < self._workers:
            # A daemon: a thread that waits for its process does not keep this one up.
            thread = threading.Thread(target=self._serve, daemon=True)
            self._threads.append(thread)
            thread.start()
        return future

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Wait for all calls; with `wait=False` cancel those that have not started, and kill the processes."""
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
        """What a thread does: one call after the other, each in the process of this thread."""
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
            except Exception as error:  # it died, or the call or its answer cannot be sent
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
    """The value of a call, its warnings given here again; or what it raised."""
    for category, text in warned:
        warnings.warn(text, category, stacklevel=3)
    if error is not None:
        raise error
    return value


_one_at_a_time = threading.Lock()
_kept: list[Processes] = []  # the executor that `call` speaks to, if it has been started
_executors: "weakref.WeakSet[Processes]" = weakref.WeakSet()


def _running() -> Processes:
    """The executor of `call`; another is made where there is none, also after a fork of this process."""
    if not _kept or _kept[0].of != os.getpid():
        _kept[:] = [Processes(1, quiet=True)]
    return _kept[0]


@atexit.register
def end() -> None:
    """End all processes of this one; the next `call` starts another."""
    for executor in list(_executors):
        executor.shutdown(wait=False)
    _kept.clear()


def call(function: Callable[..., T], *arguments: Any, within_s: float) -> T:
    """What a function returns that runs in a process of its own.

    Warnings that the function gives are given here again. What it prints is lost: it is native code that prints.

    Parameters
    ----------
    function : of a module, found there by its name; with its arguments, its answer and its exceptions it can be
        pickled.
    within_s : most processor time for the answer, without the start of the process; counted in whole seconds, rounded
        up. On the clock it may take `SHARED` times as long, and on Windows only the clock counts.

    Raises
    ------
    UnansweredError : there is no answer in time, or the process ended without one. It is gone then.
    Exception : what the function raises.
    """
    with _one_at_a_time:
        try:
            _wait(_running().submit(_loaded, function), START_S)
            answer = _running().submit(bounded, within_s, function, *arguments)
            _wait(answer, within_s if resource is None else SHARED * within_s)
        except BaseException:
            # Interrupted or late: whatever it is doing, nobody will hear of it.
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
    """What a function returns, in a process that ends by itself when its time is over.

    The system ends it when its processor time is used up. A process whose caller is gone notices that by the line
    between them, unless native code keeps its other threads: then it ends some time after the caller's deadline.
    """
    faulthandler.dump_traceback_later(SHARED * within_s + ORPHANED_S, exit=True)
    try:
        with _limited(within_s):
            return function(*arguments)
    finally:
        faulthandler.cancel_dump_traceback_later()


@contextmanager
def _limited(more_s: float) -> Iterator[None]:
    """Have the system end this process when it has used so much more processor time, where the system can."""
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
    """Nothing; when it returns, the process has loaded the module of the function."""


def serve() -> None:
    """What the second process does: take a call from its input, write the answer to its output, and so on."""
    asked, answers = os.fdopen(os.dup(0), "rb"), os.fdopen(os.dup(1), "wb")
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    os.dup2(2, 1)  # what native code prints must not get among the answers
    sys.stdout = sys.stderr
    calls: queue.SimpleQueue[bytes] = queue.SimpleQueue()

    def listen() -> None:
        """While the one who calls lives, another call follows; when it is gone, amid one, this process ends too."""
        with suppress(EOFError, pickle.UnpicklingError):
            while True:
                calls.put(pickle.load(asked))
        os._exit(0)

    threading.Thread(target=listen, daemon=True).start()
    while True:
        pickle.dump(_answered(calls.get()), answers)
        answers.flush()


def _answered(message: bytes) -> bytes:
    """How a call ends, as it is sent."""
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
    except Exception as unsent:  # that it cannot be sent is an answer too
        return pickle.dumps((None, RuntimeError(f"{type(unsent).__name__}: {unsent}"), []))


def _packed(call: Any) -> bytes:
    """A call as it is sent, with the place of the main program where the call has something of it."""
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
