"""A user's own solver, from a Python file, among the methods."""

import inspect
import signal
import threading
from collections.abc import Callable
from functools import partial
from importlib import util
from pathlib import Path
from types import FrameType
from typing import Any, TypeVar

import numpy as np

from precision.methods import NONE, TIME_LIMIT_S, Level, Method, Setting, error_line, sweep
from precision.qp import QP
from precision.wheels import Point, Solve, qp_method
from transopt.base.errors import InputError

TOLERANCES = (1e-2, 1e-4, 1e-6, 1e-8, 1e-10)
USUAL = 1e-6  # where the function has no default of its own
AGAIN_S = 0.5  # between further alarms, for code that swallows the first
T = TypeVar("T")


class _Late(BaseException):
    """The time limit, not a subclass of Exception, so that a user's `except Exception` does not catch it."""


def within(limit_s: float, work: Callable[[], T]) -> T:
    """What the work returns, cut off at a time limit.

    The alarm is heard between two instructions of Python: a call of native code that does not return is not cut. Nor
    is anything where there is no such alarm (Windows) or off the main thread.

    Raises
    ------
    TimeoutError : it was cut.
    """
    if not hasattr(signal, "setitimer") or threading.current_thread() is not threading.main_thread():
        return work()

    def late(number: int, frame: FrameType | None) -> None:
        raise _Late

    previous = signal.signal(signal.SIGALRM, late)
    try:
        try:
            signal.setitimer(signal.ITIMER_REAL, limit_s, AGAIN_S)
            return work()
        finally:
            signal.setitimer(signal.ITIMER_REAL, 0.0)
    except _Late:
        raise TimeoutError(f"time limit of {limit_s:g} s") from None
    finally:
        signal.signal(signal.SIGALRM, previous)


def _point(returned: Any, qp: QP) -> Point:
    """x, (x, y) or (x, y, {"iterations": ..., "status": ...}) as a point.

    Raises
    ------
    ValueError : something else.
    """
    parts = returned if isinstance(returned, tuple) else (returned,)
    if not 1 <= len(parts) <= 3:
        raise ValueError(f"solve returned {len(parts)} values; expected x, (x, y) or (x, y, info)")
    x, y, info = (*parts, *(None, None, None)[len(parts) :])
    x = np.asarray(x, dtype=float)
    if x.shape != qp.q.shape:
        raise ValueError(f"solve returned x of shape {x.shape}; expected {qp.q.shape}")
    if y is not None:
        y = np.asarray(y, dtype=float)
        if y.shape != qp.l.shape:
            raise ValueError(f"solve returned y of shape {y.shape}; expected {qp.l.shape}")
    told = info or {}
    return Point(x, y, str(told.get("status", "returned")), int(told.get("iterations", -1)))


def user_method(path: Path) -> Method:
    """The method of a file that defines `solve(qp)`, or `solve(qp, tolerance)` for a curve.

    Raises
    ------
    InputError : no such file, a file that does not run within the time limit, or one without such a function.
    """
    if not path.is_file():
        raise InputError(f"--method {path}: no such file")
    spec = util.spec_from_file_location(f"user_method_{path.stem}", path)
    if spec is None or spec.loader is None:
        raise InputError(f"--method {path}: no Python file; it has to end in .py")
    module = util.module_from_spec(spec)
    try:
        within(TIME_LIMIT_S, partial(spec.loader.exec_module, module))
    except (Exception, SystemExit) as error:
        raise InputError(f"--method {path}: does not run ({error_line(error)})") from None
    solve = getattr(module, "solve", None)
    if not callable(solve):
        raise InputError(f"--method {path}: defines no function solve(qp)")
    try:
        names = list(inspect.signature(solve).parameters)
    except (TypeError, ValueError):
        names = ["qp"]
    if not names:
        raise InputError(f"--method {path}: solve takes no argument; it is called as solve(qp)")
    settings = [Setting("as the file has it", NONE, Level.DEFAULT)]
    if "tolerance" in names:
        settings = sweep("tolerance not given", TOLERANCES, TOLERANCES[-1], "tolerance")
        if inspect.signature(solve).parameters["tolerance"].default is inspect.Parameter.empty:
            others = [setting for setting in settings[1:] if setting.tolerance != USUAL]
            settings = [Setting(f"tolerance {USUAL:g}", USUAL, Level.DEFAULT), *others]

    def build(qp: QP, setting: Setting) -> Solve:
        chosen = {} if np.isnan(setting.tolerance) else {"tolerance": setting.tolerance}
        return lambda: _point(within(TIME_LIMIT_S, lambda: solve(qp, **chosen)), qp)

    return qp_method(path.stem, "user's", settings, build)
