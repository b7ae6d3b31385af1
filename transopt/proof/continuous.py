"""Continuous-time simulation of a device under held commands, for the replay and for nothing else.

The replay checks the design by other means, so nothing but the plant's matrices is shared with the design model
(`transopt.plant.discretise`). The time axis is the true one: commands are issued at t_k and felt a delay later. The
integrator is an implicit Runge-Kutta method on a finer step, where the design has a matrix exponential. For commands
that are held a Runge-Kutta step is a linear map, the same in every period.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from transopt.base.matrices import balanced
from transopt.base.recursions import Recursion
from transopt.base.signals import FloatArray
from transopt.plant.discretise import StageModel, TimeGrid, split_delay
from transopt.plant.wall import FeedbackLoop, HandOver

SAMPLES_PER_PERIOD = 8  # at which the trajectory is kept
STEP_RADIUS = 0.5  # largest |eigenvalue| times step to begin with: a stiff mode that is not resolved would die out
STEP_ERROR = 1e-10  # wanted relative difference between a step and half of it
MOST_HALVINGS = 6
AFTER_S = 20e-3  # of free motion after the waveform, at least
AGREEMENT = 1e-6  # largest excusable difference between replay and prediction, relative to the peak
# If link and current forces cancel at the switching instants (a mass on a link that decays within one tick), what
# is left of y'' is rounding of C x and D i. Differences up to this share of them say nothing.
ROUNDING = 16 * float(np.finfo(float).eps)


def peak_scale(peak_m_s2: FloatArray, rounding_m_s2: FloatArray | float) -> FloatArray:
    """The peak, unless `AGREEMENT` of it is less than the rounding of what adds up to it."""
    return np.maximum(np.maximum(peak_m_s2, rounding_m_s2 / AGREEMENT), np.finfo(float).tiny)


def _radau(stages: int) -> tuple[FloatArray, FloatArray]:
    """Butcher matrix (s, s) and weights (s,) of Radau IIA: order 2 s - 1, L-stable, last node at 1.

    Nodes as in Hairer & Wanner, Solving Ordinary Differential Equations II, Sec. IV.5.
    """
    # Roots of the difference of two Legendre polynomials, P_s - P_(s-1).
    nodes = (np.polynomial.legendre.legroots([0.0] * (stages - 1) + [-1.0, 1.0]) + 1) / 2
    powers = np.arange(stages)
    integrals = nodes[:, None] ** (powers + 1) / (powers + 1)
    butcher = integrals @ np.linalg.inv(nodes[:, None] ** powers)
    return butcher, butcher[-1]


_BUTCHER, _WEIGHTS = _radau(5)


def _step_map(A: FloatArray, B: FloatArray, h_s: float) -> tuple[FloatArray, FloatArray]:
    """One Radau step of dx/dt = A x + B u with u held: x+ = P x + Q u."""
    n, s = A.shape[0], _WEIGHTS.size
    equations = np.eye(s * n) - h_s * np.kron(_BUTCHER, A)
    slopes = np.linalg.solve(equations, np.tile(np.hstack([A, B]), (s, 1))).reshape(s, n, n + 1)
    step = h_s * np.einsum("s,snm->nm", _WEIGHTS, slopes)
    return np.eye(n) + step[:, :n], step[:, n:]


@dataclass(frozen=True)
class Segment:
    """The share of a servo period in which one command c is felt: maps from its start to each kept sample.

    Attributes
    ----------
    behind : how many ticks before the period's own command c was issued.
    offsets_s : (m + 1,) times of the kept samples from the start of the period, the segment's start first.
    P : (m + 1, n, n), Q : (m + 1, n, 1) of x_j = P_j x_0 + Q_j c.
    """

    behind: int
    offsets_s: FloatArray
    P: FloatArray
    Q: FloatArray


def _segment(flow: "Flow", start_s: float, end_s: float, behind: int, halvings: int) -> Segment:
    """Kept samples a fraction of a period apart, reached by as many Radau steps as the stiffest mode needs."""
    n = flow.A.shape[0]
    samples = SAMPLES_PER_PERIOD // 2
    spacing = (end_s - start_s) / samples
    doublings = int(np.ceil(np.log2(max(flow.fastest_rad_s * spacing / STEP_RADIUS, 1.0)))) + halvings
    step = np.eye(n + 1)
    step[:n, :n], step[:n, n:] = _step_map(flow.A, flow.B, spacing / 2**doublings)
    between = np.linalg.matrix_power(step, 2**doublings)
    maps = [np.eye(n + 1)]
    for _ in range(samples):
        maps.append(between @ maps[-1])
    stacked = np.stack(maps)
    return Segment(behind, np.linspace(start_s, end_s, samples + 1), stacked[:, :n, :n], stacked[:, :n, n:])


def _segments(flow: "Flow", grid: TimeGrid, halvings: int) -> list[Segment]:
    """A period [t_k, t_(k+1)) feels the command of one tick earlier until the delay's fraction has passed."""
    dt = grid.dt_s
    whole, late = split_delay(grid.delay_s, dt)
    if late <= 1e-9 * dt:
        # Two halves all the same, so that a period always has as many kept samples.
        return [_segment(flow, 0.0, dt / 2, whole, halvings), _segment(flow, dt / 2, dt, whole, halvings)]
    return [_segment(flow, 0.0, late, whole + 1, halvings), _segment(flow, late, dt, whole, halvings)]


