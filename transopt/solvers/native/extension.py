"""Interface (ctypes) to the compiled interior-point method (`riccati.c`); it does not need CasADi.

The method releases the GIL while it works and polls for signals, so that Ctrl-C ends it within one iteration.

The extension is optional. Where it was not built, `available` is False.
"""

import ctypes as ct
import os
import threading
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from transopt.base.recursions import address
from transopt.base.signals import FloatArray
from transopt.solvers.bounds import check_bounds
from transopt.solvers.stage_data import Stages, records_of

EXTENSION = "_riccati.pyd" if os.name == "nt" else "_riccati.so"
MOST_STATES, MOST_MOTORS, MOST_ROWS = 96, 4, 128  # of riccati.c
INTERFACE = 14  # version as in `tr_interface` of riccati.c; both change with the meaning of arguments or results


class _Host(ct.Structure):
    _fields_ = tuple((name, ct.c_void_p) for name in ("release", "acquire", "interrupted"))


class _Options(ct.Structure):
    _fields_ = (("max_iterations", ct.c_int), ("tolerance", ct.c_double), ("host", ct.POINTER(_Host)))


ADDRESS, INTEGER, NUMBER = (np.dtype(kind) for kind in (ct.c_void_p, ct.c_int, ct.c_double))
# `tr_result` and `tr_proof` of riccati.c.
RESULT = [
    *[(name, ADDRESS) for name in ("command", "size", "lower", "upper", "gradient", "start")],
    *[(name, INTEGER) for name in ("code", "iterations", "first")],
    *[(name, NUMBER) for name in ("objective", "gap", "residual")],
]
PROOF = [
    *[(name, ADDRESS) for name in ("command", "by_lower", "by_upper", "by_rule", "lower", "upper", "excess")],
    *[(name, NUMBER) for name in ("objective", "slack", "residual", "dual_residual", "by_command", "by_movement")],
]


def _library() -> ct.CDLL | None:
    file = Path(__file__).with_name(EXTENSION)
    if not file.exists():
        return None
    # PyDLL keeps the GIL held at entry and exit, so that an exception raised by a signal handler leaves the call.
    library = ct.PyDLL(str(file))
    if not hasattr(library, "tr_interface") or library.tr_interface() != INTERFACE:
        return None  # built from another version: not usable
    array = ct.c_void_p  # the address of an array of structures, or of doubles
    library.tr_workspace.restype, library.tr_workspace.argtypes = ct.c_size_t, (ct.c_int, array)
    library.tr_solve.argtypes = (ct.c_int, array, ct.POINTER(_Options), array, array)
    library.tr_linear.argtypes = library.tr_solve.argtypes
    library.tr_shortened_workspace.restype, library.tr_shortened_workspace.argtypes = ct.c_size_t, (array,)
    library.tr_shortened.argtypes = (array, ct.c_int, ct.POINTER(_Options), array, array)
    library.tr_prove.argtypes = (ct.c_int, array, array, array)
    library.tr_device_workspace.restype, library.tr_device_workspace.argtypes = ct.c_size_t, (array,)
    library.tr_device_stages.restype = ct.c_double
    library.tr_device_stages.argtypes = (array, array, ct.c_double, array, array)
    return library


def _host() -> _Host:
    """The interpreter as `tr_host`: functions that release and take the GIL and that check for signals."""
    names = ("PyEval_SaveThread", "PyEval_RestoreThread", "PyErr_CheckSignals")
    return _Host(*(ct.cast(getattr(ct.pythonapi, name), ct.c_void_p) for name in names))


_LIBRARY = _library()
available = _LIBRARY is not None


def takes(states: int, motors: int, rows: int) -> bool:
    """Whether the method takes problems of these sizes, the states of the temperature included."""
    return states <= MOST_STATES and motors <= MOST_MOTORS and rows <= MOST_ROWS


_HOST = ct.pointer(_host())
SOLVED, ACCURACY, NO_BOUNDS = 0, 1, 6  # codes of an answer; the others are failures


