"""Calls that run in a process of their own, which can be ended at any instant.

A method in native code may search for minutes, may not return at all, and may even end its process. Python answers a
signal between two of its own instructions only, so a Ctrl-C has to wait until such a method returns. Here the method
runs in a second process, and this one waits for the answer where it can be interrupted. When the time is up, or when
a signal ends the wait, the second process is killed.

The process is started by the first call and kept for the next ones, so that what a method prepares once (imports,
solver objects) is prepared once. Who wants several side by side has processes of his own (`Process`), of which each
takes one call after the other. Each is a plain Python process that speaks through its standard input and output: it
needs no fork, and it does not run the caller's main program again as `multiprocessing` would.
"""

import atexit
import faulthandler
import os
import pickle
import queue
import signal
import subprocess
import sys
import threading
import warnings
import weakref
from collections.abc import Callable
from contextlib import suppress
from time import monotonic
from typing import IO, Any, TypeVar

from transopt.base.files import ctrl_c_waits
from transopt.base.threads import one_thread

T = TypeVar("T")

START_S = 120.0  # for the process to load what a call needs; a second on an idle machine
LOOK_S = 0.1  # between two looks at the clock: on Windows nothing else lets a Ctrl-C through
ORPHANED_S = 5.0  # after the caller's own deadline: whoever had to end the process is gone
BEGUN = b"begun"
Outcome = tuple[Any, Exception | None, list[tuple[type[Warning], str]]]  # value, what was raised, warnings


class UnansweredError(RuntimeError):
    """A call whose process gave no answer in time, or ended without one; the message says which."""


class Process:
    """Another process for calls, and the thread of this one that listens to it; it ends with this one."""

    def __init__(self) -> None:
        self.of = os.getpid()
        self._within_s = 0.0
        program = f"import sys; sys.path[:] = {sys.path!r}; from {__name__} import serve; serve()"
        alone: dict[str, Any] = {"process_group": 0} if os.name == "posix" else {"creationflags": 0x200}
        # A group of its own: a Ctrl-C in the terminal is this process's, which ends the other one.
        self._popen = subprocess.Popen(
            [sys.executable, "-c", program],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            env={**os.environ, **one_thread(os.environ)},
            **alone,
        )
        assert self._popen.stdin is not None
        assert self._popen.stdout is not None
        self._line, self._said = self._popen.stdin, _received(self._popen.stdout)
        _started.add(self)

    @property
    def number(self) -> int:
        """The number of the process, as the system counts."""
        return self._popen.pid

    def ask(self, function: Callable[..., Any], *arguments: Any, within_s: float) -> None:
        """Begin a call; `answer` has its end, and until then no other may begin.

        Parameters
        ----------
        function, arguments, within_s : as of `call`.
        """
        self._within_s = within_s
        with suppress(OSError):  # has ended: `answer` tells
            _send(pickle.dumps((function, arguments, within_s)), self._line)

    def answer(self) -> Any:
        """What the function returns that was asked for; raises what `call` raises, and is of no more use after an
        `UnansweredError`.
        """
        return _told(*self.outcome())

    def outcome(self) -> "Outcome":
        """How the call ended that was asked for.

        Raises
        ------
        UnansweredError : there is no answer in time, or the process ended without one.
        """
        self._hear(START_S)
        outcome: Outcome = pickle.loads(self._hear(self._within_s))
        return outcome

    def _hear(self, within_s: float) -> bytes:
        """The next message of the process.

        Raises
        ------
        UnansweredError : there is none in time, or the process has ended.
        """
        deadline = monotonic() + within_s
        while (left := deadline - monotonic()) > 0:
            with suppress(queue.Empty):
                said = self._said.get(timeout=min(left, LOOK_S))
                if said is None:
                    raise UnansweredError(f"its process ended with code {self._popen.wait()}")
                return said
        raise UnansweredError(f"no answer within {within_s:.3g} s")

    def end(self) -> None:
        """Kill the process and wait for its end, which is immediate; a fork of this one has none to kill."""
        if self.of != os.getpid():
            return
        self._popen.kill()
        self._popen.wait()
        with suppress(OSError):
            self._line.close()


