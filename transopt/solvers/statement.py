"""Numbers of one problem for the CasADi program, and the conversion of its solution to command and multipliers."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from transopt.base.signals import FloatArray
from transopt.problem.answer import OBJECTIVE_SCALE, Multipliers
from transopt.problem.limits import hand_over
from transopt.problem.limits.limit import Limit
from transopt.problem.limits.own import LawRow
from transopt.problem.limits.row import COMMAND, INPUT
from transopt.problem.problem import TransientProblem
from transopt.problem.stage import LinearStage, linear_stage
from transopt.solvers.bounds import check_bounds
from transopt.solvers.program import nonzeros, state_program
from transopt.solvers.shape import Shape, program_shape
from transopt.solvers.stage_data import ended, heat_values, held, slope_of, tracking_values
from transopt.solvers.stated_rows import SIZE_BOUND, StatedRow, kelvin, stated_rows


@dataclass(frozen=True)
class Statement:
    """Numbers of one problem for the program of its shape.

    Attributes
    ----------
    rows : the limits' rows in the order of the program.
    values : name -> value of the program's parameters.
    lower_x, upper_x, lower_g, upper_g : bounds of the variables and of the constraint rows.
    kelvin : unit of the temperature rises [K]; 0 without temperature.
    """

    problem: TransientProblem
    shape: Shape
    stage: LinearStage
    rows: list[StatedRow]
    kelvin: float
    values: dict[str, FloatArray]
    lower_x: FloatArray
    upper_x: FloatArray
    lower_g: FloatArray
    upper_g: FloatArray

    @property
    def p(self) -> FloatArray:
        """The program's parameter vector."""
        return np.concatenate([self.values[name] for name in state_program(self.shape).parameters])

    @property
    def laws(self) -> list[tuple[Limit, LawRow]]:
        """Nonlinear rows, with the limits to which they belong."""
        return [(limit, row) for limit, row in self.problem.rows() if isinstance(row, LawRow)]

    def _by_stage(self, x: FloatArray) -> FloatArray:
        """(N, variables) a program point, stage by stage."""
        return x[self.shape.first :].reshape(self.shape.stages, self.shape.variables)

    def command(self, x: FloatArray) -> FloatArray:
        """(N,) commands [A] of a program point, or (m, N) of several motors, clipped to the bound (`held`)."""
        return self.held(self._stated(x))

    def unclipped(self, x: FloatArray) -> FloatArray:
        """(N,) or (m, N) commands [A] of a program point, not clipped but `ended`."""
        return ended(self.problem, self._stated(x))

    def _stated(self, x: FloatArray) -> FloatArray:
        commands = self._by_stage(x)[:, self.shape.commands].T * self.stage.input_scale
        return np.asarray(commands[0] if self.stage.motors == 1 else commands)

    def held(self, command: FloatArray) -> FloatArray:
        """Clip commands to the bound (`stage_data.held`)."""
        return held(self.problem, command)

    def multipliers(self, lam_x: FloatArray, lam_g: FloatArray) -> Multipliers:
        """CasADi's multipliers (grad f + J' lam_g + lam_x = 0) as multipliers of J in SI, clipped to their sign."""
        problem, shape = self.problem, self.shape
        N, rows = shape.stages, state_program(shape).rows
        unit, boxes, pairs, slope = OBJECTIVE_SCALE / self.stage.input_scale, self._by_stage(lam_x), {}, np.zeros(N)
        for row in self.rows:
            if row.single:
                # The variable of stage k is the current at tau_(k+1); that at tau_0 is zero and has no limit.
                on = boxes[:, variable(shape, row.single) + row.motor]
                mu = (np.append(0.0, on[:-1]) if row.single == INPUT else on) * unit
            else:
                first = N - (rows[row.name].stop - rows[row.name].start)
                mu = np.append(np.zeros(first), lam_g[rows[row.name]]) * (OBJECTIVE_SCALE / row.unit)
            pairs[row.name] = (-mu, mu)
        for limit, law in self.laws:
            mu = lam_g[rows[law.name]] * (OBJECTIVE_SCALE / limit.stated)
            pairs[law.name] = (-mu, mu)
        if problem.thermal is not None:
            slope = slope_of(-lam_g[rows["size_above"]], -lam_g[rows["size_below"]])
            mu = boxes[:, shape.command + 1] * OBJECTIVE_SCALE / self.kelvin
            pairs[problem.thermal.row_names[0]] = (np.zeros(N), mu)
        hand_over = lam_g[rows["hand_over"]] * unit
        if self.stage.motors > 1:
            hand_over = hand_over.reshape(self.stage.motors, -1)
        return Multipliers(N, pairs, hand_over, slope).clipped()


def variable(shape: Shape, single: str) -> int:
    """Index among a stage's variables, for the first motor, of the single variable that a row bounds."""
    return {"movement": 0, COMMAND: shape.command, INPUT: shape.controls + shape.layout.current}[single]


