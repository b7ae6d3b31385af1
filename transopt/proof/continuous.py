"""Continuous-time simulation of a device under held commands, for the replay only.

The replay checks the design by independent means, so it shares only the plant's matrices with the design model
(`transopt.plant.discretise`). On its time axis commands are issued at t_k and act a delay later. The integrator is an
implicit Runge-Kutta method with a finer step, where the design uses a matrix exponential. Under held commands a
Runge-Kutta step is a linear map, the same in every period.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from transopt.base.recursions import LinearSystem
from transopt.base.signals import FloatArray
from transopt.plant.discretise import StageModel, split_delay
from transopt.plant.time_grid import TimeGrid
from transopt.plant.wall import FeedbackLoop, HandOver
from transopt.proof.flow import Flow

SAMPLES_PER_PERIOD = 8  # samples of the trajectory per servo period
STEP_RADIUS = 0.5  # largest |eigenvalue| times step at the start; an unresolved stiff mode would be damped out
STEP_ERROR = 1e-10  # wanted relative difference between results with a step and with half of it
MOST_HALVINGS = 6
AFTER_S = 20e-3  # least simulated time after the waveform
AGREEMENT = 1e-6  # largest accepted difference between replay and prediction, relative to the peak
# If link and current forces cancel at the switching instants (a mass on a link that decays within one tick), y'' is
# the rounding error of C x and D i. Differences up to this share of the two are not significant.
ROUNDING = 16 * float(np.finfo(float).eps)


def peak_scale(peak_m_s2: FloatArray, rounding_m_s2: FloatArray | float) -> FloatArray:
    """The peak, as reference for relative differences; raised where `AGREEMENT` of it is below rounding errors."""
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
    equations = np.eye(s * n) - h_s * np.einsum("ij,kl->ikjl", _BUTCHER, A).reshape(s * n, s * n)
    slopes = np.linalg.solve(equations, np.tile(np.hstack([A, B]), (s, 1))).reshape(s, n, -1)
    step = h_s * np.einsum("s,snm->nm", _WEIGHTS, slopes)
    return np.eye(n) + step[:, :n], step[:, n:]


@dataclass(frozen=True)
class Segment:
    """The part of a servo period in which one command c (m,) acts, with maps from its start to each sample.

    Attributes
    ----------
    behind : number of ticks by which c was issued before the period's own command.
    offsets_s : (S,) times of the samples from the start of the period, the segment's start first.
    P, Q : (S, n, n) and (S, n, m) of x_j = P_j x_0 + Q_j c.
    """

    behind: int
    offsets_s: FloatArray
    P: FloatArray
    Q: FloatArray


def _segment(flow: Flow, start_s: float, end_s: float, behind: int, halvings: int) -> Segment:
    """The segment with its samples, each reached by as many Radau steps as the stiffest mode needs."""
    n, m = flow.B.shape
    samples = SAMPLES_PER_PERIOD // 2
    spacing = (end_s - start_s) / samples
    doublings = int(np.ceil(np.log2(max(flow.fastest_rad_s * spacing / STEP_RADIUS, 1.0)))) + halvings
    step = np.eye(n + m)
    step[:n, :n], step[:n, n:] = _step_map(flow.A, flow.B, spacing / 2**doublings)
    between = np.linalg.matrix_power(step, 2**doublings)
    maps = [np.eye(n + m)]
    for _ in range(samples):
        maps.append(between @ maps[-1])
    stacked = np.stack(maps)
    return Segment(behind, np.linspace(start_s, end_s, samples + 1), stacked[:, :n, :n], stacked[:, :n, n:])


def _segments(flow: Flow, grid: TimeGrid, halvings: int) -> list[Segment]:
    """The two segments of a period [t_k, t_(k+1)): the earlier command acts until the delay's fraction has passed."""
    dt = grid.dt_s
    whole, late = split_delay(grid.delay_s, dt)
    if late <= 1e-9 * dt:
        # Two halves in this case too, so that a period always has the same number of samples.
        return [_segment(flow, 0.0, dt / 2, whole, halvings), _segment(flow, dt / 2, dt, whole, halvings)]
    return [_segment(flow, 0.0, late, whole + 1, halvings), _segment(flow, late, dt, whole, halvings)]