class Answer(NamedTuple):
    """The returned iterate of the method, in scaled units.

    Attributes
    ----------
    code : 0 solved, 1 solved up to rounding, otherwise a failure. gap, objective : in units of 1e-3.
    command, gradient : (N,) commands, and the Lagrangian's gradient by the movements; (m, N) with m motors.
    lower, upper : (N + 1, rows) multipliers >= 0.
    """

    code: int
    iterations: int
    objective: float
    gap: float
    residual: float
    command: FloatArray
    gradient: FloatArray
    lower: FloatArray
    upper: FloatArray

    @property
    def relative_gap(self) -> float:
        """The gap relative to max(J, 1e-3); infinite where it is NaN."""
        relative = self.gap / max(self.objective, 1.0)
        return relative if np.isfinite(relative) else np.inf


MOST_KEPT_BYTES = 2**25  # largest workspace kept per thread; enough for eight problems of a thousand stages
_memory = threading.local()


def _workspace(needed: int) -> FloatArray:
    """So many doubles, the workspace of this thread: fresh memory takes as long as solving a short problem."""
    kept: FloatArray = vars(_memory).setdefault("kept", np.empty(0))
    if kept.size >= needed:
        return kept
    fresh = np.empty(needed)
    if fresh.nbytes <= MOST_KEPT_BYTES:
        _memory.kept = fresh
    return fresh


def _at(arrays: Mapping[str, FloatArray], fields: list[tuple[str, np.dtype[Any]]]) -> NDArray[np.void]:
    """An array of a C structure whose addresses are those of the rows of arrays, by the name of the field."""
    count = len(next(iter(arrays.values())))
    found = np.zeros(count, dtype=np.dtype(fields, align=True))
    for name, array in arrays.items():
        found[name] = address(array) + array.strides[0] * np.arange(count)
    return found


def of_equal_sizes(given: Sequence[Stages]) -> Iterator[list[int]]:
    """Groups of indices of problems with equal sizes, which can be solved side by side."""
    groups: dict[tuple[int, ...], list[int]] = {}
    for i, stages in enumerate(given):
        groups.setdefault(tuple(stages.sizes.values()), []).append(i)
    yield from groups.values()


def _answers(
    method: Any, given: Sequence[Stages], asked: _Options, cut: int = 0, first: Sequence[int] = ()
) -> list[Answer]:
    """Answers of `tr_solve` or `tr_linear` to problems of any sizes, in their order.

    With a `cut`, there is one problem, and its answer is that of `tr_shortened`.
    """
    assert _LIBRARY is not None
    found: dict[int, Answer] = {}
    for group in of_equal_sizes(given):
        some, count = [given[i] for i in group], len(group)
        N, motors, rows, nodes = (some[0].sizes[name] for name in ("stages", "motors", "rows", "nodes"))
        (command, gradient), size = np.zeros((2, count, N, motors)), np.zeros((count, N))
        # An empty NumPy array has no usable address for C: there is always room for one row.
        sides = np.zeros((2, count, (N + 1) * max(rows, 1)))
        start = np.zeros((count, max(nodes, 1)))
        arrays = {"command": command, "size": size, "gradient": gradient, "start": start}
        problems = records_of([each.record for each in some])
        results = _at(arrays | {"lower": sides[0], "upper": sides[1]}, RESULT)
        results["first"] = [first[i] for i in group] if first else 0
        at, into = problems.ctypes.data, results.ctypes.data
        if cut:
            space = _workspace(_LIBRARY.tr_shortened_workspace(at))
            _LIBRARY.tr_shortened(at, cut, ct.byref(asked), address(space), into)
        else:
            space = _workspace(_LIBRARY.tr_workspace(count, at))
            method(count, at, ct.byref(asked), address(space), into)
        lower, upper = sides[..., : (N + 1) * rows].reshape(2, count, N + 1, rows)
        numbers = (results[name].tolist() for name in ("code", "iterations", "objective", "gap", "residual"))
        waves = (np.swapaxes(each, 1, 2) if motors > 1 else each[..., 0] for each in (command, gradient))
        found |= dict(zip(group, map(Answer, *numbers, *waves, lower, upper), strict=True))
    return [found[i] for i in range(len(given))]