@dataclass(frozen=True)
class Trajectory:
    """The kept samples of M taps, K of each.

    Attributes
    ----------
    times_s : (K,) contact at 0.
    acceleration_m_s2 : (M, K) y'' of the stylus.
    plant_input : (M, K) in the motor.
    felt : (M, K) command that the amplifier follows.
    velocity_m_s : (M, K) dy/dt of the motor mass; (M, 0) where nobody asks for it.
    outputs : name -> (M, K) of a further output of the stage.
    at_switching : (N,) indices of the samples just after each switching instant.
    segment_starts : (S,) indices of the first sample of each segment.
    """

    times_s: FloatArray
    acceleration_m_s2: FloatArray
    plant_input: FloatArray
    felt: FloatArray
    velocity_m_s: FloatArray
    outputs: dict[str, FloatArray]
    at_switching: NDArray[np.intp]
    segment_starts: NDArray[np.intp]


@dataclass(frozen=True)
class Loop:
    """The walls of M taps, closed over the replay's own motion.

    Attributes
    ----------
    walls : M hand-overs with the same wall.
    count_m : the encoder is rounded to whole multiples of this; 0 does not round.
    """

    walls: Sequence[HandOver]
    count_m: float

    @cached_property
    def _nominal_m(self) -> FloatArray:
        """(K, M) z_nom at the ticks that the walls know."""
        return np.stack([wall.nominal_m for wall in self.walls], axis=1)

    def nominal(self, k: int) -> FloatArray:
        """(M,) z_nom at tick k, going on straight after the last."""
        z = self._nominal_m
        last = z.shape[0] - 1
        return np.asarray(z[k] if k <= last else z[last] + (k - last) * (z[last] - z[last - 1]))

    def read(self, k: int, deviation_m: FloatArray) -> FloatArray:
        """(M,) what the encoder reads at tick k for the deviations y (M,) from the nominal motion."""
        z = self.nominal(k) + deviation_m
        return np.asarray(np.round(z / self.count_m) * self.count_m) if self.count_m else z

    def start(self, stage: StageModel, dt_s: float) -> FeedbackLoop:
        """The wall's law before its first tick."""
        wall = self.walls[0].wall
        approach = np.array([wall.approach_m_s for wall in self.walls])
        first = self.read(0, np.zeros(approach.size))
        return FeedbackLoop(wall, stage.amplifier, dt_s, first, approach)


