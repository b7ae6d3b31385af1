"""A problem that stands while the device and the target change from tap to tap: nothing is allocated for one of them.

`stage_data` states any problem. Most taps of one library differ only in a device of a fixed number of states and in
a target. Their stages are made here in the arrays of one problem: LAPACK finds the modes of plant and amplifier, and
one compiled call (`native/device.c`) all that follows from them. It is exact for a held command, as `discretise` is,
and in the units of that problem, so that no motion is simulated for each device. The tests hold both ways equal.
"""

import ctypes as ct
import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from transopt.base.recursions import address
from transopt.base.signals import FloatArray
from transopt.plant.state_space import StateSpace
from transopt.problem.answer import OBJECTIVE_SCALE
from transopt.problem.limits.row import COMMAND, HELD, INPUT
from transopt.problem.problem import TransientProblem
from transopt.problem.stage import layout, linear_stage
from transopt.solvers.modes import MOST_CONDITION
from transopt.solvers.native import extension
from transopt.solvers.native.extension import ACCURACY, PROOF, RESULT, SOLVED
from transopt.solvers.stage_data import RECORD, Stages, stages, without_limits

TIGHTER = 0.01  # on the tolerance of a short search, as in riccati.c
FILTER = 7  # numbers of an error filter, as `TR_FILTER` of device.h
MOST_STATES = 32  # `TR_MOST_DEVICE`
OWN = ("A", "C", "end_gain", "end_target", "reference")  # arrays of the stage data that a tap changes


class _Device(ct.Structure):
    _fields_ = (
        *((name, ct.c_int) for name in ("plant", "terms", "after", "stride")),
        *((name, ct.c_void_p) for name in ("values", "vectors", "output", "filter", "root")),
        *((name, ct.c_double) for name in ("rate", "by")),
    )


class _Stages(ct.Structure):
    _fields_ = (*((name, ct.c_void_p) for name in ("A", "C", "end_gain", "end_target")), ("rest", ct.c_double))


class Proof(NamedTuple):
    """Numbers of a certificate (`extension.Proofs`) in SI units, with the largest violation of each row."""

    excess: list[float]
    merit: float
    residual: float
    dual_residual: float
    gap_by_command: float
    gap_by_movement: float


def _structure(fields: list[tuple[str, np.dtype[Any]]], arrays: Mapping[str, FloatArray]) -> NDArray[np.void]:
    """A C structure with the addresses of arrays by the name of the field."""
    found = np.zeros(1, dtype=np.dtype(fields, align=True))
    for name, array in arrays.items():
        found[name] = address(array)
    return found


def stands(problem: TransientProblem) -> bool:
    """Whether a problem, without its temperature, is of the kind that `Standing` takes."""
    stage = problem.stage
    return (
        extension.available
        and stage.amplifier is not None
        and stage.motors == stage.tracked == 1
        and problem.wall is None
        and not problem.spread
        and problem.intensity == problem.heat_price == 0
        and stage.A.shape[0] == stage.plant.order + 1
        and not stage.outputs
        and layout(problem).states <= MOST_STATES
        and problem.limits.are_hashable
        and all(row.linear and set(row.outputs) <= {INPUT, COMMAND, HELD} for _, row in problem.rows())
    )


