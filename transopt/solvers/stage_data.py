"""Stage data of a problem: the input of the project's own method (`solvers/native/riccati.c`).

They are computed from the linear stage and from the rows of the limits, as the data of the CasADi program are
(`solvers.program`), but without CasADi, so that the runtime can solve a tap without it.
"""

import operator
import struct
import threading
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from transopt.base.recursions import address
from transopt.base.signals import FloatArray
from transopt.problem.answer import OBJECTIVE_SCALE, Multipliers
from transopt.problem.limits import hand_over
from transopt.problem.limits.temperature import TemperatureLimit
from transopt.problem.objective.tail import tail, tails
from transopt.problem.problem import TransientProblem
from transopt.problem.stage import LinearStage, layout, linear_stage, outputs_of
from transopt.solvers.modes import Modes, modes_of
from transopt.solvers.stated_rows import WINDING, Rows, kelvin, rows_of

MOST_KEPT = 128  # cached problems per thread: as many as are solved side by side, also without the temperature
ROUNDING = 1e-12  # share of the largest multiplier, in units of the limits, up to which another one is none
NO_LIMITS = dict.fromkeys(("G", "d", "d_size", "lower", "upper"), np.zeros(0))
# Integers, addresses of arrays, and scalars of `tr_problem` of riccati.c, in its order.
SIZES = ("stages", "free_stages", "states", "motors", "outputs", "ends", "rows", "nodes", "current", "repeated")
ARRAYS = (
    *("A", "C", "E", "weight", "reference", "rule_gain", "rule_offset", "end_gain", "end_target"),
    *("G", "d", "d_size", "lower", "upper", "M", "b", "gain", "square", "F", "f"),
)
NUMBERS = ("movement_weight", "decay", "ripple", "copper", "command_bound", "constant")
RECORD = np.dtype(
    [(name, kind) for kind, names in ((np.intc, SIZES), (np.uintp, ARRAYS), (float, NUMBERS)) for name in names],
    align=True,
)
_PACK = struct.Struct(f"{len(SIZES)}i{len(ARRAYS)}P{len(NUMBERS)}d").pack


def tracking_values(problem: TransientProblem, stage: LinearStage) -> dict[str, FloatArray]:
    """Numbers of the objective by name; tracked outputs are in units of sqrt(E), the input is in its own unit.

    They are targets and weights (N, outputs) of the outputs within the window, the weight of the movement (1,), gains
    and targets of the terms in x_N for the time after the window (`objective.tail`), and the constant term (1,).
    """
    after = tail(problem, stage)
    return {
        "r": _wanted([problem])[0],
        "w": _weights(problem, stage),
        "rho": np.array([problem.movement.weight * stage.input_scale**2]),
        "end_gain": after.gain,
        "end_target": after.target,
        "constant": np.array([problem.tracking.constant + after.rest]),
    }


def _wanted(problems: Sequence[TransientProblem]) -> FloatArray:
    """(P, N, outputs) targets of the outputs: for each device all error terms, then zeros for the price on heat."""
    first, wanted = problems[0], [problem.tracking.solved_wanted for problem in problems]
    tracked = len(first.devices) * len(wanted[0])
    found = np.zeros((len(problems), first.grid.stages, tracked + first.stage.motors * int(first.heat_price > 0)))
    for each, of in zip(found, wanted, strict=True):
        each[:, :tracked] = np.tile(of.T, len(first.devices))
    return found


def _weights(problem: TransientProblem, stage: LinearStage) -> FloatArray:
    """(N, outputs) weights of the squared errors."""
    by_term = problem.tracking.solved_weights.T
    price = []
    if problem.heat_price > 0:
        price = [np.full((by_term.shape[0], stage.motors), problem.heat_price * stage.input_scale**2)]
    return np.concatenate([*(share * by_term for share in problem.shared), *price], axis=1)


def heat_values(problem: TransientProblem, input_scale: float) -> dict[str, FloatArray]:
    """Numbers of the temperature recursion by name, in units of `input_scale` and `kelvin`; matrices in row order."""
    assert problem.thermal is not None
    model, unit = problem.thermal.model, kelvin(problem)
    F, f = (np.zeros_like(model.M), np.zeros_like(model.b)) if model.closure is None else model.closure
    return {
        "M": model.M,
        "b": model.b * input_scale**2 / unit,
        "gain": model.gain,
        "copper": np.array([model.copper * unit]),
        "square": model.heating.square,
        "share": np.array([model.heating.share]),
        "decay": np.array([model.heating.decay]),
        "ripple": np.array([model.heating.ripple_A / input_scale]),
        "F": F,
        "f": f / unit,
    }


