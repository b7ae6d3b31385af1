"""The compiled interior point (`riccati.c`) through ctypes; no CasADi.

The method lets go of the GIL while it works, and asks now and then whether a signal has come: a Ctrl-C ends it within
one iteration.

The extension is optional. Where it could not be built, `available` is False.
"""

import ctypes as ct
import os
import threading
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from transopt.base.recursions import address
from transopt.base.signals import FloatArray
from transopt.problem.answer import OBJECTIVE_SCALE
from transopt.solvers.bounds import check_bounds
from transopt.solvers.stage_data import Stages

EXTENSION = "_riccati.pyd" if os.name == "nt" else "_riccati.so"
MOST_STATES, MOST_ROWS = 96, 128  # of riccati.c
INTERFACE = 7  # as `tr_interface` of riccati.c: both change with what arguments and results mean
DOUBLES = ct.c_void_p  # an address: whoever states it keeps the array alive


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
        ("iterations", ct.c_int),
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
    # The GIL stays held, so that an exception which a signal has raised inside is raised by the call.
    library = ct.PyDLL(str(file))
    if not hasattr(library, "tr_interface") or library.tr_interface() != INTERFACE:
        return None  # left behind by another version: as good as none
    problem, result = ct.POINTER(_Problem), ct.POINTER(_Result)
    library.tr_workspace.restype, library.tr_workspace.argtypes = ct.c_size_t, (problem,)
    library.tr_solve.argtypes = (problem, ct.POINTER(_Options), DOUBLES, result)
    library.tr_linear.argtypes = (problem, ct.POINTER(_Options), ct.c_int, DOUBLES, result)
    library.tr_prove.argtypes = (problem, DOUBLES, ct.POINTER(_Proof))
    return library


def _host() -> _Host:
    """The interpreter as `tr_host`: its lock, and whether a signal has come that raises an exception."""
    names = ("PyEval_SaveThread", "PyEval_RestoreThread", "PyErr_CheckSignals")
    return _Host(*(ct.cast(getattr(ct.pythonapi, name), ct.c_void_p) for name in names))


_LIBRARY = _library()
available = _LIBRARY is not None
_HOST = ct.pointer(_host())
SOLVED, ACCURACY, NO_BOUNDS = 0, 1, 6  # codes of an answer; the others are failures


class Buffers:
    """Result arrays and workspace of one size, to be used again and again, by one thread at a time.

    Attributes
    ----------
    command, gradient : (N,) of the last answer, in the statement's units. size : (N,), of a problem with temperature.
    lower, upper : (N + 1, rows) its multipliers.
    gains_of : the linear pass whose gains stand in the workspace, by its token; None for none.
    """

    def __init__(self, sizes: dict[str, int]) -> None:
        assert _LIBRARY is not None
        N, shape = sizes["stages"], (sizes["stages"] + 1, sizes["rows"])
        self.command, self.size, self.gradient = np.zeros(N), np.zeros(N), np.zeros(N)
        # A pointer to nothing is none that C may copy no bytes to.
        self._lower, self._upper, self._start = (np.zeros(max(count, 1)) for count in (*[shape[0] * shape[1]] * 2, 4))
        self.lower, self.upper = (flat[: shape[0] * shape[1]].reshape(shape) for flat in (self._lower, self._upper))
        self.gains_of: object = None
        self.workspace = np.empty(_LIBRARY.tr_workspace(ct.byref(_Problem(**sizes))))
        self.result = _Result(
            *(address(a) for a in (self.command, self.size, self._lower, self._upper, self.gradient, self._start))
        )


MOST_KEPT, MOST_KEPT_BYTES = 4, 2**24  # a library's problem without limits, with them, with the temperature
_memory = threading.local()


def buffers_of(sizes: dict[str, int]) -> Buffers:
    """Buffers of this thread for these sizes: fresh memory takes as long as solving a short problem.

    What an answer consists of has to be taken out of them before the thread solves another problem.
    """
    kept: dict[tuple[int, ...], Buffers] = vars(_memory).setdefault("kept", {})
    key = tuple(sizes.values())
    found = kept.get(key) or Buffers(sizes)
    if key not in kept and found.workspace.nbytes <= MOST_KEPT_BYTES:
        if len(kept) == MOST_KEPT:
            del kept[next(iter(kept))]
        kept[key] = found
    return found


class Answer(NamedTuple):
    """What the method says of its last iterate, which stands in the buffers.

    Attributes
    ----------
    code : 0 solved, 1 solved to what rounding leaves, otherwise a failure. gap, objective : in units of 1e-3.
    """

    code: int
    iterations: int
    objective: float
    gap: float
    residual: float

    @property
    def relative_gap(self) -> float:
        """The gap counts relative to max(J, 1e-3), and is inf where that is no number."""
        relative = self.gap / max(self.objective, 1.0)
        return relative if np.isfinite(relative) else np.inf


def _stated(stages: Stages) -> _Problem:
    """A problem as C takes it, kept with its stage data, which keeps the arrays."""
    if "stated" not in vars(stages):
        arrays = {name: address(array) for name, array in stages.arrays.items()}
        vars(stages)["stated"] = _Problem(**stages.sizes, **stages.numbers, **arrays)
    found: _Problem = vars(stages)["stated"]
    return found