@dataclass(frozen=True)
class Trajectory:
    """The K samples of each of M taps; as in `Motion`, with p directions or m motors (M, p, K) or (M, m, K).

    Attributes
    ----------
    times_s : (K,) times, contact at 0.
    acceleration_m_s2 : (M, K) y'' of the stylus; (M, 0) if the motion was not requested.
    plant_input : (M, K) input of the plant.
    felt : (M, K) command that acts on the amplifier.
    velocity_m_s : (M, K) dy/dt of the motor mass; (M, 0) if the motion was not requested.
    outputs : name -> (M, K) further output of the stage model.
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
    """The closed loop of the walls of M taps with the replay's motion.

    Attributes
    ----------
    walls : M hand-overs with the same wall.
    count_m : resolution to which the encoder is rounded; 0 does not round.
    """

    walls: Sequence[HandOver]
    count_m: float

    @cached_property
    def _nominal_m(self) -> FloatArray:
        """(K, M) z_nom at the ticks of window and tail."""
        return np.stack([wall.nominal_m for wall in self.walls], axis=1)

    def nominal(self, k: int) -> FloatArray:
        """(M,) z_nom at tick k, extrapolated linearly after the last one."""
        z = self._nominal_m
        last = z.shape[0] - 1
        return np.asarray(z[k] if k <= last else z[last] + (k - last) * (z[last] - z[last - 1]))

    def read(self, k: int, deviation_m: FloatArray) -> FloatArray:
        """(M,) encoder readings at tick k for deviations y (M,) from the nominal motion."""
        z = self.nominal(k) + deviation_m
        return np.asarray(np.round(z / self.count_m) * self.count_m) if self.count_m else z

    def start(self, stage: StageModel, dt_s: float) -> FeedbackLoop:
        """The wall's law in its state before the first tick."""
        wall = self.walls[0].wall
        approach = np.array([wall.approach_m_s for wall in self.walls])
        first = self.read(0, np.zeros(approach.size))
        return FeedbackLoop(wall, stage.amplifier, dt_s, first, approach)


@dataclass(frozen=True)
class Period:
    """One servo period as one map, its two segments in sequence, for n states and m motors.

    The commands that act in a period, (1 + late) m, are those of its first and of its second segment if they differ.

    Attributes
    ----------
    segments : the two segments.
    played : from the commands that act to the states x_k at the starts of the periods, followed by the commands of
        both segments (n + 2 m outputs).
    accelerating : from the commands that act to y'' (p) at the start of the arriving segment.
    to_middle : (n, n + 2 m) map of the outputs of `played` to the states at the start of the second segment.
    to_samples : (R, n + 2 m, K) map of them to the K samples of a period, for every row of the flow.
    late : ticks by which the second segment's command was issued after the first's.
    arriving : index of the segment in which a tick's own command begins to act.
    periods : number of simulated periods, until `after_s` after tau_N.
    instants : number of switching instants in window and tail.
    """

    segments: list[Segment]
    played: LinearSystem
    accelerating: LinearSystem
    to_middle: FloatArray
    to_samples: FloatArray
    late: int
    arriving: int
    periods: int
    instants: int

    @classmethod
    def of(cls, flow: Flow, grid: TimeGrid, halvings: int) -> "Period":
        """A period integrated with a Runge-Kutta step that is halved so many times."""
        segments = _segments(flow, grid, halvings)
        first, second = segments
        (n, m), late = flow.B.shape, first.behind - second.behind
        by_command, acting = np.zeros((n, (1 + late) * m)), np.zeros((n + 2 * m, (1 + late) * m))
        by_command[:, :m] += second.P[-1] @ first.Q[-1]
        by_command[:, late * m :] += second.Q[-1]
        acting[n : n + m, :m] = acting[n + m :, late * m :] = np.eye(m)
        to_middle = np.hstack([first.P[-1], first.Q[-1], np.zeros((n, m))])
        to_samples = _to_samples(flow, segments, to_middle)
        # If the delay is a whole number of periods, a command begins to act at a tick, else within the period.
        arriving = 0 if late == 0 else 1
        arrives = to_samples[: flow.tracked, :, arriving * first.offsets_s.size]
        over_period = second.P[-1] @ first.P[-1]
        return cls(
            segments,
            LinearSystem(over_period, by_command, np.eye(n + 2 * m, n), acting),
            LinearSystem(over_period, by_command, arrives[:, :n], arrives @ acting),
            to_middle,
            to_samples,
            late,
            arriving,
            periods=grid.stages + first.behind + int(np.ceil(after_s(grid) / grid.dt_s)),
            instants=grid.stages + grid.after_stages,
        )

    @property
    def at_switching(self) -> slice:
        """The periods whose arriving segments start at the switching instants of window and tail."""
        behind = self.segments[self.arriving].behind
        return slice(behind, behind + self.instants)

    def issued(self, commands: FloatArray) -> FloatArray:
        """(M, m, periods + late or more) commands (M, m, N) with zeros before the first and after the last."""
        behind = self.segments[0].behind
        found = np.zeros((*commands.shape[:2], behind + self.periods))
        found[..., behind : behind + commands.shape[2]] = commands
        return found