def ended(problem: TransientProblem, command: FloatArray) -> FloatArray:
    """(..., N) commands, set to exactly zero at a hand-over without a wall; this changes them by rounding only."""
    if problem.wall is None:
        command[..., problem.free_stages :] = 0.0
    return command


def held(problem: TransientProblem, command: FloatArray) -> FloatArray:
    """(..., N) commands, clipped to the command bound and `ended`; this changes them by rounding only."""
    return ended(problem, np.clip(command, -problem.command_bound, problem.command_bound))


@dataclass(frozen=True)
class Stages:
    """Stage data of one problem, in scaled units.

    Attributes
    ----------
    input_scale, kelvin : units of commands and of temperature rises.
    sizes, numbers, arrays : integers, scalars and arrays of `tr_problem`, by name; the arrays contiguous.
    """

    problem: TransientProblem
    input_scale: float
    kelvin: float
    limits: Rows
    sizes: dict[str, int]
    numbers: dict[str, float]
    arrays: dict[str, FloatArray]

    @cached_property
    def record(self) -> bytes:
        """`tr_problem`; valid as long as these stage data exist, which keep the arrays alive."""
        return _record(self.sizes, self.numbers, self.arrays)

    def of(self, problem: TransientProblem) -> "Stages":
        """Return these stage data as those of another problem with the same parts."""
        return self if problem is self.problem else self._with(problem=problem)

    def _with(self, **changed: Any) -> "Stages":
        """A copy with other fields or another record."""
        found = object.__new__(type(self))
        vars(found).update(vars(self), **changed)
        return found

    def without_rows(self, record: bytes) -> "Stages":
        """These stage data, whose record is given, without the rows of limits."""
        return self._with(sizes=self.sizes | {"rows": 0}, arrays=self.arrays | NO_LIMITS, record=record)

    def command(self, scaled: FloatArray) -> FloatArray:
        """(N,) or (m, N) commands [A] from scaled ones, clipped to the command bound (`held`)."""
        return held(self.problem, scaled * self.input_scale)

    def free_command(self, scaled: FloatArray) -> FloatArray:
        """(N,) or (m, N) commands [A] from scaled ones of the problem without limits, not clipped."""
        return ended(self.problem, scaled * self.input_scale)

    def hand_over(self, gradient: FloatArray) -> FloatArray:
        """(h,) or (m, h) multipliers of the hand-over of h samples [1/A] from the gradient by the movements."""
        return np.ascontiguousarray(-gradient[..., self.problem.free_stages :] * (OBJECTIVE_SCALE / self.input_scale))

    def multipliers(self, by_row: FloatArray, gradient: FloatArray) -> Multipliers:
        """Multipliers of J in SI, from the scaled ones (N + 1, rows), upper less lower, and the gradient.

        Those of bounds that do not bind are what rounding leaves: zero here, and without memory in a library.
        """
        problem, N = self.problem, self.sizes["stages"]
        by, place = OBJECTIVE_SCALE / self.limits.unit, {kind: j for j, kind in enumerate(self.limits.kinds)}
        rows = [(row.name, place[row.name], limit.stated) for limit, row in problem.rows() if row.linear]
        for _, j, stated in rows:
            by[j] /= stated
        if problem.thermal is not None:
            by[place[WINDING]] /= self.kelvin
        priced = np.abs(by_row)
        # What is NaN stays NaN, for the certificate to refuse.
        left = np.where(priced <= ROUNDING * priced.max(initial=0.0), 0.0, by_row)
        in_SI = np.ascontiguousarray((left * by).T)
        upper, lower = np.maximum(in_SI, 0.0), np.maximum(-in_SI, 0.0)
        pairs, slope = {name: (lower[j, :N], upper[j, :N]) for name, j, _ in rows}, np.zeros(N)
        if problem.thermal is not None:
            slope = slope_of(lower[place["size_above"], :N], lower[place["size_below"], :N])
            pairs[problem.thermal.row_names[0]] = (np.zeros(N), upper[place[WINDING], 1:])
        return Multipliers(N, pairs, self.hand_over(gradient), slope)


