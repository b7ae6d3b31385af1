"""Number of threads of the linear-algebra libraries: one, unless the user has set another.

Matrices are small here, so that several threads only wait for each other: with four of them a study takes twice the
processor time and 1.5 times the elapsed time. The libraries read the number from environment variables once, when
numpy is loaded; a command sets these before (`one_thread`). For callers from Python numpy is loaded already: building
and verifying a library, solving, certifying and replaying one problem, `Online`, the tasks of a study and the taps of
the page therefore limit the libraries to one thread while they run (`one_blas_thread`).
"""

import os
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from threading import Lock
from typing import Any

# OpenBLAS and MKL read their own variable first, then that of OpenMP.
THREADS = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")


def one_thread(environment: Mapping[str, str]) -> dict[str, str]:
    """Variables to add to an environment so that linear algebra uses one thread.

    Empty if the environment has any of `THREADS`: otherwise the variable of one library would overrule the number
    that the user has set for all of them by OMP_NUM_THREADS.
    """
    return {} if any(name in environment for name in THREADS) else dict.fromkeys(THREADS, "1")


class _Held:
    """A shared limit of one thread, in force from the first caller's entry to the last caller's exit.

    The number of threads belongs to the process, so callers in several Python threads share one limit. If each of
    them restored the number that it found, one could restore the limit set by another.
    """

    def __init__(self) -> None:
        self._lock, self._inside, self._modules = Lock(), 0, 0
        self._libraries: Any = None
        self._limit: Any = None

    def enter(self) -> None:
        with self._lock:
            if self._inside == 0:
                # A library of linear algebra is loaded by a Python module. Searching takes a millisecond, so it is
                # done only after further imports.
                if len(sys.modules) != self._modules:
                    from threadpoolctl import ThreadpoolController

                    self._libraries, self._modules = ThreadpoolController(), len(sys.modules)
                self._limit = self._libraries.limit(limits=1, user_api="blas")
            self._inside += 1  # last, so that a failing search does not count a caller

    def leave(self) -> None:
        with self._lock:
            self._inside -= 1
            if self._inside == 0:
                self._limit.restore_original_limits()
                self._limit = None


_HELD = _Held()


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Limit linear algebra to one thread inside the block, then restore the number; also usable as a decorator.

    It does nothing if the environment sets the number, as that of a command does.
    """
    if any(name in os.environ for name in THREADS):
        yield
        return
    _HELD.enter()
    try:
        yield
    finally:
        _HELD.leave()