class Standing:
    """Stages, searches and proofs of a tap, in arrays allocated once; for use by one thread at a time.

    Parameters
    ----------
    problem : any tap's problem that `stands`, without a temperature limit.
    small : the same without the limits that no command reaches.
    tolerance, most_iterations : as of `extension.interior_points`.

    Attributes
    ----------
    plant : p, the number of the plant's states.
    given : stage data of the problem, of which a tap changes the arrays `OWN`.
    """

    _kept: list[object]

    def __init__(
        self, problem: TransientProblem, small: TransientProblem, tolerance: float, most_iterations: int
    ) -> None:
        whole, searched, bare = stages(problem), stages(small), without_limits(problem)
        self.problem, self._scale, self._free = problem, whole.input_scale, problem.free_stages
        self.given, self._kept = whole, [searched, bare]  # what the records point to is kept alive
        self._made(problem)
        n, current = whole.sizes["states"], layout(problem).current
        self._records = np.concatenate([self._record(each, n, current) for each in (bare, searched, whole)])
        N, rows, wide = problem.grid.stages, len(searched.limits.kinds), len(whole.limits.kinds)
        self._places = [whole.limits.kinds.index(kind) for kind in searched.limits.kinds]
        self._units = whole.limits.unit * [limit.stated for limit, _ in problem.rows()]
        self._command, self._gradient, size = np.zeros((3, N))
        self._sides, self._by_row = np.zeros((2, N + 1, rows)), np.zeros((2, N, wide))
        self._proven, self._by_rule, self._excess = np.zeros(N), np.zeros(N - self._free), np.zeros(wide)
        searches = {"command": self._command, "gradient": self._gradient, "size": size}
        self._by_row_at = dict(zip(("by_lower", "by_upper"), map(address, self._by_row), strict=True))
        self._result = _structure(RESULT, searches | {"lower": self._sides[0], "upper": self._sides[1]})
        proves = {"command": self._proven, "by_rule": self._by_rule, "excess": self._excess}
        asked = whole.limits.asked
        self._proof = _structure(PROOF, proves | {"lower": asked[0], "upper": asked[1]})
        self._kept.append(size)
        self._options, self._tighter = (
            extension._Options(most_iterations, by * tolerance, extension._HOST) for by in (1.0, TIGHTER)
        )
        assert extension._LIBRARY is not None
        self._c = c = extension._LIBRARY
        self._at = [self._records.ctypes.data + self._records.itemsize * j for j in range(3)]
        self._into, self._proof_at = self._result.ctypes.data, self._proof.ctypes.data
        needed = [c.tr_workspace(1, each) for each in self._at]
        self._device_at, self._stages_at = ct.addressof(self._device), ct.addressof(self._stages)
        needed += [c.tr_shortened_workspace(self._at[1]), c.tr_device_workspace(self._device_at)]
        space = np.zeros(max(needed))
        self._kept.append(space)
        self._space = address(space)

    def _made(self, problem: TransientProblem) -> None:
        """Allocate what a tap changes, and what its stages are made from."""
        where, amplifier, grid, stage = layout(problem), problem.stage.amplifier, problem.grid, linear_stage(problem)
        assert amplifier is not None
        n, terms, p = where.states, len(problem.terms), where.plants[0]
        self.plant, rate = p, amplifier.rate_rad_s * grid.dt_s
        # The generator of plant and current over a period, its modes and its output, by the units of the states.
        self._sizes = stage.units[: p + 1].copy()
        self._per_period = grid.dt_s * self._sizes / self._sizes[:p, None]
        self._flow, self._values = np.zeros((p + 1, p + 1)), np.zeros(p + 1, dtype=complex)
        self._vectors, self._output = np.zeros((p + 1, p + 1), dtype=complex), np.zeros(p + 1)
        self._flow[p, p] = -rate
        filters = np.zeros((terms, FILTER))
        for t, term in enumerate(problem.terms):
            if term.error_filter is not None:
                A, _, C, D = term.error_filter.state_space()
                unit = stage.units[where.filter(0, t).start]
                filters[t] = 1.0, *-A[0], D[0, 0], *(C[0] * unit), 1 / unit
        roots = np.sqrt([term.after for term in problem.terms])
        self._kept += [filters, roots]
        made = (np.zeros(shape) for shape in ((n, n), (terms, n), (n - 1, n), (n - 1,), (grid.stages, terms)))
        self._arrays = dict(zip(OWN, made, strict=True))
        self._device = _Device(
            *(p, terms, grid.after_stages, problem.target.lost + grid.stages + grid.after_stages),
            *map(address, (self._values, self._vectors, self._output, filters, roots)),
            *(rate, math.sqrt(2 / OBJECTIVE_SCALE)),
        )
        self._stages = _Stages(*(address(self._arrays[name]) for name in OWN[:-1]))

    def _record(self, given: Stages, n: int, current: int) -> NDArray[np.void]:
        """`tr_problem` of stage data with the arrays of this object, its modes in the order of device.c."""
        record = np.frombuffer(bytearray(given.record), dtype=RECORD)
        for name in OWN:
            record[name] = address(self._arrays[name])
        record["ends"], record["current"] = n - 1, n - 2
        if given.sizes["rows"]:
            # Rows are sums of the current and of commands, which are modes themselves.
            G = np.zeros((given.sizes["rows"], n))
            G[:, n - 2], G[:, n - 1] = given.limits.G[:, current], given.limits.G[:, n - 1]
            record["G"] = address(G)
            self._kept.append(G)
        return record

    def drive(self, plant: StateSpace) -> bool:
        """Take a plant of p states, whose stages `poses` makes; False if its modes are not found."""
        p = self.plant
        with np.errstate(over="ignore"):  # what is infinite has no modes
            np.multiply(plant.A, self._per_period[:, :p], out=self._flow[:p, :p])
            np.multiply(plant.B[:, 0], self._per_period[:, p], out=self._flow[:p, p])
        np.multiply(plant.C[0], self._sizes[:p], out=self._output[:p])
        self._output[p] = plant.D[0, 0] * self._sizes[p]
        try:
            self._values[...], self._vectors[...] = np.linalg.eig(self._flow)
        except np.linalg.LinAlgError:
            return False
        return True

    def poses(self, wanted: FloatArray, energy_m2_s4: float, lost: float) -> bool:
        """Make the stages of the plant taken last and of a target; False if they have no modes.

        Parameters
        ----------
        wanted : (T, L + N + M) target through every term's filter, contiguous.
        energy_m2_s4 : E of the target, > 0. lost : the lost samples' part of it, over E.
        """
        unit, first = math.sqrt(energy_m2_s4), self.problem.target.lost
        end = first + self.problem.grid.stages
        after = address(wanted) + wanted.itemsize * end
        condition = self._c.tr_device_stages(self._device_at, after, unit, self._space, self._stages_at)
        if not condition <= MOST_CONDITION:
            return False
        np.divide(wanted[:, first:end].T, unit, out=self._arrays["reference"])
        self._records["constant"] = (lost + self._stages.rest) / OBJECTIVE_SCALE
        return True

    def unlimited(self) -> FloatArray | None:
        """(N,) the optimum without limits [A]; None if there is none."""
        self._c.tr_linear(1, self._at[0], ct.byref(self._options), self._space, self._into)
        return self._found(bounded=False)

    def limited(self, cut: int = 0) -> FloatArray | None:
        """(N,) the optimum, with a `cut` only under the limits at the stages before it [A]; None if there is none."""
        self._sides[:, cut:] = 0.0  # a search over the first stages does not write the others' multipliers
        if cut:
            self._c.tr_shortened(self._at[1], cut, ct.byref(self._tighter), self._space, self._into)
        else:
            self._c.tr_solve(1, self._at[1], ct.byref(self._options), self._space, self._into)
        return self._found(bounded=True)

    def _found(self, *, bounded: bool) -> FloatArray | None:
        if self._result["code"][0] not in (SOLVED, ACCURACY):
            return None
        command = self._command * self._scale
        if bounded:
            bound = self.problem.command_bound
            np.minimum(np.maximum(command, -bound, out=command), bound, out=command)
            lower, upper = self._sides[:, :-1]
            for row, place in enumerate(self._places):
                np.subtract(upper[:, row], lower[:, row], out=self._by_row[1][:, place])
            np.negative(self._by_row[1], out=self._by_row[0])
            np.maximum(self._by_row, 0.0, out=self._by_row)
        command[self._free :] = 0.0
        np.divide(command, self._scale, out=self._proven)
        np.negative(self._gradient[self._free :], out=self._by_rule)
        for name, at in self._by_row_at.items():
            self._proof[name] = at if bounded else 0
        return command

    def proven(self) -> Proof:
        """The proof of the command that was found last."""
        self._c.tr_prove(1, self._at[2], self._space, self._proof_at)
        *_, merit, slack, residual, dual, by_command, by_movement = self._proof[0].item()
        return Proof(
            (self._excess * self._units).tolist(),
            merit * OBJECTIVE_SCALE,
            residual * self._scale,
            dual * OBJECTIVE_SCALE / self._scale,
            (by_command + slack) * OBJECTIVE_SCALE,
            (by_movement + slack) * OBJECTIVE_SCALE,
        )
