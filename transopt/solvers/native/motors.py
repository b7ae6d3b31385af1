"""Interface (ctypes) to the compiled interior-point method for several motors (`motors.c`); it releases the GIL.

It is part of the same optional extension as the method for one motor. Where that was not built, `available` is False.
"""

import ctypes as ct
import threading
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from transopt.base.recursions import address
from transopt.base.signals import FloatArray
from transopt.solvers.native.extension import EXTENSION

MOST_STATES, MOST_MOTORS, MOST_ROWS, MOST_OUTPUTS = 64, 4, 64, 32  # of motors.c
INTERFACE = 1  # as `tm_interface` of motors.c
SOLVED, ACCURACY = 0, 1  # codes of an answer; the others are failures
SIZES = ("stages", "free_stages", "states", "motors", "outputs", "ends", "rows")
ARRAYS = ("A", "C", "E", "weight", "reference", "end_gain", "end_target", "G", "d", "motor", "lower", "upper")
NUMBERS = ("movement_weight", "command_bound", "constant")


class _Problem(ct.Structure):
    _fields_ = (
        *[(name, ct.c_int) for name in SIZES],
        *[(name, ct.c_void_p) for name in ARRAYS],
        *[(name, ct.c_double) for name in NUMBERS],
    )


class _Result(ct.Structure):
    _fields_ = (
        *[(name, ct.c_void_p) for name in ("command", "lower", "upper", "gradient")],
        ("iterations", ct.c_int),
        *[(name, ct.c_double) for name in ("objective", "gap", "residual")],
    )


def _library() -> ct.CDLL | None:
    file = Path(__file__).with_name(EXTENSION)
    if not file.exists():
        return None
    library = ct.CDLL(str(file))
    if not hasattr(library, "tm_interface") or library.tm_interface() != INTERFACE:
        return None  # built from another version: not usable
    library.tm_workspace.restype, library.tm_workspace.argtypes = ct.c_size_t, (ct.POINTER(_Problem),)
    library.tm_solve.argtypes = (ct.POINTER(_Problem), ct.c_int, ct.c_double, ct.c_void_p, ct.POINTER(_Result))
    return library


_LIBRARY = _library()
available = _LIBRARY is not None
_memory = threading.local()


class Answer(NamedTuple):
    """The returned iterate with its objective and gap, both in units of 1e-3.

    Attributes
    ----------
    command, gradient : (N, m) commands, and the Lagrangian's gradient by their movements, the hand-over fed back.
    lower, upper : (N, rows) multipliers >= 0.
    code : 0 solved, 1 solved up to rounding, otherwise a failure.
    """

    command: FloatArray
    lower: FloatArray
    upper: FloatArray
    gradient: FloatArray
    code: int
    iterations: int
    objective: float
    gap: float


def interior_point(
    sizes: Mapping[str, int],
    numbers: Mapping[str, float],
    arrays: Mapping[str, Any],
    *,
    tolerance: float,
    max_iterations: int,
) -> Answer:
    """Solve a problem whose fields are those of `tm_problem`; the arrays are contiguous.

    Parameters
    ----------
    tolerance : on the gap, relative to max(J, 1e-3), and on the residuals of the limits, in their units.
    """
    assert _LIBRARY is not None
    problem = _Problem(**sizes, **numbers, **{name: address(arrays[name]) for name in ARRAYS})
    N, m, R = (sizes[name] for name in ("stages", "motors", "rows"))
    found = np.zeros((N, m)), np.zeros((N, R)), np.zeros((N, R)), np.zeros((N, m))
    result = _Result(*map(address, found))
    space = _workspace(_LIBRARY.tm_workspace(ct.byref(problem)))
    code = _LIBRARY.tm_solve(ct.byref(problem), max_iterations, tolerance, address(space), ct.byref(result))
    return Answer(*found, code, result.iterations, result.objective, result.gap)


def _workspace(doubles: int) -> FloatArray:
    """The workspace of this thread, reused: allocating fresh memory takes as long as solving a short problem."""
    kept: FloatArray | None = getattr(_memory, "space", None)
    if kept is None or kept.size < doubles:
        kept = _memory.space = np.empty(max(doubles, 1))
    return kept