def slope_of(above: FloatArray, below: FloatArray) -> FloatArray:
    """(N,) slope of |mean i| by the multipliers (N,) of size >= mean i and of size >= -mean i.

    The two multipliers add up to the value of the magnitude; where that is zero any slope in [-1, 1] is valid.
    """
    above, below = np.maximum(above, 0.0), np.maximum(below, 0.0)
    return np.asarray((above - below) / np.maximum(above + below, np.finfo(float).tiny))


def _record(sizes: Mapping[str, int], numbers: Mapping[str, float], arrays: Mapping[str, FloatArray]) -> bytes:
    """`tr_problem` with these sizes, numbers and arrays; what is missing is zero."""
    at = (address(arrays[name]) if name in arrays else 0 for name in ARRAYS)
    return _PACK(*(sizes.get(name, 0) for name in SIZES), *at, *(numbers.get(name, 0.0) for name in NUMBERS))


def records_of(given: Sequence[bytes]) -> NDArray[np.void]:
    """An array of `tr_problem` from its elements."""
    return np.frombuffer(bytearray().join(given), dtype=RECORD)  # numpy would join them field by field


def _elements(records: NDArray[np.void]) -> list[bytes]:
    """The elements of an array of `tr_problem`."""
    whole, size = records.tobytes(), records.itemsize
    return [whole[at : at + size] for at in range(0, len(whole), size)]


_memory = threading.local()


def stages(problem: TransientProblem) -> Stages:
    """Stage data of one problem, by `stages_of`."""
    return stages_of([problem])[0]


def stages_of(problems: Sequence[TransientProblem]) -> list[Stages]:
    """Stage data of problems, those of one grip computed together.

    The most recent ones are cached, since a problem is solved, proven and solved again. Two problems share an entry
    of the cache if all their parts are the same objects.
    """
    kept: dict[tuple[int, ...], Stages] = vars(_memory).setdefault("kept", {})
    # The identities are valid, as a cached problem keeps these objects.
    keys = [tuple(map(id, (*problem.limits, *PARTS(problem)))) for problem in problems]
    found = {key: kept.pop(key) for key in dict.fromkeys(keys) if key in kept}
    groups: dict[object, dict[tuple[int, ...], TransientProblem]] = {}
    for key, problem in zip(keys, problems, strict=True):
        if key not in found:
            groups.setdefault(_shared_by(problem) or key, {})[key] = problem
    for group in groups.values():
        found.update(zip(group, _stages([*group.values()]), strict=True))
    kept.update(found)
    while len(kept) > MOST_KEPT:
        del kept[next(iter(kept))]
    return [found[key].of(problem) for key, problem in zip(keys, problems, strict=True)]


PARTS = operator.attrgetter(*(field.name for field in fields(TransientProblem) if field.name != "limits"))


@dataclass(frozen=True)
class _Template:
    """The part of the stage data that problems of one grip share if they differ only in the target.

    Attributes
    ----------
    modes, limits, kelvin, sizes : as in `Stages`.
    numbers, arrays : those of `Stages` that do not depend on the target.
    """

    modes: Modes
    limits: Rows
    kelvin: float
    sizes: dict[str, int]
    numbers: dict[str, float]
    arrays: dict[str, FloatArray]


def _template(problem: TransientProblem, stage: LinearStage) -> _Template:
    """The template of a problem, cached with the device unless a wall or a limit depends on the tap itself."""
    if (others := _others(problem)) is None:
        return _template_of(problem, stage)
    return problem.stage.kept(_Template, (stage.A, problem.terms), others, lambda: _template_of(problem, stage))


def _others(problem: TransientProblem) -> tuple[object, ...] | None:
    if not problem.limits.are_hashable or problem.wall is not None or problem.shares is not None:
        return None
    return (problem.limits, problem.rho, problem.intensity, problem.heat_price, problem.hand_over_samples)


def _shared_by(problem: TransientProblem) -> tuple[object, ...] | None:
    """The key of problems that differ only in the target; None for a problem that shares its data with no other."""
    others = _others(problem)
    return None if others is None else (*map(id, problem.devices), id(problem.terms), problem.grid, *others)


