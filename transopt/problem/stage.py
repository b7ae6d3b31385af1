"""The linear stage of the optimal-control problem: devices, current, error filters, the wall's states, command.

x = [plant of each device, current (unless the amplifier is ideal), error filters of each device, encoder position,
its filtered velocity, delayed feedback, command], x_(k+1) = A x_k + A[:, -1] dc_k. The held command is a state and
its movement dc the input. A plant with m motors has m currents and, at the end, m commands; one with p directions has
error filters for each of them.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from transopt.base.signals import BoolArray, FloatArray
from transopt.plant.discretise import StageModel
from transopt.plant.scaling import state_scale
from transopt.problem.limits.row import COMMAND, HELD, INPUT, VELOCITY, Row
from transopt.problem.objective.weighting import ErrorFilter
from transopt.problem.problem import TransientProblem

WALL_POSITION, WALL_VELOCITY = 0, 1  # indices among the wall's states


@dataclass(frozen=True)
class Layout:
    """Positions of the states within x; they determine the sparsity.

    Attributes
    ----------
    plants : number of states of each device, without the currents.
    amplifier : False for an ideal one.
    filters : for each error term, whether it has a filter, of two states.
    priced : whether heat has a price; the inputs are then outputs with reference zero.
    feedback_delay : stages from the state that holds an encoder reading to the command that responds to it; None
        without a wall.
    motors, directions : m and p; if either is above 1 there is one device.
    """

    plants: tuple[int, ...]
    amplifier: bool
    filters: tuple[bool, ...]
    priced: bool
    feedback_delay: int | None
    motors: int = 1
    directions: int = 1

    @property
    def devices(self) -> int:
        return len(self.plants)

    def plant(self, device: int) -> slice:
        start = sum(self.plants[:device])
        return slice(start, start + self.plants[device])

    @property
    def current(self) -> int:
        """Index of the first motor's current; only with an amplifier."""
        return sum(self.plants)

    @cached_property
    def currents(self) -> list[int]:
        """Indices of the plant's inputs, one per motor: the currents, or the commands with ideal amplifiers."""
        first = self.current if self.amplifier else self.states - self.motors
        return [*range(first, first + self.motors)]

    @property
    def _filtered(self) -> int:
        """Index of the first state of an error filter."""
        return sum(self.plants) + self.motors * int(self.amplifier)

    @property
    def courses(self) -> int:
        """Number of tracked accelerations: one per device, or one per direction."""
        return self.devices * self.directions

    def filter(self, course: int, term: int) -> slice:
        """States of a term's filter for a device or direction; only for a term that has a filter."""
        before = course * sum(self.filters) + sum(self.filters[:term])
        start = self._filtered + 2 * before
        return slice(start, start + 2)

    @property
    def errors(self) -> int:
        """Number of tracked outputs: one per acceleration and term, the terms of one acceleration side by side."""
        return self.courses * len(self.filters)

    @property
    def outputs(self) -> int:
        """Number of outputs with a cost: the tracked ones, then the inputs if heat has a price."""
        return self.errors + self.motors * int(self.priced)

    @cached_property
    def wall(self) -> slice:
        """Encoder position, filtered velocity, and the delayed feedback demands, the latest first."""
        start = self._filtered + 2 * self.courses * sum(self.filters)
        return slice(start, start + (0 if self.feedback_delay is None else 3 + self.feedback_delay))

    @cached_property
    def states(self) -> int:
        """Length of x."""
        return int(self.wall.stop) + self.motors

    def dynamics_mask(self) -> BoolArray:
        """(n, n) entries of A that can differ from zero."""
        n, commands = self.states, range(self.states - self.motors, self.states)
        mask = np.zeros((n, n), dtype=bool)
        mask[commands, commands] = True
        if self.amplifier:
            mask[self.currents, self.currents] = mask[self.currents, commands] = True
        driven = [*commands, *(self.currents if self.amplifier else ())]
        for course in range(self.courses):
            plant = self.plant(course // self.directions)
            filters = [self.filter(course, term) for term, there in enumerate(self.filters) if there]
            for rows in (plant, *filters):
                mask[rows, plant] = True
                mask[rows, driven] = True
            for rows in filters:
                mask[rows, rows] = True
        if self.feedback_delay is not None:
            first = self.wall.start
            for row in (first + WALL_POSITION, first + WALL_VELOCITY):
                mask[row, self.plant(0)] = True
                mask[row, -1] = True
                if self.amplifier:
                    mask[row, self.current] = True
            mask[first + WALL_VELOCITY, [first + WALL_POSITION, first + WALL_VELOCITY]] = True
            mask[first + 2, [first + WALL_POSITION, first + WALL_VELOCITY]] = True
            later = np.arange(first + 3, self.wall.stop)
            mask[later, later - 1] = True
        return mask

    def output_mask(self) -> BoolArray:
        """(outputs, n) entries of the output matrix that can differ from zero."""
        mask = np.zeros((self.outputs, self.states), dtype=bool)
        # Without an amplifier the command issued now acts at once.
        mask[: self.errors, self.currents] = True
        for row, (course, term) in enumerate(np.ndindex(self.courses, len(self.filters))):
            mask[row, self.plant(course // self.directions)] = True
            if self.filters[term]:
                mask[row, self.filter(course, term)] = True
        mask[[*range(self.errors, self.outputs)], self.currents if self.priced else []] = True
        return mask


def layout(problem: TransientProblem) -> Layout:
    """The layout of a problem's states, cached in the stage model."""
    own = problem.heat_price > 0, None if problem.wall is None else problem.wall.wall
    same = (*problem.spread, problem.terms)
    return problem.stage.kept(Layout, same, own, lambda: _layout(problem))


def _layout(problem: TransientProblem) -> Layout:
    amplifier = problem.stage.amplifier is not None
    wall, motors = problem.wall, problem.stage.motors
    return Layout(
        plants=tuple(device.A.shape[0] - motors * int(amplifier) for device in problem.devices),
        amplifier=amplifier,
        filters=tuple(term.error_filter is not None for term in problem.terms),
        priced=problem.heat_price > 0,
        feedback_delay=None if wall is None else wall.wall.latency_ticks + problem.stage.whole_delay,
        motors=motors,
        directions=problem.stage.tracked,
    )


@dataclass(frozen=True)
class LinearStage:
    """Scaled stage matrices and the units of the states.

    Attributes
    ----------
    A : (n, n).
    units : (n,) physical size of one scaled unit of each state.
    motors : m; the last m states are the commands.
    input_scale : unit of the plant's input and of the command.
    errors : number of tracked outputs.
    C, E : (outputs, n) and (outputs, m), outputs with a cost by x_k and by dc_k: every tracked acceleration through
        the filter of every term, over sqrt(E), then the inputs in their own unit if heat has a price.
    feedback : (2, n) deviation of the wall's feedback current at this tick and at the one before [A].
    outputs : for each of S devices, or of m motors: named output -> (n,) and scalar, its value in SI by x_k and by
        the movement of the command (with several motors its own), for an input scale of 1; both grow with the scale.
    """

    A: FloatArray
    units: FloatArray
    motors: int
    input_scale: float
    errors: int
    C: FloatArray
    E: FloatArray
    feedback: FloatArray
    outputs: tuple[Mapping[str, tuple[FloatArray, float]], ...]

    @property
    def B(self) -> FloatArray:
        """(n, m) input matrix of the movements dc_k."""
        return self.A[:, -self.motors :]

    def row(self, row: Row) -> tuple[FloatArray, float]:
        """(n,) and scalar: the value of a limit's row by x_k and by dc_k, in SI."""
        G, d = np.zeros(self.units.size), 0.0
        for name, coefficient in row.outputs.items():
            by_state, by_movement = self.output(name, row.device if row.motor is None else row.motor)
            G, d = G + coefficient * by_state, d + coefficient * by_movement
        return G, d

    def output(self, name: str, device: int = 0) -> tuple[FloatArray, float]:
        """(n,) and scalar: a named output of a device, or of a motor, by x_k and by dc_k, in SI."""
        by_state, by_movement = self.outputs[device][name]
        return self.input_scale * by_state, self.input_scale * by_movement

    def scaled(self, input_scale: float, unit_m_s2: float) -> "LinearStage":
        """Convert a stage whose scales are both 1 to an input scale and a unit of the tracked outputs.

        All states scale with the input, so A does not change.
        """
        by = np.full(self.E.shape[0], input_scale / unit_m_s2)
        by[self.errors :] = 1.0
        return LinearStage(
            A=self.A,
            units=self.units * input_scale,
            motors=self.motors,
            input_scale=input_scale,
            errors=self.errors,
            C=self.C * by[:, None],
            E=self.E * by[:, None],
            feedback=self.feedback * input_scale,
            outputs=self.outputs,
        )


def _filters(problem: TransientProblem) -> tuple[ErrorFilter | None, ...]:
    """The filter of every term."""
    return tuple(term.error_filter for term in problem.terms)


def _dynamics(problem: TransientProblem, where: Layout) -> FloatArray:
    """A in SI."""
    n, m = where.states, where.motors
    A = np.zeros((n, n))
    A[-m:, -m:] = np.eye(m)
    C, _ = _accelerations(problem, where)
    currents = slice(where.current, where.current + m)
    for device, stage in enumerate(problem.devices):
        plant = where.plant(device)
        size = where.plants[device]
        A[plant, plant] = stage.A[:size, :size]
        A[plant, -m:] = stage.B[:size]
        if where.amplifier:
            A[plant, currents] = stage.A[:size, size:]
            A[currents, currents], A[currents, -m:] = stage.A[size:, size:], stage.B[size:]
    for course in range(where.courses):
        for term, by in enumerate(_filters(problem)):
            if by is not None:
                Af, Bf, _, _ = by.state_space()
                rows = where.filter(course, term)
                A[rows] = Bf @ C[course : course + 1]
                A[rows, rows] = Af
    if problem.wall is not None:
        wall, dt, first = problem.wall.wall, problem.grid.dt_s, where.wall.start
        assert problem.stage.Cp is not None
        assert problem.stage.Dp is not None
        size = where.plants[0]
        A[first, where.plant(0)] = problem.stage.Cp[0, :size]
        if where.amplifier:
            A[first, where.current] = problem.stage.Cp[0, size]
        A[first, -1] = problem.stage.Dp[0, 0]
        a = wall.smoothing(dt)
        A[first + WALL_VELOCITY] = (1 - a) / dt * A[first]
        A[first + WALL_VELOCITY, first + WALL_POSITION] = -(1 - a) / dt
        A[first + WALL_VELOCITY, first + WALL_VELOCITY] = a
        A[first + 2, first : first + 2] = _demand(problem)
        later = np.arange(first + 3, where.wall.stop)
        A[later, later - 1] = 1.0
    return A


def _demand(problem: TransientProblem) -> FloatArray:
    """(2,) feedback current per metre and per m/s of the encoder's deviation [A/m, A s/m]."""
    assert problem.wall is not None
    wall = problem.wall.wall
    return -np.array([wall.stiffness_N_m, wall.damping_N_s_m]) / wall.force_per_current_N_A


def _accelerations(problem: TransientProblem, where: Layout) -> tuple[FloatArray, FloatArray]:
    """(courses, n) unfiltered accelerations by the state and (courses, m) by the movements, in SI."""
    C, m = np.zeros((where.courses, where.states)), where.motors
    for device, stage in enumerate(problem.devices):
        size, rows = where.plants[device], slice(device * where.directions, (device + 1) * where.directions)
        C[rows, where.plant(device)] = stage.C[:, :size]
        if where.amplifier:
            C[rows, where.current : where.current + m] = stage.C[:, size:]
        C[rows, -m:] = stage.D
    return C, C[:, -m:].copy()


def _outputs(problem: TransientProblem, where: Layout) -> tuple[FloatArray, FloatArray]:
    """(outputs, n) and (outputs, m) outputs with a cost by the state and by the movements, in SI."""
    made, directly = _accelerations(problem, where)
    C, E = np.zeros((where.outputs, where.states)), np.zeros((where.outputs, where.motors))
    for row, (course, term) in enumerate(np.ndindex(where.courses, len(where.filters))):
        C[row], E[row] = made[course], directly[course]
        by = problem.terms[term].error_filter
        if by is not None:
            _, _, Cf, Df = by.state_space()
            C[row], E[row] = C[row] * Df[0, 0], E[row] * Df[0, 0]
            C[row, where.filter(course, term)] = Cf[0]
    if where.priced:
        C[range(where.errors, where.outputs), where.currents] = 1.0
        E[where.errors :] = (0.0 if where.amplifier else 1.0) * np.eye(where.motors)
    return C, E


def linear_stage(problem: TransientProblem, *, physical_scale: bool = True) -> LinearStage:
    """Stage matrices of a problem, with every state scaled to order one or, without `physical_scale`, in SI.

    The part that depends only on devices, filters, wall and horizon is cached in the stage model.
    """
    if not physical_scale:
        return _linear(problem, problem.input_scale, physical_scale=False)
    return in_unit_scales(problem).scaled(problem.input_scale, _unit_m_s2(problem))


def in_unit_scales(problem: TransientProblem) -> LinearStage:
    """The linear stage with both scales 1, which depends on devices, filters, wall and horizon alone."""

    def made() -> LinearStage:
        found = _linear(problem, 1.0, physical_scale=True)
        found.A.flags.writeable = False  # all problems share this array
        return found

    own = problem.heat_price > 0, None if problem.wall is None else problem.wall.wall, problem.grid.stages
    return problem.stage.kept(LinearStage, (*problem.devices, *_filters(problem)), own, made)


def _linear(problem: TransientProblem, current: float, *, physical_scale: bool) -> LinearStage:
    """Stage matrices for an input unit `current`.

    With `physical_scale` the states are scaled and the tracked outputs in SI; without it the states are in SI and the
    tracked outputs in units of sqrt(E).
    """
    where = layout(problem)
    A = _dynamics(problem, where)
    C, E = _outputs(problem, where)
    units, unit = np.ones(where.states), _unit_m_s2(problem)
    if physical_scale:
        N, m, unit = problem.grid.stages, where.motors, 1.0
        if problem.stage.A.shape[0] == where.states - m:
            # Without filters, wall and further devices the states are those of the device, whose scale is cached.
            units[:-m] = problem.stage.state_scale(current, N)
        else:
            units[:-m] = state_scale(A[:-m, :-m], A[:-m, -m:], current, N)
    units[where.currents] = current
    units[-where.motors :] = current
    feedback = np.zeros((2, where.states))
    if where.feedback_delay is not None:
        first, delay = where.wall.start, where.feedback_delay
        for row, late in enumerate((delay, delay + 1)):
            if late == 0:
                feedback[row, first : first + 2] = _demand(problem)
            else:
                feedback[row, first + 1 + late] = 1.0
    per_input = units / current
    unit_of = np.full(where.outputs, unit)
    unit_of[where.errors :] = current
    return LinearStage(
        A=A * units / units[:, None],
        units=units,
        motors=where.motors,
        input_scale=current,
        errors=where.errors,
        C=C * units / unit_of[:, None],
        E=E * current / unit_of[:, None],
        feedback=feedback * units,
        outputs=tuple(
            _named(stage, device, motor, where, per_input)
            for device, stage in enumerate(problem.devices)
            for motor in range(where.motors)
        ),
    )


def _unit_m_s2(problem: TransientProblem) -> float:
    """sqrt(E), the unit of the tracked outputs; 1 for a tap of zero."""
    return float(np.sqrt(problem.tracking.energy_m2_s4)) or 1.0


def units_m_s2(problems: Sequence[TransientProblem]) -> FloatArray:
    """(P,) units of the tracked outputs of problems."""
    return np.array([_unit_m_s2(problem) for problem in problems])


def outputs_of(problems: Sequence[TransientProblem]) -> tuple[FloatArray, FloatArray]:
    """(P, outputs, n) C and (P, outputs, m) E of the linear stages of problems that differ only in the target."""
    stage = in_unit_scales(problems[0])
    by = np.ones((len(problems), stage.C.shape[0], 1))
    by[:, : stage.errors] = (problems[0].input_scale / units_m_s2(problems))[:, None, None]
    return stage.C * by, stage.E * by


def _named(
    stage: StageModel, device: int, motor: int, where: Layout, units: FloatArray
) -> dict[str, tuple[FloatArray, float]]:
    """Named outputs of a device and motor, by the states in these units and by the command's movement.

    The command's unit is 1. Only a plant with one motor has outputs beyond input, command and velocity.
    """
    size, own = where.plants[device], where.plant(device)
    command = np.zeros(where.states)
    command[motor - where.motors] = 1.0

    def of_device(row: FloatArray) -> FloatArray:
        found = np.zeros(where.states)
        found[own] = row[:size] * units[own]
        if where.amplifier:
            found[where.currents] = row[size:]
        return found

    def of_output(name: str) -> tuple[FloatArray, float]:
        row, direct = stage.output(name)
        return of_device(row) + direct * command, direct

    flows = (of_device(stage.Ci[motor]), 0.0) if where.amplifier else (command, 1.0)
    return {
        INPUT: flows,
        COMMAND: (command, 1.0),
        HELD: (command, 0.0),
        VELOCITY: (of_device(stage.Cv[motor]), 0.0),
        **{name: of_output(name) for name in (stage.output_names if where.motors == 1 else ())},
    }
