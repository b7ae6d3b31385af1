"""The threads of linear algebra: one, unless the user has said otherwise.

Matrices are small here, and threads of the linear algebra only wait for each other: with four of them a study takes
twice the processor's time, and half as long again. The libraries read how many they may have from environment
variables, once, when numpy is loaded.
"""

from collections.abc import Mapping

# OpenBLAS and MKL read their own first, then OpenMP's.
THREADS = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")


def one_thread(environment: Mapping[str, str]) -> dict[str, str]:
    """What to add to an environment so that linear algebra has one thread.

    Nothing if it states any of `THREADS`: a number that the user has given to all libraries by OMP_NUM_THREADS would
    be overruled by a variable of one library.
    """
    return {} if any(name in environment for name in THREADS) else dict.fromkeys(THREADS, "1")
