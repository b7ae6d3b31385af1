"""Problems of several motors, solved by the interior-point method in C (`native/motors.c`).

The stage data are computed from the linear stage and from the rows of the limits, as those of `stage_data` are.
"""

import time
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from transopt.base.signals import FloatArray
from transopt.problem.answer import OBJECTIVE_SCALE, Multipliers, Solution, Status
from transopt.problem.objective.tail import tail
from transopt.problem.problem import TransientProblem
from transopt.problem.stage import Layout, LinearStage, layout, linear_stage
from transopt.proof.farkas import is_infeasible
from transopt.solvers.bounds import check_bounds
from transopt.solvers.modes import MOST_CONDITION
from transopt.solvers.native.motors import (
    ACCURACY,
    MOST_MOTORS,
    MOST_OUTPUTS,
    MOST_ROWS,
    MOST_STATES,
    SOLVED,
    Answer,
    available,
    interior_point,
)
from transopt.solvers.options import SolverOptions
from transopt.solvers.riccati import LOOSER, STATUS
from transopt.solvers.stage_data import StatedRow, held, stated_rows, tracking_values

UNLIMITED_GAP = 1e-8  # tolerance of the gap relative to max(J, 1e-3), as `unlimited.GAP`
UNLIMITED_STEPS = 5  # Newton steps: the first solves the problem without limits, the others refine the answer


def can_solve(problem: TransientProblem) -> bool:
    """Whether the extension exists, and the problem has several motors and fits it."""
    where = layout(problem)
    return (
        available
        and 1 < where.motors <= MOST_MOTORS
        and where.states <= MOST_STATES
        and where.outputs <= MOST_OUTPUTS
        and len(problem.rows()) <= MOST_ROWS
        and not problem.nonlinear
    )


def solve(problem: TransientProblem, options: SolverOptions, *, modal: bool = True) -> Solution:
    """Solve the QP stage by stage; INFEASIBLE is returned only with a proof (`farkas`).

    Parameters
    ----------
    modal : whether modal coordinates are used where they are well conditioned.

    Raises
    ------
    InputError : invalid bounds of a limit (`check_bounds`).
    """
    start, stage = time.perf_counter(), linear_stage(problem)
    rows = stated_rows(problem, stage)
    for row in rows:
        check_bounds(row.name, row.lower, row.upper)
    by = Numbers.of(problem, stage, rows, modal=modal)
    answer = by.solved(LOOSER * options.tolerance, options.max_iterations)
    status, message = STATUS[answer.code]
    command, multipliers = by.command(answer), by.multipliers(answer)
    if status is not Status.OPTIMAL and is_infeasible(problem, command, multipliers):
        status, message = Status.INFEASIBLE, f"{message}: a ray proves that no command meets all limits"
    spent = time.perf_counter() - start
    return Solution(status, command, multipliers, "riccati", message, answer.iterations, spent)


def unlimited(problem: TransientProblem) -> Solution | None:
    """Minimise J subject to dynamics and hand-over only, as `unlimited.solve`; None where the method fails."""
    start = time.perf_counter()
    if can_solve(problem):
        by = Numbers.of(problem, linear_stage(problem), [], modal=True)
        answer = by.solved(UNLIMITED_GAP, UNLIMITED_STEPS)
        if answer.code in (SOLVED, ACCURACY):
            command = by.command(answer, inside=False)
            spent = time.perf_counter() - start
            return Solution(
                Status.OPTIMAL, command, by.multipliers(answer), "unlimited", "Riccati pass", answer.iterations, spent
            )
    return None