def _told(value: Any, error: Exception | None, warned: list[tuple[type[Warning], str]]) -> Any:
    """The value of a call, its warnings given here again; or what it raised."""
    for category, text in warned:
        warnings.warn(text, category, stacklevel=3)
    if error is not None:
        raise error
    return value


_one_at_a_time = threading.Lock()
_kept: list[Process] = []  # the process of this one that `call` speaks to, if it has been started
_started: "weakref.WeakSet[Process]" = weakref.WeakSet()


def _running() -> Process:
    """The process of this one; another is started where there is none, also after a fork of this one."""
    if not _kept or _kept[0].of != os.getpid():
        with ctrl_c_waits():  # between its start and its place here it would be nobody's
            _kept[:] = [Process()]
    return _kept[0]


@atexit.register
def end() -> None:
    """End all processes of this one; the next call starts another."""
    for process in list(_started):  # before the last reference to one is gone, with which nobody could end it
        process.end()
    _kept.clear()


def call(function: Callable[..., T], *arguments: Any, within_s: float) -> T:
    """What a function returns that runs in a process of its own.

    Warnings that the function gives are given here again. What it prints is lost: it is native code that prints.

    Parameters
    ----------
    function : of a module, found there by its name; with its arguments, its answer and its exceptions it can be
        pickled.
    within_s : most time for the answer, without the start of the process.

    Raises
    ------
    UnansweredError : there is no answer in time, or the process ended without one. It is gone then.
    Exception : what the function raises.
    """
    with _one_at_a_time:
        try:
            process = _running()
            process.ask(function, *arguments, within_s=within_s)
            outcome = process.outcome()
        except BaseException:
            # Interrupted, late or dead: whatever it is doing, nobody will hear of it.
            while _kept:
                _kept.pop().end()
            raise
    answer: T = _told(*outcome)
    return answer


def serve() -> None:
    """What the second process does: take a call from its input, write the answer to its output, and so on."""
    if hasattr(signal, "pthread_sigmask"):
        signal.pthread_sigmask(signal.SIG_SETMASK, ())  # the one who started it held signals back
    # What native code prints must not get among the answers.
    answers = os.fdopen(os.dup(1), "wb")
    with open(os.devnull, "r+b") as nothing:  # noqa: PTH123 - a device
        for stream in (1, 2):
            os.dup2(nothing.fileno(), stream)
        # While the one who calls lives, another call follows; when it is gone, in the middle of one, this ends too.
        calls = _received(sys.stdin.buffer, at_the_end=lambda: os._exit(0))
        while (message := calls.get()) is not None:
            function, arguments, within_s = pickle.loads(message)
            _send(BEGUN, answers)
            # Only for the case that native code keeps the thread that reads from noticing this.
            faulthandler.dump_traceback_later(within_s + ORPHANED_S, exit=True, file=nothing)
            value, error = None, None
            with warnings.catch_warnings(record=True) as warned:
                warnings.simplefilter("always")
                try:
                    value = function(*arguments)
                except Exception as raised:
                    error = raised
            faulthandler.cancel_dump_traceback_later()
            _send(_pickled(value, error, [(one.category, str(one.message)) for one in warned]), answers)


def _pickled(*answer: Any) -> bytes:
    try:
        return pickle.dumps(answer)
    except Exception as error:  # that it cannot be sent is an answer too
        return pickle.dumps((None, RuntimeError(f"{type(error).__name__}: {error}"), []))


def _send(message: bytes, line: IO[bytes]) -> None:
    line.write(len(message).to_bytes(8, "little") + message)
    line.flush()


def _received(line: IO[bytes], at_the_end: Callable[[], None] = lambda: None) -> "queue.SimpleQueue[bytes | None]":
    """The messages that come on a line, taken from it by a thread, and None when it has ended."""
    messages: queue.SimpleQueue[bytes | None] = queue.SimpleQueue()

    def receive() -> None:
        with suppress(OSError), line:
            while size := line.read(8):
                messages.put(line.read(int.from_bytes(size, "little")))
        messages.put(None)
        at_the_end()

    threading.Thread(target=receive, daemon=True).start()
    return messages
