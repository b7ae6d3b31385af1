"""One problem's numbers for the CasADi statement, and a point of the program in the words of the problem."""

from dataclasses import dataclass

import numpy as np

from transopt.base.signals import FloatArray
from transopt.problem.problem import OBJECTIVE_SCALE, Multipliers, TransientProblem
from transopt.problem.stage import LinearStage, hand_over_rows, linear_stage
from transopt.problem.stage_data import SIZE_BOUND, heat_values, held, kelvin, tracking_values
from transopt.solvers.program import Shape, nonzeros, program_shape, state_program, supply_mask


@dataclass(frozen=True)
class Statement:
    """One problem's numbers for the program of its shape.

    Attributes
    ----------
    values : of the program's parameters, by name. lower_x, upper_x, lower_g, upper_g : bounds.
    kelvin : unit of the rises; 0 without temperature.
    """

    problem: TransientProblem
    shape: Shape
    stage: LinearStage
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

    def _by_stage(self, x: FloatArray) -> FloatArray:
        """(N, variables) of a program point."""
        return x[self.shape.first :].reshape(self.shape.stages, self.shape.variables)

    def command(self, x: FloatArray) -> FloatArray:
        """(N,) commands of a program point [A], as `held`."""
        return self.held(self._by_stage(x)[:, self.shape.command] * self.stage.current_A)

    def held(self, command_A: FloatArray) -> FloatArray:
        """`stagewise.held`."""
        return held(self.problem, command_A)

    def multipliers(self, lam_x: FloatArray, lam_g: FloatArray) -> Multipliers:
        """CasADi's multipliers (grad f + J' lam_g + lam_x = 0) as multipliers of J in SI, clipped to their sign."""
        problem, shape = self.problem, self.shape
        N, rows = shape.stages, state_program(shape).rows
        unit = OBJECTIVE_SCALE / self.stage.current_A
        boxes = self._by_stage(lam_x)
        zero = np.zeros(N)
        on_command = boxes[:, shape.command] * unit
        if problem.limits.command_A is None:
            on_current, on_command = on_command, zero
        else:
            # The variable of stage k is the current at tau_(k+1); the current at tau_0 is zero and has no limit.
            on_current = np.append(0.0, boxes[:-1, shape.controls + shape.layout.current]) * unit
        on_movement = boxes[:, 0] * unit if problem.limits.slew_A_per_s is not None else zero
        before, after = zero, zero
        if problem.supply is not None:
            per_volt = OBJECTIVE_SCALE / problem.supply.limit_V
            before = np.append(0.0, lam_g[rows["supply_before"]]) * per_volt
            after = lam_g[rows["supply_after"]] * per_volt
        sign = zero
        if shape.nodes:
            above, below = (np.maximum(-lam_g[rows[kind]], 0.0) for kind in ("size_above", "size_below"))
            # The two share what the size is worth; where it is worth nothing any sign will do.
            sign = (above - below) / np.maximum(above + below, np.finfo(float).tiny)
        on_winding = zero if shape.nodes == 0 else boxes[:, shape.command + 1] * OBJECTIVE_SCALE / self.kelvin
        return Multipliers(
            current_lower=-on_current,
            current_upper=on_current,
            command_lower=-on_command,
            command_upper=on_command,
            slew_lower=-on_movement,
            slew_upper=on_movement,
            supply_before_lower=-before,
            supply_before_upper=before,
            supply_after_lower=-after,
            supply_after_upper=after,
            temperature_upper=on_winding,
            current_sign=sign,
            hand_over=lam_g[rows["hand_over"]] * unit,
        ).clipped()


def _parameters(problem: TransientProblem, shape: Shape, stage: LinearStage) -> dict[str, FloatArray]:
    """Values of the statement's symbols; the reference enters as r / |r|."""
    where = shape.layout
    values: dict[str, FloatArray | list[float]] = {
        "A": nonzeros(stage.A, where.dynamics_mask()),
        "B": stage.A[:, -1],
        "C": nonzeros(stage.C, where.output_mask()),
        "E": stage.E,
        **tracking_values(problem, stage),
    }
    if problem.thermal is not None:
        # CasADi reads matrices column by column.
        values |= {name: value.T.ravel() for name, value in heat_values(problem, stage.current_A).items()}
    if where.feedback_delay is not None:
        rows, _ = hand_over_rows(problem, stage)
        values["T"] = rows[:, where.wall].ravel()
    if problem.supply is not None:
        volts = problem.supply.limit_V
        values["S"] = nonzeros(stage.supply[None] / volts, supply_mask(where))
        values["S_direct"] = [problem.supply.by_command * stage.current_A / volts]
    return {name: np.asarray(value, dtype=float).ravel() for name, value in values.items()}


def _variable_bounds(
    problem: TransientProblem, shape: Shape, stage: LinearStage, kelvin_K: float
) -> tuple[FloatArray, FloatArray]:
    N, limits, where = shape.stages, problem.limits, shape.layout
    upper = np.full((N, shape.variables), np.inf)
    if limits.slew_A_per_s is not None:
        upper[:, 0] = limits.slew_A_per_s * problem.grid.dt_s / stage.current_A
    if limits.command_A is None:
        upper[:, shape.command] = limits.current_A / stage.current_A
    else:
        upper[:, shape.command] = limits.command_A / stage.current_A
        # The current at tau_N follows the hand-over, so the horizon's limits end at the instant before.
        upper[:-1, shape.controls + where.current] = limits.current_A / stage.current_A
    lower = -upper
    if problem.thermal is not None:
        # No mean current is larger than the limit; unbounded, a size whose heat does not matter would drift.
        size = SIZE_BOUND * limits.current_A / stage.current_A
        lower[:, 1], upper[:, 1] = -size, size
        upper[:, shape.command + 1] = problem.thermal.model.headroom_K / kelvin_K
    # Taps that repeat never cool below the surroundings: colder fixed points are those of a runaway.
    front = np.full(shape.first, np.inf)
    return np.append(np.zeros(shape.first), lower.ravel()), np.append(front, upper.ravel())


def _row_bounds(problem: TransientProblem, shape: Shape, stage: LinearStage) -> tuple[FloatArray, FloatArray]:
    program = state_program(shape)
    lower, upper = np.zeros(program.g.numel()), np.zeros(program.g.numel())
    _, constant = hand_over_rows(problem, stage)
    for kind in ("size_above", "size_below"):
        upper[program.rows.get(kind, slice(0, 0))] = np.inf
    lower[program.rows["hand_over"]] = upper[program.rows["hand_over"]] = constant
    if problem.supply is not None:
        nominal = problem.supply.nominal_V / problem.supply.limit_V
        for kind, volts in (("supply_before", nominal[1:]), ("supply_after", nominal)):
            lower[program.rows[kind]], upper[program.rows[kind]] = -1 - volts, 1 - volts
    return lower, upper


def state(problem: TransientProblem) -> Statement:
    """Numbers of one problem for the program of its shape."""
    shape, stage, unit = program_shape(problem), linear_stage(problem), kelvin(problem)
    lower_x, upper_x = _variable_bounds(problem, shape, stage, unit)
    lower_g, upper_g = _row_bounds(problem, shape, stage)
    values = _parameters(problem, shape, stage)
    return Statement(problem, shape, stage, unit, values, lower_x, upper_x, lower_g, upper_g)
