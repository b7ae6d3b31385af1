"""Writing files whole or not at all, and steps that Ctrl-C must not cut in two."""

import math
import os
import signal
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
    """A Ctrl-C that comes inside is delivered at the end; processes started inside never see one."""
    if not hasattr(signal, "pthread_sigmask"):
        yield  # Windows has no signal masks
        return
    previous = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, previous)


def without_nan(value: Any) -> Any:
    """A copy of nested dictionaries and lists with None for every number that JSON cannot hold (NaN, infinity)."""
    if isinstance(value, dict):
        return {key: without_nan(item) for key, item in value.items()}
    if isinstance(value, list):
        return [without_nan(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