def _to_samples(flow: Flow, segments: list[Segment], to_middle: FloatArray) -> FloatArray:
    """`Period.to_samples`: each segment's samples follow from the states at its start and the command that acts."""
    n, m = flow.B.shape
    found = []
    for j, (segment, started) in enumerate(zip(segments, (np.eye(*to_middle.shape), to_middle), strict=True)):
        by_start = np.einsum("on,snm->oms", flow.rows, segment.P @ started)
        by_start[:, n + j * m : n + (j + 1) * m] += (
            np.einsum("on,snm->oms", flow.rows, segment.Q) + flow.direct[..., None]
        )
        found.append(by_start)
    return np.concatenate(found, axis=2)


def lone(values: FloatArray) -> FloatArray:
    """(M, N) from (M, 1, N): the axis of directions or motors is left out if there is one only."""
    return values[:, 0] if values.shape[1] == 1 else values


@dataclass(frozen=True)
class Course:
    """M taps from the first tick until `after_s` after tau_N.

    Attributes
    ----------
    period : the map of every period.
    acting : (M, (1 + late) m, periods) commands that act in every period.
    command : (M, N), or (M, m, N) with m motors: issued commands.
    """

    period: Period
    acting: FloatArray
    command: FloatArray

    def of(self, taps: slice) -> "Course":
        """The course of some of the taps."""
        found = Course(self.period, self.acting[taps], self.command[taps])
        vars(found)["accelerations"] = self.accelerations[taps]
        return found

    @cached_property
    def given(self) -> FloatArray:
        """(M, n + 2 m, periods) states at the start of every period, and the commands of its two segments."""
        return self.period.played.outputs(self.acting)

    @cached_property
    def accelerations(self) -> FloatArray:
        """(M, instants), or (M, p, instants): y'' just after the switching instants of window and tail."""
        return lone(self.period.accelerating.outputs(self.acting)[..., self.period.at_switching])

    def sampled(self, rows: slice, first: int = 0) -> FloatArray:
        """(M, K), or (M, r, K) of r rows of the flow: their values at all samples of the periods from `first` on."""
        given = np.swapaxes(self.given[..., first:], 1, 2)
        found = [(given @ to_samples).reshape(len(given), -1) for to_samples in self.period.to_samples[rows]]
        return found[0] if len(found) == 1 else np.stack(found, axis=1)

    def rounding(self, flow: Flow) -> FloatArray:
        """(M,) rounding error of y'' there: `ROUNDING` times the largest sum of the absolute values of its terms."""
        period, given, (n, m), p = self.period, self.given[..., self.period.at_switching], flow.B.shape, flow.tracked
        states = period.to_middle @ given if period.arriving else given[:, :n]
        felt = given[:, n + period.arriving * m :][:, :m]
        terms = np.abs(flow.rows[:p]) @ np.abs(states) + np.abs(flow.direct[:p]) @ np.abs(felt)
        return np.asarray(ROUNDING * terms.max(axis=(1, 2)))


def _play(
    stage: StageModel, flow: Flow, grid: TimeGrid, commands: FloatArray, period: Period, loop: Loop | None
) -> Course:
    """The course of M taps under the commands (M, N), or (M, m, N) [A]; `loop` adds the wall's feedback."""
    M, N = len(commands), commands.shape[-1]
    behind, periods, late = period.segments[0].behind, period.periods, period.late
    # Before the first command and after the waveform the command is zero, or the wall's feedback.
    issued = period.issued(commands.reshape(M, -1, N))
    if loop is not None:
        x, step, only = np.zeros((M, flow.A.shape[0])), period.played, issued[:, 0]
        feedback = loop.start(stage, grid.dt_s)
        for k in range(periods):
            only[:, behind + k] += feedback.step(loop.read(k, x @ flow.encoder))
            x = x @ step.A.T + only[:, k : k + 1 + late] @ step.B.T
        commands = only[:, behind : behind + N]
    acting = np.concatenate([issued[..., by : by + periods] for by in range(1 + late)], axis=1)
    return Course(period, acting, commands)