def _template_of(problem: TransientProblem, stage: LinearStage) -> _Template:
    where, modes, limits = layout(problem), modes_of(problem, stage), rows_of(problem, stage)
    m = 0 if problem.thermal is None else problem.thermal.model.nodes
    # For each stage and motor c_k = rows x_k + constant, and dc_k = c_k - c_(k-1).
    gains, offsets = (np.repeat(each, stage.motors, axis=0) for each in hand_over.rows(problem, stage))
    gains[:, -stage.motors :] -= np.tile(np.eye(stage.motors), (problem.hand_over_samples, 1))
    heat = (
        dict.fromkeys(("M", "b", "gain", "square", "F", "f"), np.zeros(4))
        if m == 0
        else heat_values(problem, stage.input_scale)
    )
    arrays = {
        "A": modes.A,
        "weight": _weights(problem, stage) * (2 / OBJECTIVE_SCALE),
        "rule_gain": gains @ modes.T,
        "rule_offset": offsets,
        "G": limits.G @ modes.T,
        **{name: getattr(limits, name) for name in ("d", "d_size", "lower", "upper")},
        **{name: heat[name] for name in ("M", "b", "gain", "square", "F", "f")},
    }
    return _Template(
        modes=modes,
        limits=limits,
        kelvin=kelvin(problem),
        sizes={
            "stages": problem.grid.stages,
            "free_stages": problem.free_stages,
            "states": where.states,
            "motors": where.motors,
            "outputs": where.outputs,
            "rows": limits.d_size.size,
            "nodes": m,
            "current": modes.current,
            "repeated": int(m > 0 and problem.thermal is not None and problem.thermal.model.closure is not None),
        },
        numbers={
            "movement_weight": 2 * problem.movement.weight * stage.input_scale**2 / OBJECTIVE_SCALE,
            "command_bound": problem.command_bound / stage.input_scale,
            **{name: float(heat[name][0]) if m else 0.0 for name in ("decay", "ripple", "copper")},
        },
        arrays={name: np.ascontiguousarray(array, dtype=float) for name, array in arrays.items()},
    )


def _stages(problems: Sequence[TransientProblem]) -> list[Stages]:
    """Stage data of problems that differ only in the target."""
    stage, by = linear_stage(problems[0]), np.sqrt(2 / OBJECTIVE_SCALE)
    shared, after = _template(problems[0], stage), tails(problems, stage)
    C, E = outputs_of(problems)
    arrays = {
        "C": C @ shared.modes.T,
        "E": np.zeros_like(E) if shared.sizes["current"] >= 0 else E,
        "reference": _wanted(problems),
        "end_gain": after.gain @ shared.modes.T * by,
        "end_target": after.target * by,
    }
    sizes, found = shared.sizes | {"ends": after.target.shape[1]}, []
    constants = (([each.tracking.constant for each in problems] + after.rest) / OBJECTIVE_SCALE).tolist()
    records = records_of([_record(sizes, shared.numbers, shared.arrays)] * len(problems))
    records["constant"] = constants
    for name, array in arrays.items():
        records[name] = address(array) + array.strides[0] * np.arange(len(problems))
    for j, (problem, record) in enumerate(zip(problems, _elements(records), strict=True)):
        given = Stages(
            problem=problem,
            input_scale=stage.input_scale,
            kelvin=shared.kelvin,
            limits=shared.limits,
            sizes=sizes,
            numbers=shared.numbers | {"constant": constants[j]},
            arrays=shared.arrays | {name: array[j] for name, array in arrays.items()},
        )
        vars(given)["record"] = record
        found.append(given)
    return found


def without_limits(problem: TransientProblem) -> Stages:
    """Stage data of the same problem without limits, by `without_limits_of`."""
    return without_limits_of([problem])[0]


def without_limits_of(problems: Sequence[TransientProblem]) -> list[Stages]:
    """Stage data of the same problems without limits: the input of a linear pass."""
    whole = stages_of([problem.without(TemperatureLimit.name) for problem in problems])
    records = records_of([given.record for given in whole])
    records["rows"] = 0
    for name, array in NO_LIMITS.items():
        records[name] = address(array)
    return list(map(Stages.without_rows, whole, _elements(records)))