@dataclass(frozen=True)
class Flow:
    """Plant and amplifier in balanced units: dx/dt = A x + B c.

    The current is the last state, unless the amplifier is ideal and the current is the command c itself.

    Attributes
    ----------
    A : (n, n).
    B : (n, 1).
    rows : (3 + further, n) what the states add to y'', the current, the velocity of the motor mass and the further
        outputs of the stage.
    direct : (3 + further,) what the command that is felt adds to them.
    names : of the further outputs.
    encoder : (n,) position of the motor mass, of the states.
    """

    A: FloatArray
    B: FloatArray
    rows: FloatArray
    direct: FloatArray
    names: tuple[str, ...]
    encoder: FloatArray

    @cached_property
    def fastest_rad_s(self) -> float:
        """Largest size of an eigenvalue of A."""
        return float(np.abs(np.linalg.eigvals(self.A)).max())

    @classmethod
    def of(cls, stage: StageModel) -> "Flow":
        """From the continuous-time plant and the amplifier of a stage; its discrete matrices are not used."""
        plant, amplifier = stage.plant, stage.amplifier
        n, velocity = plant.order, plant.Cv[0]
        if amplifier is None:
            A, B, more, direct = plant.A, plant.B, 0, [plant.D[0, 0], 1.0, 0.0]
        else:
            w = amplifier.rate_rad_s
            A = np.block([[plant.A, plant.B], [np.zeros((1, n)), -w * np.eye(1)]])
            B, more, direct = np.append(np.zeros((n, 1)), [[w]], axis=0), 1, [0.0, 0.0, 0.0]
        # In balanced units (powers of two, exact) no state drowns in the rounding of another.
        even, units = balanced(A)
        further = {name: plant.output(name).row for name in stage.outputs}
        rows = np.zeros((3 + len(further), n + more))
        for j, row in enumerate(further.values()):
            rows[3 + j, :n] = row[0]
        rows[0, :n], rows[2, :n] = plant.C[0], velocity
        if more:
            rows[0, n], rows[1, n] = plant.D[0, 0], 1.0
        encoder = np.append(plant.Ce[0], np.zeros(more))
        return cls(
            even,
            B / units[:, None],
            rows * units,
            np.array(direct + [0.0] * len(further)),
            tuple(further),
            encoder * units,
        )


@dataclass(frozen=True)
class Period:
    """One servo period as one map: the second of its segments goes on from the first.

    Attributes
    ----------
    segments : two.
    P : (n, n), by_command : (n, 1 + late) of x_(k+1) = P x_k + by_command @ (issued_k, .., issued_(k+late)), where
        the issued commands begin with the silence before the first.
    arriving : index of the segment in which a tick's own command is felt first.
    periods : that are played, until `after_s` after tau_N.
    instants : N and those after the window that the problem looks at.
    """

    segments: list[Segment]
    P: FloatArray
    by_command: FloatArray
    arriving: int
    periods: int
    instants: int

    @classmethod
    def of(cls, flow: Flow, grid: TimeGrid, halvings: int) -> "Period":
        """A period integrated by a Runge-Kutta step that is halved so often."""
        segments = _segments(flow, grid, halvings)
        first, second = segments
        late = first.behind - second.behind
        by_command = np.zeros((flow.A.shape[0], 1 + late))
        by_command[:, 0] += (second.P[-1] @ first.Q[-1])[:, 0]
        by_command[:, late] += second.Q[-1][:, 0]
        return cls(
            segments,
            second.P[-1] @ first.P[-1],
            by_command,
            # If the delay is whole the command arrives with the tick, else with the second segment.
            arriving=0 if late == 0 else 1,
            periods=grid.stages + first.behind + int(np.ceil(after_s(grid) / grid.dt_s)),
            instants=grid.stages + grid.after_stages,
        )

    @property
    def late(self) -> int:
        """Ticks by which the second segment's command was issued after the first's."""
        return int(self.by_command.shape[1]) - 1

    @property
    def at_switching(self) -> slice:
        """Periods whose arriving segments start at the switching instants, those after the window among them."""
        behind = self.segments[self.arriving].behind
        return slice(behind, behind + self.instants)

    def issued(self, commands: FloatArray) -> FloatArray:
        """(M, periods + late or more) of commands (M, N), with the silence before the first and after the last."""
        behind = self.segments[0].behind
        found = np.zeros((commands.shape[0], behind + self.periods))
        found[:, behind : behind + commands.shape[1]] = commands
        return found