def after_s(grid: TimeGrid) -> float:
    """Simulated time after the waveform: at least `AFTER_S`, and the problem's whole tail."""
    return max(AFTER_S, grid.after_stages * grid.dt_s)


def fine(course: Course, flow: Flow, grid: TimeGrid, *, moving: bool = True) -> Trajectory:
    """All samples of a course: `SAMPLES_PER_PERIOD` per period, and the start of each segment.

    Parameters
    ----------
    moving : whether the motion is requested: y'', the velocity of the motor mass and the further outputs.
    """
    period, (n, m), p = course.period, flow.B.shape, flow.tracked
    samples, M, periods = period.segments[0].offsets_s.size, len(course.acting), period.periods
    acting = course.given[:, n:].reshape(M, 2, m, periods).transpose(0, 2, 3, 1)
    starts, ticks = samples * np.arange(2 * periods), grid.dt_s * np.arange(periods) - grid.lead_s
    offsets = np.concatenate([segment.offsets_s for segment in period.segments])
    nothing, outputs = np.empty((M, m, 0)), dict[str, FloatArray]()
    with np.errstate(over="ignore", invalid="ignore"):  # the loop of an unstable wall overflows
        if moving:
            further = enumerate(flow.names, p + 2 * m)
            outputs = {name: course.sampled(slice(row, row + 1)) for row, name in further}
        return Trajectory(
            times_s=(ticks[:, None] + offsets).ravel(),
            acceleration_m_s2=course.sampled(slice(p)) if moving else nothing[:, 0],
            plant_input=course.sampled(slice(p, p + m)),
            felt=lone(np.repeat(acting, samples, axis=3).reshape(M, m, -1)),
            velocity_m_s=course.sampled(slice(p + m, p + 2 * m)) if moving else lone(nothing),
            outputs=outputs,
            at_switching=starts[period.arriving :: 2][period.at_switching][: grid.stages],
            segment_starts=starts,
        )


@dataclass(frozen=True)
class Accurate:
    """M commands played with a sufficiently fine Runge-Kutta step.

    Attributes
    ----------
    flow : the simulated device.
    step_error : (M,) largest difference of y'' from the result with twice the step, relative to its peak.
    course : the taps.
    """

    flow: Flow
    step_error: FloatArray
    course: Course

    @property
    def acceleration_m_s2(self) -> FloatArray:
        """(M, instants), or (M, p, instants): y'' just after the switching instants of window and tail."""
        return self.course.accelerations

    def of(self, taps: slice) -> "Accurate":
        """The replay of some of the commands."""
        return Accurate(self.flow, self.step_error[taps], self.course.of(taps))


def largest(values: FloatArray) -> FloatArray:
    """(M,) largest absolute values of M courses (M, ...)."""
    flat = values.reshape(len(values), -1)
    return np.asarray(np.maximum(flat.max(axis=1, initial=0.0), -flat.min(axis=1, initial=0.0)))


def accurate(stage: StageModel, grid: TimeGrid, commands: FloatArray, loop: Loop | None) -> Accurate:
    """Play commands (M, N), or (M, m, N) [A], halving the step until that changes y'' by at most `STEP_ERROR`.

    After `MOST_HALVINGS` the finest course is returned with the `step_error` that remains.

    Parameters
    ----------
    loop : the walls whose feedback is added to the commands; None without a wall.
    """
    flow = stage.kept(Flow, (), None, lambda: Flow.of(stage))

    def played(halvings: int) -> Course:
        period = stage.kept((Period, halvings), (), grid, lambda: Period.of(flow, grid, halvings))
        return _play(stage, flow, grid, commands, period, loop)

    coarse = played(0).accelerations
    for halvings in range(1, MOST_HALVINGS + 1):
        course = played(halvings)
        found = course.accelerations
        difference, peak = largest(found - coarse), largest(found)
        step_error = difference / peak_scale(peak, 0.0)
        if not np.all(step_error <= STEP_ERROR):
            step_error = difference / peak_scale(peak, course.rounding(flow))
        coarse = found
        if np.all(step_error <= STEP_ERROR):
            break
    return Accurate(flow, step_error, course)