def _answer(code: int, result: _Result) -> Answer:
    return Answer(code, result.iterations, result.objective, result.gap, result.residual)


def interior_point(stages: Stages, buffers: Buffers, *, tolerance: float, max_iterations: int) -> Answer:
    """Solve; the answer stands in the buffers, made for the same sizes.

    Parameters
    ----------
    tolerance : on the gap, relative to max(J, 1e-3), and on the residuals of the limits, in their units.

    Raises
    ------
    InputError : a limit's bounds are none.
    """
    assert _LIBRARY is not None
    stated, asked, buffers.gains_of = _stated(stages), _Options(max_iterations, tolerance, _HOST), None
    code = _LIBRARY.tr_solve(ct.byref(stated), ct.byref(asked), address(buffers.workspace), ct.byref(buffers.result))
    if code == NO_BOUNDS:
        rows = stages.limits
        for name, lower, upper in zip(rows.kinds, rows.lower.T, rows.upper.T, strict=True):
            check_bounds(name, lower, upper)
    return _answer(code, buffers.result)


class Proof(NamedTuple):
    """What a command and multipliers prove (`tr_proof` of riccati.c), in the statement's units.

    Attributes
    ----------
    excess : (rows,) how far each row is outside at most, negative inside.
    slack : multipliers times the sizes of their slacks, those of the hand-over too. residual : of the hand-over.
    dual_residual : largest size of the Lagrangian's gradient g by the commands.
    by_command : sum |g_k| (c_max + |c_k|). by_movement : `certify.movement_bound` of g.
    """

    excess: FloatArray
    objective: float
    slack: float
    residual: float
    dual_residual: float
    by_command: float
    by_movement: float


def prove(
    stages: Stages, command: FloatArray, by_row: tuple[FloatArray, FloatArray] | None, by_rule: FloatArray
) -> Proof | None:
    """Judge a command of a problem without temperature; None where the problem is too large.

    Parameters
    ----------
    command : (N,).
    by_row : (N, rows) multipliers >= 0 of lower and of upper bounds, contiguous; None for none.
    by_rule : (h,) of the hand-over.
    """
    assert _LIBRARY is not None
    buffers, excess = buffers_of(stages.sizes), np.empty(stages.sizes["rows"])
    multipliers = (None, None) if by_row is None else map(address, by_row)
    bounds = map(address, stages.limits.asked)
    proof = _Proof(address(command), *multipliers, address(by_rule), *bounds, address(excess))
    stated = _stated(stages)
    buffers.gains_of = None
    if _LIBRARY.tr_prove(ct.byref(stated), address(buffers.workspace), ct.byref(proof)) != SOLVED:
        return None
    return Proof(excess, *(getattr(proof, name) for name in Proof._fields[1:]))


class LinearPass:
    """The optimum without limits for one device and one weight, its gains factored once and used for any reference.

    Parameters
    ----------
    stages : `stage_data.without_limits`. The reference stands in units of its norm, so |r| is part of the weight: two
        references share gains only if they share rho |r|^2, as those of one (grip, speed) do.
    buffers : of the same sizes, where there are any. Who else solves in them costs this pass its gains.

    Attributes
    ----------
    reference : (N,) of the stages' problem in units of its norm; writing into it is how it is changed.
    """

    def __init__(self, stages: Stages, buffers: Buffers | None = None) -> None:
        assert _LIBRARY is not None
        self.stages = stages
        self.buffers = Buffers(stages.sizes) if buffers is None else buffers
        self.reference = stages.arrays["reference"].copy()
        self._stated = _Problem.from_buffer_copy(_stated(stages))
        self._stated.reference = address(self.reference)
        self._arguments = (address(self.buffers.workspace), ct.byref(self.buffers.result))
        self._problem, self._token = ct.byref(self._stated), object()
        self._asked = _Options(0, 0.0, _HOST)
        self._pass = _LIBRARY.tr_linear
        problem = stages.problem
        self._tail = slice(problem.free_stages, None)
        self._zeros = self._tail if problem.wall is None else slice(0, 0)

    def solve(self, tolerance: float) -> Answer:
        """Answer to `tolerance` on the gap, relative to max(J, 1e-3); command and gradient stand in the buffers."""
        buffers = self.buffers
        factored, buffers.gains_of = buffers.gains_of is self._token, None
        self._asked.tolerance = tolerance
        code = self._pass(self._problem, ct.byref(self._asked), factored, *self._arguments)
        buffers.gains_of = self._token if code in (SOLVED, ACCURACY) else None
        return _answer(code, buffers.result)

    def forget(self) -> None:
        """Factor again at the next solve."""
        self.buffers.gains_of = None

    def command(self) -> FloatArray:
        """(N,) the last answer's commands, moved by rounding only: zero at a plain hand-over."""
        command: FloatArray = self.buffers.command * self.stages.input_scale
        command[self._zeros] = 0.0
        return command

    def hand_over(self) -> FloatArray:
        """(hand_over_samples,) its multipliers of the hand-over [1/A]."""
        return np.asarray(-self.buffers.gradient[self._tail] * OBJECTIVE_SCALE / self.stages.input_scale)
