"""Processes that solve entries."""

import multiprocessing
import os
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing.context import BaseContext

from transopt.base.errors import InputError
from transopt.base.files import ctrl_c_waits

THREADS = "OPENBLAS_NUM_THREADS"  # of the workers' linear algebra: one, unless stated, or they fight each other
FORKS = "forkserver" in multiprocessing.get_all_start_methods()
# What designing takes; scipy loads its parts when they are used.
DESIGNING = ("transopt.design.entry", "scipy.fft", "scipy.integrate", "scipy.interpolate")


def context(preload: Sequence[str] = DESIGNING) -> BaseContext:
    """How worker processes start: forked from a server process of their own that has the designer loaded.

    Not from this one, whose solver objects and threads a fork would copy half-alive; and not each anew, which takes
    longer than solving a hundred entries. Where there is no such server, each anew. The server is started here and
    loads while this process does something else: call it as soon as workers are known to be wanted.

    Parameters
    ----------
    preload : modules that the server loads when it is started; later calls have no say.
    """
    if not FORKS:
        return multiprocessing.get_context("spawn")
    from multiprocessing import forkserver, resource_tracker

    forks = multiprocessing.get_context("forkserver")
    forks.set_forkserver_preload(list(preload))
    resource_tracker.ensure_running()  # which would let Ctrl-C through again
    stated = os.environ.get(THREADS)
    os.environ[THREADS] = "1" if stated is None else stated
    try:
        with ctrl_c_waits():
            forkserver.ensure_running()
    finally:
        if stated is None:
            del os.environ[THREADS]
    return forks


@contextmanager
def pool(jobs: int) -> Iterator[ProcessPoolExecutor]:
    """So many worker processes; a block that is left by an exception leaves undone what they have not begun."""
    with ProcessPoolExecutor(jobs, context()) as workers:
        try:
            yield workers
        except BrokenProcessPool:
            raise InputError(
                f"--jobs {jobs}: a worker process died, of too little memory or killed; try fewer"
            ) from None
        except BaseException:
            workers.shutdown(wait=False, cancel_futures=True)
            raise
