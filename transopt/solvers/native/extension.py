"""Interface (ctypes) to the compiled interior-point method (`riccati.c`); it does not need CasADi.

The method releases the GIL while it works and polls for signals, so that Ctrl-C ends it within one iteration.

The extension is optional. Where it was not built, `available` is False.
"""

import ctypes as ct
import os
import threading
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from transopt.base.recursions import address
from transopt.base.signals import FloatArray
from transopt.solvers.bounds import check_bounds
from transopt.solvers.stage_data import Stages

EXTENSION = "_riccati.pyd" if os.name == "nt" else "_riccati.so"
MOST_STATES, MOST_ROWS = 96, 128  # of riccati.c
INTERFACE = 8  # version as in `tr_interface` of riccati.c; both change with the meaning of arguments or results
DOUBLES = ct.c_void_p  # address of an array; the caller keeps the array alive


# `tr_problem` of riccati.c.
PROBLEM_FIELDS: list[tuple[str, Any]] = [
    *[(name, ct.c_int) for name in ("stages", "free_stages", "states", "outputs", "ends", "rows", "nodes")],
    *[(name, ct.c_int) for name in ("current", "repeated")],
    *[(name, DOUBLES) for name in ("A", "C", "E", "weight", "reference", "rule_gain", "rule_offset")],
    *[(name, DOUBLES) for name in ("end_gain", "end_target")],
    *[(name, DOUBLES) for name in ("G", "d", "d_size", "lower", "upper")],
    *[(name, DOUBLES) for name in ("M", "b", "gain", "square", "F", "f")],
    *[(name, ct.c_double) for name in ("movement_weight", "decay", "ripple", "copper", "command_bound", "constant")],
]


class _Problem(ct.Structure):
    _fields_ = PROBLEM_FIELDS


class _Host(ct.Structure):
    _fields_ = tuple((name, ct.c_void_p) for name in ("release", "acquire", "interrupted"))


class _Options(ct.Structure):
    _fields_ = (("max_iterations", ct.c_int), ("tolerance", ct.c_double), ("host", ct.POINTER(_Host)))


class _Result(ct.Structure):
    _fields_ = (
        *[(name, DOUBLES) for name in ("command", "size", "lower", "upper", "gradient", "start")],
        *[(name, ct.c_int) for name in ("code", "iterations")],
        *[(name, ct.c_double) for name in ("objective", "gap", "residual")],
    )


class _Proof(ct.Structure):
    _fields_ = (
        *[(name, DOUBLES) for name in ("command", "by_lower", "by_upper", "by_rule", "lower", "upper", "excess")],
        *[(name, ct.c_double) for name in ("objective", "slack", "residual")],
        *[(name, ct.c_double) for name in ("dual_residual", "by_command", "by_movement")],
    )


def _library() -> ct.CDLL | None:
    file = Path(__file__).with_name(EXTENSION)
    if not file.exists():
        return None
    # PyDLL keeps the GIL held at entry and exit, so that an exception raised by a signal handler leaves the call.
    library = ct.PyDLL(str(file))
    if not hasattr(library, "tr_interface") or library.tr_interface() != INTERFACE:
        return None  # built from another version: not usable
    problem, result = ct.POINTER(_Problem), ct.POINTER(_Result)
    library.tr_workspace.restype, library.tr_workspace.argtypes = ct.c_size_t, (ct.c_int, problem)
    library.tr_solve.argtypes = (ct.c_int, problem, ct.POINTER(_Options), DOUBLES, result)
    library.tr_linear.argtypes = library.tr_solve.argtypes
    library.tr_prove.argtypes = (ct.c_int, problem, DOUBLES, ct.POINTER(_Proof))
    return library


def _host() -> _Host:
    """The interpreter as `tr_host`: functions that release and take the GIL and that check for signals."""
    names = ("PyEval_SaveThread", "PyEval_RestoreThread", "PyErr_CheckSignals")
    return _Host(*(ct.cast(getattr(ct.pythonapi, name), ct.c_void_p) for name in names))


_LIBRARY = _library()
available = _LIBRARY is not None
_HOST = ct.pointer(_host())
SOLVED, ACCURACY, NO_BOUNDS = 0, 1, 6  # codes of an answer; the others are failures


