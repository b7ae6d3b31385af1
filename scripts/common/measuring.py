"""How the benchmarks measure: methods in turns, on one thread, on a machine that is told."""

import os
import sys
import time
from collections.abc import Callable, Mapping

import numpy as np

from transopt.base.signals import FloatArray

THREAD_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "RAYON_NUM_THREADS")


def on_one_thread() -> None:
    """Start the script anew unless linear algebra has one thread, which its libraries read when they are loaded."""
    one = dict.fromkeys(THREAD_VARIABLES, "1")
    if any(os.environ.get(name) != "1" for name in one):
        os.execve(sys.executable, [sys.executable, *sys.argv], {**os.environ, **one})


def forget() -> None:
    """Empty every cache of the project's, so that the next set-up is a first one."""
    for name, module in list(sys.modules.items()):
        if name.startswith("transopt."):
            for value in list(vars(module).values()):
                if hasattr(value, "cache_clear"):
                    value.cache_clear()


def elapsed_ms(run: Callable[[], object]) -> float:
    start = time.perf_counter()
    run()
    return 1e3 * (time.perf_counter() - start)


def take_turns(
    methods: Mapping[str, Callable[[], object]], runs: Mapping[str, int], told: Callable[[], None] = lambda: None
) -> dict[str, FloatArray]:
    """(runs of it,) wall times [ms] of each method.

    The methods take turns, so that a machine whose speed drifts changes no ratio between them.

    Parameters
    ----------
    told : called after every run.
    """
    times: dict[str, list[float]] = {name: [] for name in methods}
    for turn in range(max(runs.values(), default=0)):
        for name, run in methods.items():
            if turn < runs[name]:
                times[name].append(elapsed_ms(run))
                told()
    return {name: np.array(values) for name, values in times.items()}


def timed(runs: int, **methods: Callable[[], object]) -> dict[str, FloatArray]:
    """(runs,) wall times [ms] of each method, taking turns, after one run that is not counted."""
    for run in methods.values():
        run()
    return take_turns(methods, dict.fromkeys(methods, runs))


def threads() -> int:
    """Threads that linear algebra may use, as its libraries were told when they were loaded."""
    stated = [os.environ.get(name, "") for name in THREAD_VARIABLES[:2]]
    return max((int(value) if value.isdigit() else os.cpu_count() or 1) for value in stated)