def _parameters(
    problem: TransientProblem, shape: Shape, stage: LinearStage, rows: Sequence[StatedRow]
) -> dict[str, FloatArray]:
    """Values of the statement's symbols; the reference enters as r / |r|."""
    where = shape.layout
    values: dict[str, FloatArray | list[float]] = {
        "A": nonzeros(stage.A, where.dynamics_mask()),
        "B": stage.A[:, -1] if stage.motors == 1 else nonzeros(stage.B, where.dynamics_mask()[:, -stage.motors :]),
        "C": nonzeros(stage.C, where.output_mask()),
        "E": stage.E.T,
        # CasADi reads matrices column by column.
        **{name: value.T for name, value in tracking_values(problem, stage).items()},
    }
    if problem.thermal is not None:
        # CasADi reads matrices column by column.
        values |= {name: value.T.ravel() for name, value in heat_values(problem, stage.input_scale).items()}
    if where.feedback_delay is not None:
        by_state, _ = hand_over.rows(problem, stage)
        values["T"] = by_state[:, where.wall].ravel()
    given = {row.name: row for row in rows}
    for row in shape.rows:
        values[f"G_{row.name}"] = nonzeros(given[row.name].G[None], row.mask)
        values[f"d_{row.name}"] = [given[row.name].d]
    for limit, law in problem.rows():
        if isinstance(law, LawRow):
            seen = [stage.output(name, law.device) for name in law.outputs]
            # CasADi reads matrices column by column.
            values[f"G_{law.name}"] = np.array([G for G, _ in seen]).T.ravel()
            values[f"d_{law.name}"] = [d for _, d in seen]
            nominal = [np.broadcast_to(law.nominal[name], problem.grid.stages) for name in law.outputs]
            values[f"nominal_{law.name}"] = np.array(nominal).T.ravel()
            values[f"unit_{law.name}"] = [limit.stated]
    return {name: np.asarray(value, dtype=float).ravel() for name, value in values.items()}


def _variable_bounds(
    problem: TransientProblem, shape: Shape, stage: LinearStage, rows: Sequence[StatedRow], kelvin_K: float
) -> tuple[FloatArray, FloatArray]:
    N = shape.stages
    upper = np.full((N, shape.variables), np.inf)
    lower = -upper
    for row in rows:
        if not row.single:
            continue
        column, to_variable = variable(shape, row.single) + row.motor, row.unit / stage.input_scale
        low, high = row.lower * to_variable, row.upper * to_variable
        if row.single == INPUT:
            # The variable of stage k is the current at tau_(k+1); that at tau_N follows the hand-over.
            low, high = np.append(low[1:], -np.inf), np.append(high[1:], np.inf)
        elif row.single == COMMAND and problem.wall is None:
            # The hand-over's rows hold these commands at zero, inside the box that all others have.
            low[problem.free_stages :], high[problem.free_stages :] = low[0], high[0]
        lower[:, column], upper[:, column] = np.maximum(lower[:, column], low), np.minimum(upper[:, column], high)
    if problem.thermal is not None:
        # No mean current exceeds the limit. Without this bound a magnitude that does not affect the heat would drift.
        size = SIZE_BOUND * problem.limits.input_limit / stage.input_scale
        lower[:, 1], upper[:, 1] = -size, size
        upper[:, shape.command + 1] = problem.thermal.model.headroom_K / kelvin_K
    # Taps that repeat never cool below the surroundings: colder fixed points are those of a runaway.
    front = np.full(shape.first, np.inf)
    return np.append(np.zeros(shape.first), lower.ravel()), np.append(front, upper.ravel())


def _row_bounds(
    problem: TransientProblem, shape: Shape, stage: LinearStage, rows: Sequence[StatedRow]
) -> tuple[FloatArray, FloatArray]:
    program = state_program(shape)
    lower, upper = np.zeros(program.g.numel()), np.zeros(program.g.numel())
    _, constant = hand_over.rows(problem, stage)
    for kind in ("size_above", "size_below"):
        upper[program.rows.get(kind, slice(0, 0))] = np.inf
    lower[program.rows["hand_over"]] = upper[program.rows["hand_over"]] = np.tile(constant, stage.motors)
    for row in rows:
        if not row.single:
            at = program.rows[row.name]
            first = shape.stages - (at.stop - at.start)
            lower[at], upper[at] = row.lower[first:], row.upper[first:]
    for limit, law in problem.rows():
        if isinstance(law, LawRow):
            lower[program.rows[law.name]], upper[program.rows[law.name]] = (
                law.lower / limit.stated,
                law.upper / limit.stated,
            )
    return lower, upper


def state(problem: TransientProblem) -> Statement:
    """Numbers of one problem for the program of its shape.

    Raises
    ------
    InputError : invalid bounds of a limit (`check_bounds`).
    """
    stage, unit = linear_stage(problem), kelvin(problem)
    shape, rows = program_shape(problem), stated_rows(problem, stage)
    for row in rows:
        check_bounds(row.name, row.lower, row.upper)
    lower_x, upper_x = _variable_bounds(problem, shape, stage, rows, unit)
    lower_g, upper_g = _row_bounds(problem, shape, stage, rows)
    values = _parameters(problem, shape, stage, rows)
    return Statement(problem, shape, stage, rows, unit, values, lower_x, upper_x, lower_g, upper_g)