@dataclass(frozen=True)
class Course:
    """States of M taps at the start of every segment, from the first tick until `after_s` after tau_N.

    Attributes
    ----------
    period : that is played again and again.
    states : (M, periods, n) per segment, at its start.
    felt : (M, periods) per segment, the command that is felt in it.
    command : (M, N) as issued.
    """

    period: Period
    states: list[FloatArray]
    felt: list[FloatArray]
    command: FloatArray

    def of(self, taps: slice) -> "Course":
        """The course of some of the taps."""
        return Course(
            self.period,
            [states[taps] for states in self.states],
            [felt[taps] for felt in self.felt],
            self.command[taps],
        )

    def accelerations(self, flow: Flow) -> FloatArray:
        """(M, instants) y'' just after the switching instants."""
        at, arriving = self.period.at_switching, self.period.arriving
        states, felt = self.states[arriving][:, at], self.felt[arriving][:, at]
        return np.asarray(states @ flow.rows[0] + flow.direct[0] * felt)

    def rounding(self, flow: Flow) -> FloatArray:
        """(M,) `ROUNDING` times the largest sum of the sizes of the terms that add up to y'' there [m/s^2]."""
        at, arriving = self.period.at_switching, self.period.arriving
        states, felt = np.abs(self.states[arriving][:, at]), np.abs(self.felt[arriving][:, at])
        terms = states @ np.abs(flow.rows[0]) + np.abs(flow.direct[0]) * felt
        return np.asarray(ROUNDING * terms.max(axis=1))


def _held(P: FloatArray, by_command: FloatArray, issued: FloatArray, periods: int) -> FloatArray:
    """(M, periods, n) of x_(k+1) = P x_k + by_command @ (issued_k, issued_(k+1), ...), x_0 = 0.

    Parameters
    ----------
    by_command : (n, w).
    issued : (M, at least periods + w - 1).
    """
    (n, w), M, recursion = by_command.shape, issued.shape[0], Recursion(P)
    pushed = np.zeros((M, periods, n))
    for late in range(w):
        pushed[:, 1:] += issued[:, late : late + periods - 1, None] * by_command[:, late]
    return np.stack([recursion.run(each) for each in pushed])


def _play(
    stage: StageModel, flow: Flow, grid: TimeGrid, commands: FloatArray, period: Period, loop: Loop | None
) -> Course:
    """The states of M taps under the commands (M, N) [A], period by period; `loop` adds the wall's feedback."""
    (M, N), n, late = commands.shape, flow.A.shape[0], period.late
    first, periods = period.segments[0], period.periods
    # Before the first command and after the waveform there is silence, or what the wall goes on asking for.
    issued = period.issued(commands)
    if loop is None:
        starts = _held(period.P, period.by_command, issued, periods)
    else:
        starts, x = np.zeros((M, periods, n)), np.zeros((M, n))
        feedback = loop.start(stage, grid.dt_s)
        for k in range(periods):
            starts[:, k] = x
            issued[:, first.behind + k] += feedback.step(loop.read(k, x @ flow.encoder))
            x = x @ period.P.T + issued[:, k : k + 1 + late] @ period.by_command.T
    felt = [issued[:, :periods], issued[:, late : late + periods]]
    middle = starts @ first.P[-1].T + felt[0][..., None] * first.Q[-1][:, 0]
    return Course(period, [starts, middle], felt, issued[:, first.behind : first.behind + N])


def after_s(grid: TimeGrid) -> float:
    """How long the replay looks at the free motion after the waveform: through all that the problem looks at."""
    return max(AFTER_S, grid.after_stages * grid.dt_s)