@dataclass(frozen=True)
class Numbers:
    """One problem as input of the method, in the units of its linear stage: the fields of `tm_problem` by name."""

    problem: TransientProblem
    rows: list[StatedRow]
    input_scale: float
    sizes: dict[str, int]
    numbers: dict[str, float]
    arrays: dict[str, Any]

    @classmethod
    def of(cls, problem: TransientProblem, stage: LinearStage, rows: list[StatedRow], *, modal: bool) -> "Numbers":
        where, N, n, unit = layout(problem), problem.grid.stages, stage.units.size, 2 / OBJECTIVE_SCALE
        A, T = modes(stage, where) if modal else (stage.A, np.eye(n))
        values, after = tracking_values(problem, stage), tail(problem, stage)
        arrays = {
            "A": A,
            "C": stage.C @ T,
            "E": np.zeros_like(stage.E) if where.amplifier else stage.E,
            "weight": values["w"] * unit,
            "reference": values["r"],
            "end_gain": after.gain @ T * np.sqrt(unit),
            "end_target": after.target * np.sqrt(unit),
            "G": np.array([row.G for row in rows]).reshape(-1, n) @ T,
            "d": np.array([row.d for row in rows]),
            "lower": np.array([row.lower for row in rows]).reshape(-1, N).T,
            "upper": np.array([row.upper for row in rows]).reshape(-1, N).T,
        }
        return cls(
            problem=problem,
            rows=rows,
            input_scale=stage.input_scale,
            sizes={
                "stages": N,
                "free_stages": problem.free_stages,
                "states": n,
                "motors": stage.motors,
                "outputs": where.outputs,
                "ends": after.target.size,
                "rows": len(rows),
            },
            numbers={
                "movement_weight": float(values["rho"][0]) * unit,
                "command_bound": problem.command_bound / stage.input_scale,
                "constant": float(values["constant"][0]) / OBJECTIVE_SCALE,
            },
            arrays={name: np.ascontiguousarray(array, dtype=float) for name, array in arrays.items()}
            | {"motor": np.array([row.motor for row in rows], dtype=np.intc)},
        )

    def solved(self, tolerance: float, max_iterations: int) -> Answer:
        with np.errstate(over="ignore", invalid="ignore"):
            return interior_point(
                self.sizes, self.numbers, self.arrays, tolerance=tolerance, max_iterations=max_iterations
            )

    def command(self, answer: Answer, *, inside: bool = True) -> FloatArray:
        """(m, N) commands [A]; with `inside` clipped to the command bound (`held`)."""
        found = answer.command.T * self.input_scale
        if inside:
            return held(self.problem, found)
        found[:, self.problem.free_stages :] = 0.0
        return found

    def multipliers(self, answer: Answer) -> Multipliers:
        """Multipliers of J in SI."""
        net = (answer.upper - answer.lower).T
        units = [OBJECTIVE_SCALE / row.unit for row in self.rows]
        pairs = {row.name: (-mu * by, mu * by) for row, mu, by in zip(self.rows, net, units, strict=True)}
        tail_of = -answer.gradient[self.problem.free_stages :].T * (OBJECTIVE_SCALE / self.input_scale)
        zero = Multipliers.zero(self.problem)
        return replace(zero, pairs=pairs, hand_over=np.ascontiguousarray(tail_of)).clipped()


def modes(stage: LinearStage, where: Layout) -> tuple[FloatArray, FloatArray]:
    """Modal coordinates z, x = T z: returns A in z, and T.

    The order is complex modes in pairs, real modes, currents, commands. The eigenvectors of the plant's modes include
    the response of the error filters. The filters themselves are equal for all directions and keep their two states
    as pairs. T is the identity where it is ill conditioned (`modes`).
    """
    n, m, A = stage.units.size, stage.motors, stage.A
    dense = A, np.eye(n)
    if not np.isfinite(A).all():
        return dense
    size, before = sum(where.plants), n - m
    pole = float(A[where.current, where.current]) if where.amplifier else 0.0
    plant, filters = slice(size), slice(size + m * int(where.amplifier), before)
    values, vectors = np.linalg.eig(A[plant, plant])
    try:
        whole = np.zeros((n, size), dtype=complex)
        whole[plant] = vectors
        for j, value in enumerate(values):
            whole[filters, j] = _driven(A, filters, value, A[filters, plant] @ vectors[:, j])
        currents = np.zeros((n, m if where.amplifier else 0))
        for c in range(currents.shape[1]):
            at = where.currents[c]
            currents[at, c] = 1.0
            currents[plant, c] = _driven(A, plant, pole, A[plant, at]).real
            by = A[filters, plant] @ currents[plant, c] + A[filters, at]
            currents[filters, c] = _driven(A, filters, pole, by).real
    except np.linalg.LinAlgError:
        return dense
    pairs = []
    for vector in whole.T[values.imag > 0]:
        # Choose the phase of the eigenvector for which its real and imaginary parts are orthogonal.
        turned = vector * np.exp(-0.5j * np.angle(np.sum(vector**2)))
        pairs += [turned.real, turned.imag]
    real = list(whole.T[values.imag == 0].real)
    own = np.eye(n)
    columns = [*pairs, *own[filters], *real]
    T = np.array([*(column / max(np.linalg.norm(column), 1e-300) for column in columns), *currents.T, *own[-m:]]).T
    if not np.linalg.cond(T) <= MOST_CONDITION:
        return dense
    found = np.linalg.solve(T, A @ T)
    return np.where(_pattern(n, m, len(pairs) + before - filters.start), found, 0.0), T


def _driven(A: FloatArray, states: slice, pole: complex, by: FloatArray) -> FloatArray:
    """Part of an eigenvector in driven states, y with (A - pole) y = -by."""
    own = A[states, states]
    return np.asarray(np.linalg.solve(own - pole * np.eye(own.shape[0]), -by))


def _pattern(n: int, m: int, paired: int) -> FloatArray:
    """(n, n) sparsity of A in modal coordinates: the first `paired` states in pairs, and the commands' columns."""
    found = np.eye(n, dtype=bool)
    found[:, n - m :] = True
    for first in range(0, paired, 2):
        found[first : first + 2, first : first + 2] = True
    found[n - m :, n - m :] = np.eye(m, dtype=bool)
    return found
