"""The threads of linear algebra: one, unless the user has said otherwise.

Matrices are small here, and threads of the linear algebra only wait for each other: with four of them a study takes
twice the processor's time, and half as long again. The libraries read how many they may have from environment
variables, once, when numpy is loaded: a command states them before (`one_thread`). Called from Python, numpy is there
already: building and verifying a library, solving, certifying and replaying one problem, `Online`, the tasks of a
study and the taps of the page hold them to one while they run (`one_blas_thread`).
"""

import os
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from threading import Lock
from typing import Any

# OpenBLAS and MKL read their own first, then OpenMP's.
THREADS = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")


def one_thread(environment: Mapping[str, str]) -> dict[str, str]:
    """What to add to an environment so that linear algebra has one thread.

    Nothing if it states any of `THREADS`: a number that the user has given to all libraries by OMP_NUM_THREADS would
    be overruled by a variable of one library.
    """
    return {} if any(name in environment for name in THREADS) else dict.fromkeys(THREADS, "1")


class _Held:
    """The libraries' numbers of threads, held at one from the first who comes to the last who goes.

    The numbers belong to the process, so that callers in several threads share one limit: each of them restoring what
    it found would leave the limit of another behind.
    """

    def __init__(self) -> None:
        self._lock, self._inside, self._modules = Lock(), 0, 0
        self._libraries: Any = None
        self._limit: Any = None

    def enter(self) -> None:
        with self._lock:
            if self._inside == 0:
                # A library of linear algebra comes with a module: looked for, in a millisecond, only after imports.
                if len(sys.modules) != self._modules:
                    from threadpoolctl import ThreadpoolController

                    self._libraries, self._modules = ThreadpoolController(), len(sys.modules)
                self._limit = self._libraries.limit(limits=1, user_api="blas")
            self._inside += 1  # last, so that a search that fails leaves nobody inside

    def leave(self) -> None:
        with self._lock:
            self._inside -= 1
            if self._inside == 0:
                self._limit.restore_original_limits()
                self._limit = None


_HELD = _Held()


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Hold linear algebra at one thread; afterwards it has as many as before. Also a decorator of functions.

    Nothing is done where the environment states a number, as a command's own does.
    """
    if any(name in os.environ for name in THREADS):
        yield
        return
    _HELD.enter()
    try:
        yield
    finally:
        _HELD.leave()