def fine(course: Course, flow: Flow, grid: TimeGrid, *, moving: bool = True) -> Trajectory:
    """All kept samples of a course: `SAMPLES_PER_PERIOD` a period, and the start of each segment besides.

    Parameters
    ----------
    moving : whether anybody asks for the velocity of the motor mass, or for a further output.
    """
    M, periods, _ = course.states[0].shape
    period, samples = course.period, course.period.segments[0].offsets_s.size
    n, outputs = flow.encoder.size, flow.direct.size if moving else 2
    # Segment after segment within each period, all of it along one axis in the end: one product an output, of what
    # stands at the starts of both segments and what is felt in them.
    begun = np.concatenate(
        [
            np.append(states, command[..., None], axis=-1)
            for states, command in zip(course.states, course.felt, strict=True)
        ],
        axis=-1,
    )
    maps = np.zeros((outputs, 2, n + 1, 2, samples))
    felt, times = np.empty((M, periods, 2, samples)), np.empty((periods, 2, samples))
    ticks = grid.dt_s * np.arange(periods) - grid.lead_s
    for j, (segment, command) in enumerate(zip(period.segments, course.felt, strict=True)):
        rows, direct = flow.rows[:outputs], flow.direct[:outputs]
        maps[:, j, :n, j] = np.moveaxis(rows @ segment.P, 0, -1)
        maps[:, j, n, j] = (rows @ segment.Q[..., 0].T) + direct[:, None]
        felt[:, :, j] = command[..., None]
        times[:, j] = ticks[:, None] + segment.offsets_s
    with np.errstate(over="ignore", invalid="ignore"):  # a wall that grows by itself
        values = begun.reshape(M * periods, -1) @ maps.reshape(outputs, 2 * (n + 1), -1)
    acceleration, current, *others = values.reshape(outputs, M, -1)
    velocity, *further = others or [np.empty((M, 0))]
    starts = samples * np.arange(2 * periods)
    at = period.at_switching
    return Trajectory(
        times_s=times.ravel(),
        acceleration_m_s2=acceleration,
        plant_input=current,
        felt=felt.reshape(M, -1),
        velocity_m_s=velocity,
        outputs=dict(zip(flow.names, further, strict=moving)),
        at_switching=starts[period.arriving :: 2][at][: grid.stages],
        segment_starts=starts,
    )


@dataclass(frozen=True)
class Accurate:
    """M commands played with a Runge-Kutta step that is fine enough.

    Attributes
    ----------
    flow, loop : what was played.
    acceleration_m_s2 : (M, instants) y'' just after the switching instants, those after the window behind.
    step_error : (M,) largest difference of y'' to the course of twice the step, relative to its peak.
    course : their states.
    """

    flow: Flow
    loop: Loop | None
    acceleration_m_s2: FloatArray
    step_error: FloatArray
    course: Course

    def of(self, taps: slice) -> "Accurate":
        """The replay of some of the commands, which no wall's feedback was added to."""
        assert self.loop is None
        return replace(
            self,
            acceleration_m_s2=self.acceleration_m_s2[taps],
            step_error=self.step_error[taps],
            course=self.course.of(taps),
        )


def _flow(stage: StageModel) -> Flow:
    """The flow of a device, kept with it for the next replay."""
    if Flow not in stage.derived:
        stage.derived[Flow] = Flow.of(stage)
    found: Flow = stage.derived[Flow]
    return found


def _period(stage: StageModel, grid: TimeGrid, halvings: int) -> Period:
    """The period of a device, kept with it for the next replay."""
    key = Period, grid, halvings
    if key not in stage.derived:
        stage.derived[key] = Period.of(_flow(stage), grid, halvings)
    found: Period = stage.derived[key]
    return found


def accurate(stage: StageModel, grid: TimeGrid, commands: FloatArray, loop: Loop | None) -> Accurate:
    """Play commands (M, N) [A], halving the step until halving changes y'' by no more than `STEP_ERROR`.

    After `MOST_HALVINGS` the finest course is returned as it is; its `step_error` says how good it is.

    Parameters
    ----------
    loop : the walls whose feedback is added to the commands; None for none.
    """
    flow = _flow(stage)
    coarse = _play(stage, flow, grid, commands, _period(stage, grid, 0), loop).accelerations(flow)
    for halvings in range(1, MOST_HALVINGS + 1):
        period = _period(stage, grid, halvings)
        course = _play(stage, flow, grid, commands, period, loop)
        found = course.accelerations(flow)
        difference, peak = np.abs(found - coarse).max(axis=1), np.abs(found).max(axis=1)
        step_error = difference / peak_scale(peak, 0.0)
        if not np.all(step_error <= STEP_ERROR):
            step_error = difference / peak_scale(peak, course.rounding(flow))
        coarse = found
        if np.all(step_error <= STEP_ERROR):
            break
    return Accurate(flow, loop, found, step_error, course)