class Answer(NamedTuple):
    """The returned iterate of the method, in scaled units.

    Attributes
    ----------
    code : 0 solved, 1 solved up to rounding, otherwise a failure. gap, objective : in units of 1e-3.
    command, gradient : (N,) commands, and the Lagrangian's gradient by the movements.
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


def _workspace(count: int, problems: ct.Array[_Problem]) -> FloatArray:
    """The workspace of this thread, reused: allocating fresh memory takes as long as solving a short problem."""
    assert _LIBRARY is not None
    kept: FloatArray = vars(_memory).setdefault("kept", np.empty(0))
    needed = _LIBRARY.tr_workspace(count, problems)
    if kept.size >= needed:
        return kept
    fresh = np.empty(needed)
    if fresh.nbytes <= MOST_KEPT_BYTES:
        _memory.kept = fresh
    return fresh


def _stated(stages: Stages) -> _Problem:
    """A problem as the C structure, cached with its stage data, which keep the arrays alive."""
    if "stated" not in vars(stages):
        arrays = {name: address(array) for name, array in stages.arrays.items()}
        vars(stages)["stated"] = _Problem(**stages.sizes, **stages.numbers, **arrays)
    found: _Problem = vars(stages)["stated"]
    return found


def _of_equal_sizes(given: Sequence[Stages]) -> Iterator[list[int]]:
    """Groups of indices of problems with equal sizes, which can be solved side by side."""
    groups: dict[tuple[int, ...], list[int]] = {}
    for i, stages in enumerate(given):
        groups.setdefault(tuple(stages.sizes.values()), []).append(i)
    yield from groups.values()


def _answers(method: Any, given: Sequence[Stages], asked: _Options) -> list[Answer]:
    """Answers of `tr_solve` or `tr_linear` to problems of any sizes, in their order."""
    found: dict[int, Answer] = {}
    for group in _of_equal_sizes(given):
        sizes, count = given[group[0]].sizes, len(group)
        N, rows = sizes["stages"], sizes["rows"]
        command, size, gradient = np.zeros((3, count, N))
        bounds = np.zeros((2, count, N + 1, rows))
        start = np.zeros((count, max(sizes["nodes"], 1)))
        # An empty NumPy array has no usable address for C: pass an array of one number instead.
        arrays = (command, size, *(bounds if rows else np.zeros((2, count, 1))), gradient, start)
        first, step = [address(array) for array in arrays], [array[0].nbytes for array in arrays]
        problems = (_Problem * count)(*(_stated(given[i]) for i in group))
        results = (_Result * count)(
            *(_Result(*(at + j * by for at, by in zip(first, step, strict=True))) for j in range(count))
        )
        method(count, problems, ct.byref(asked), address(_workspace(count, problems)), results)
        for j, i in enumerate(group):
            r = results[j]
            told = (r.code, r.iterations, r.objective, r.gap, r.residual)
            found[i] = Answer(*told, command[j], gradient[j], bounds[0, j], bounds[1, j])
    return [found[i] for i in range(len(given))]


def interior_points(given: Sequence[Stages], *, tolerance: float, max_iterations: int) -> list[Answer]:
    """Solve problems, those of equal sizes side by side.

    Parameters
    ----------
    tolerance : on the gap, relative to max(J, 1e-3), and on the residuals of the limits, in their units.

    Raises
    ------
    InputError : invalid bounds of a limit.
    """
    assert _LIBRARY is not None
    found = _answers(_LIBRARY.tr_solve, given, _Options(max_iterations, tolerance, _HOST))
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


class Proof(NamedTuple):
    """Numbers of a certificate, from a command and multipliers (`tr_proof` of riccati.c), in scaled units.

    Attributes
    ----------
    excess : (rows,) largest violation of each row, negative inside.
    slack : sum of multipliers times absolute slacks, the hand-over's included. residual : of the hand-over.
    dual_residual : largest absolute value of the Lagrangian's gradient g by the commands.
    by_command : sum |g_k| (c_max + |c_k|). by_movement : `certify.movement_bound` of g.
    """

    excess: FloatArray
    objective: float
    slack: float
    residual: float
    dual_residual: float
    by_command: float
    by_movement: float


class Judged(NamedTuple):
    """Input of `prove`: a command of a problem without temperature, with multipliers, in scaled units.

    Attributes
    ----------
    command : (N,).
    by_row : (N, rows) multipliers >= 0 of lower and of upper bounds, contiguous; None if all are zero.
    by_rule : (h,) multipliers of the hand-over.
    """

    stages: Stages
    command: FloatArray
    by_row: tuple[FloatArray, FloatArray] | None
    by_rule: FloatArray


def _asked(judged: Judged, excess: FloatArray) -> _Proof:
    multipliers = (None, None) if judged.by_row is None else map(address, judged.by_row)
    bounds = map(address, judged.stages.limits.asked)
    return _Proof(address(judged.command), *multipliers, address(judged.by_rule), *bounds, address(excess))


def prove(asked: Sequence[Judged]) -> list[Proof]:
    """Compute the certificates' numbers of commands; problems of equal sizes side by side."""
    assert _LIBRARY is not None
    found: dict[int, Proof] = {}
    for group in _of_equal_sizes([each.stages for each in asked]):
        some, count = [asked[i] for i in group], len(group)
        excess = np.empty((count, max(some[0].stages.sizes["rows"], 1)))
        problems = (_Problem * count)(*(_stated(each.stages) for each in some))
        proofs = (_Proof * count)(*(_asked(each, row) for each, row in zip(some, excess, strict=True)))
        _LIBRARY.tr_prove(count, problems, address(_workspace(count, problems)), proofs)
        for i, proof, row, each in zip(group, proofs, excess, some, strict=True):
            numbers = (getattr(proof, name) for name in Proof._fields[1:])
            found[i] = Proof(row[: each.stages.sizes["rows"]], *numbers)
    return [found[i] for i in range(len(asked))]
