"""Writing files whole or not at all, and steps that Ctrl-C must not cut in two."""

import math
import os
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO

from transopt.base.errors import InputError


@contextmanager
def whole_file(path: Path) -> Iterator[BinaryIO]:
    """A binary file that appears under `path` when the block ends well, and not at all otherwise.

    It is written beside its place under a temporary name, then renamed over it.

    Raises
    ------
    InputError : the place cannot be written.
    """
    temporary = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        try:
            with temporary.open("wb") as file:
                yield file
            temporary.replace(path)
        except BaseException:
            temporary.unlink(missing_ok=True)
            raise
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror}); choose another place") from None


@contextmanager
def ctrl_c_waits() -> Iterator[None]:
    """A Ctrl-C or SIGTERM that comes inside is answered at the end; processes started inside never see a Ctrl-C.

    A Ctrl-C is held back in this thread, which a process started here inherits. The system may hand a signal to
    another thread, and Python then answers it in the main thread all the same: so the answers are put off too.
    """
    waiting = [number for number in (signal.SIGINT, signal.SIGTERM) if _answered_here(number)]
    came: list[int] = []
    masks = hasattr(signal, "pthread_sigmask")  # Windows has no signal masks
    previous = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT}) if masks else set()
    answers = {number: signal.signal(number, lambda given, _: came.append(given)) for number in waiting}
    try:
        yield
    finally:
        if masks:
            signal.pthread_sigmask(signal.SIG_SETMASK, previous)
        for number, answer in answers.items():
            signal.signal(number, answer)
        for given in came:
            signal.raise_signal(given)


def _answered_here(number: int) -> bool:
    """Whether a signal has an answer in Python, and this is the thread that gives it."""
    return threading.current_thread() is threading.main_thread() and callable(signal.getsignal(number))


def without_nan(value: Any) -> Any:
    """A copy of nested dictionaries and lists with None for every number that JSON cannot hold (NaN, infinity)."""
    if isinstance(value, dict):
        return {key: without_nan(item) for key, item in value.items()}
    if isinstance(value, list):
        return [without_nan(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
