"""Timing for the benchmarks: methods take turns, on one thread."""

import os
import sys
import time
from collections.abc import Callable, Mapping

import numpy as np

from transopt.base.signals import FloatArray

THREAD_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "RAYON_NUM_THREADS")


def on_one_thread() -> None:
    """Restart the script with one thread for linear algebra, which its libraries read only when they are loaded."""
    one = dict.fromkeys(THREAD_VARIABLES, "1")
    if any(os.environ.get(name) != "1" for name in one):
        os.execve(sys.executable, [sys.executable, *sys.argv], {**os.environ, **one})


def forget() -> None:
    """Clear all caches of the project, so that the next set-up starts cold."""
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

    The methods take turns, so that a drift of the machine's speed does not change their ratios.

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
    """(runs,) wall times [ms] of each method in turns, after one warm-up run."""
    for run in methods.values():
        run()
    return take_turns(methods, dict.fromkeys(methods, runs))


def threads() -> int:
    """Number of threads of the linear algebra, as set when its libraries were loaded."""
    stated = [os.environ.get(name, "") for name in THREAD_VARIABLES[:2]]
    return max((int(value) if value.isdigit() else os.cpu_count() or 1) for value in stated)