def interior_points(
    given: Sequence[Stages], *, tolerance: float, max_iterations: int, cut: int = 0, first: Sequence[int] = ()
) -> list[Answer]:
    """Solve problems, those of equal sizes side by side.

    Without the temperature, limits are stated at the first stages alone, and at more if an answer leaves them.

    Parameters
    ----------
    tolerance : on the gap, relative to max(J, 1e-3), and on the residuals of the limits, in their units.
    cut : only for a single problem without taps that repeat. If it is above 0, there is one search, with the limits
        stated at the stages before it alone: over so many stages, much shorter if limits bind early. The caller must
        check the limits from there on.
    first : for each problem the stages up to which limits bind, as far as the caller knows, 0 where it does not. A
        good number spares searches that are too short or too long; the answer is the same up to the tolerance.

    Raises
    ------
    InputError : invalid bounds of a limit.
    """
    assert _LIBRARY is not None
    found = _answers(_LIBRARY.tr_solve, given, _Options(max_iterations, tolerance, _HOST), cut, first)
    for stages, answer in zip(given, found, strict=True):
        if answer.code == NO_BOUNDS:
            rows = stages.limits
            for name, lower, upper in zip(rows.kinds, rows.lower.T, rows.upper.T, strict=True):
                check_bounds(name, lower, upper)
    return found


def linear_passes(given: Sequence[Stages], tolerance: float) -> list[Answer]:
    """Solve problems without limits (`stage_data.without_limits`), those of equal sizes side by side.

    Parameters
    ----------
    tolerance : on the gap, relative to max(J, 1e-3).
    """
    assert _LIBRARY is not None
    return _answers(_LIBRARY.tr_linear, given, _Options(0, tolerance, _HOST))


class Proofs(NamedTuple):
    """Numbers of the certificates of P commands with multipliers (`tr_proof` of riccati.c), in scaled units.

    Attributes
    ----------
    excess : (P, rows) largest violation of each row, negative inside. All others are (P,).
    slack : sum of multipliers times absolute slacks, the hand-over's included. residual : of the hand-over.
    dual_residual : largest absolute value of the Lagrangian's gradient g by the commands.
    by_command : sum |g_k| (c_max + |c_k|). by_movement : `certify.movement_bound` of g.
    """

    excess: FloatArray
    objective: FloatArray
    slack: FloatArray
    residual: FloatArray
    dual_residual: FloatArray
    by_command: FloatArray
    by_movement: FloatArray


def prove(
    given: Sequence[Stages], commands: FloatArray, by_row: Sequence[FloatArray | None], by_rule: FloatArray
) -> Proofs:
    """Compute the certificates' numbers of commands of P problems of equal sizes, without temperature, side by side.

    Parameters
    ----------
    commands : (P, N, m), scaled.
    by_row : (2, N, rows) multipliers >= 0 of lower and of upper bounds, contiguous; None if all are zero.
    by_rule : (P, h, m) multipliers of the hand-over.
    """
    assert _LIBRARY is not None
    count, rows = len(given), given[0].sizes["rows"]
    excess = np.empty((count, max(rows, 1)))
    given_arrays = {"command": commands, "by_rule": by_rule}
    held = {name: np.ascontiguousarray(array) for name, array in given_arrays.items()}
    problems, proofs = records_of([each.record for each in given]), _at(held | {"excess": excess}, PROOF)
    proofs["by_lower"] = [0 if sides is None else address(sides) for sides in by_row]
    proofs["by_upper"] = [0 if sides is None else address(sides) + sides.strides[0] for sides in by_row]
    bounds = [each.limits.asked for each in given]
    proofs["lower"] = [address(each) for each in bounds]
    proofs["upper"] = [address(each) + each.strides[0] for each in bounds]
    space = _workspace(_LIBRARY.tr_workspace(count, problems.ctypes.data))
    _LIBRARY.tr_prove(count, problems.ctypes.data, address(space), proofs.ctypes.data)
    return Proofs(excess[:, :rows], *(proofs[name] for name in Proofs._fields[1:]))
