"""Continuous-time simulation of a device under held commands, for the replay only.

The replay checks the design by independent means, so it shares only the plant's matrices with the design model
(`transopt.plant.discretise`). On its time axis commands are issued at t_k and act a delay later. The integrator is an
implicit Runge-Kutta method with a finer step, where the design uses a matrix exponential. Under held commands a
Runge-Kutta step is a linear map, the same in every period.
"""

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

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
    starting : from the commands that act to y'' (p) at the start of the arriving segment and the plant's inputs (2 m)
        at the starts of both.
    terms : from them to the terms of y'' there, each of the p with one for every state and for every motor.
    to_samples : (R + m, n + 2 m, K) map of the states at the start of a period and the commands of its segments to
        the K samples of the period, for every row of the flow and for every command that acts.
    acting : (2 m, (1 + late) m) map of the commands that act to those of both segments.
    late : ticks by which the second segment's command was issued after the first's.
    arriving : index of the segment in which a tick's own command begins to act.
    periods : number of simulated periods, until `after_s` after tau_N.
    instants : number of switching instants in window and tail.
    bounds : numbers of samples before tau_0, up to the one just after tau_(N-1), and up to tau_N.
    """

    segments: list[Segment]
    starting: LinearSystem
    terms: LinearSystem
    to_samples: FloatArray
    acting: FloatArray
    late: int
    arriving: int
    periods: int
    instants: int
    bounds: tuple[int, int, int]

    @classmethod
    def of(cls, flow: Flow, grid: TimeGrid, halvings: int) -> "Period":
        """A period integrated with a Runge-Kutta step that is halved so many times."""
        segments = _segments(flow, grid, halvings)
        first, second = segments
        (n, m), p, late = flow.B.shape, flow.tracked, first.behind - second.behind
        by_command, acting = np.zeros((n, (1 + late) * m)), np.zeros((2 * m, (1 + late) * m))
        by_command[:, :m] += second.P[-1] @ first.Q[-1]
        by_command[:, late * m :] += second.Q[-1]
        acting[:m, :m] = acting[m:, late * m :] = np.eye(m)
        to_middle = np.hstack([first.P[-1], first.Q[-1], np.zeros((n, m))])
        to_samples = _to_samples(flow, segments, to_middle)
        # If the delay is a whole number of periods, a command begins to act at a tick, else within the period.
        arriving, halves = 0 if late == 0 else 1, (0, first.offsets_s.size)
        starts = [(slice(p), halves[arriving]), *((slice(p, p + m), half) for half in halves)]
        rows = np.concatenate([to_samples[of, :, sample] for of, sample in starts])
        arrived = to_middle if arriving else np.eye(n, n + 2 * m)
        felt = np.eye(m, 2 * m, arriving * m)
        parts = [
            np.concatenate([row[:, None] * arrived, by[:, None] * np.hstack([np.zeros((m, n)), felt])])
            for row, by in zip(flow.rows[:p], flow.direct[:p], strict=True)
        ]
        terms, over_period = np.concatenate(parts), second.P[-1] @ first.P[-1]
        periods = grid.stages + first.behind + int(np.ceil(after_s(grid) / grid.dt_s))
        times_s = np.add.outer(
            grid.dt_s * np.arange(periods) - grid.lead_s, np.concatenate([each.offsets_s for each in segments])
        ).ravel()
        last = 2 * (segments[arriving].behind + grid.stages - 1) + arriving  # segment that begins at tau_(N-1)
        begins = int(np.searchsorted(times_s, grid.switching_times_s[0], side="left"))
        ends = int(np.searchsorted(times_s, grid.end_s, side="right"))
        return cls(
            segments,
            LinearSystem(over_period, by_command, rows[:, :n], rows[:, n:] @ acting),
            LinearSystem(over_period, by_command, terms[:, :n], terms[:, n:] @ acting),
            to_samples,
            acting,
            late,
            arriving,
            periods,
            instants=grid.stages + grid.after_stages,
            bounds=(begins, last * first.offsets_s.size + 1, ends),
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

    def sampled(self, rows: FloatArray, offset: Sequence[int] = ()) -> LinearSystem:
        """From the commands that act, and offsets by `at_knots`, to values at the K samples of a period, r K outputs.

        Parameters
        ----------
        rows : (r, R + m) weights of the rows of the flow and of the commands that act.
        offset : rows to whose values an offset is added, in the order in which their offsets follow the commands.
        """
        n, K = self.starting.A.shape[0], self.to_samples.shape[2]
        values = np.einsum("ro,ozk->rkz", rows, self.to_samples)
        direct = np.zeros((len(rows), K, self.acting.shape[1] + 3 * len(offset)))
        direct[..., : self.acting.shape[1]] = values[..., n:] @ self.acting
        for number, row in enumerate(offset):
            at = self.acting.shape[1] + 3 * number
            direct[row, :, at : at + 3] = self._hats
        by_inputs = np.zeros((n, direct.shape[-1]))
        by_inputs[:, : self.acting.shape[1]] = self.starting.B
        by_states = values[..., :n].reshape(-1, n)
        return LinearSystem(self.starting.A, by_inputs, by_states, direct.reshape(len(by_states), -1))

    @property
    def _hats(self) -> FloatArray:
        """(K, 3) weights of `at_knots` at the samples of a period: linear from one switching instant to the next."""
        times, dt_s = np.concatenate([each.offsets_s for each in self.segments]), self.segments[1].offsets_s[-1]
        along = (times - self.segments[self.arriving].offsets_s[0]) / dt_s
        return np.stack([np.maximum(-along, 0.0), 1 - np.abs(along), np.maximum(along, 0.0)], axis=1)

    def at_knots(self, course: FloatArray) -> FloatArray:
        """(M, 3, periods) values at the switching instants before, in and after each period of (M, up to N + 1)."""
        knots = np.arange(-1, 2)[:, None] + np.arange(self.periods) - self.at_switching.start
        return np.asarray(course[:, np.clip(knots, 0, course.shape[1] - 1)])


def _to_samples(flow: Flow, segments: list[Segment], to_middle: FloatArray) -> FloatArray:
    """`Period.to_samples`: each segment's samples follow from the states at its start and the command that acts."""
    n, m = flow.B.shape
    rows, direct = np.vstack([flow.rows, np.zeros((m, n))]), np.vstack([flow.direct, np.eye(m)])
    found = []
    for j, (segment, started) in enumerate(zip(segments, (np.eye(*to_middle.shape), to_middle), strict=True)):
        by_start = np.einsum("on,snm->oms", rows, segment.P @ started)
        by_start[:, n + j * m : n + (j + 1) * m] += np.einsum("on,snm->oms", rows, segment.Q) + direct[..., None]
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

    def of(self, taps: slice | list[int]) -> "Course":
        """The course of some of the taps."""
        found = Course(self.period, self.acting[taps], self.command[taps])
        vars(found)["starting"] = self.starting[taps]
        return found

    @cached_property
    def starting(self) -> FloatArray:
        """(M, p + 2 m, periods) outputs of `Period.starting`."""
        return self.period.starting.outputs(self.acting)

    @cached_property
    def accelerations(self) -> FloatArray:
        """(M, instants), or (M, p, instants): y'' just after the switching instants of window and tail."""
        directions = self.starting.shape[1] - self.period.acting.shape[0]
        return lone(self.starting[:, :directions, self.period.at_switching])

    def inputs(self, arriving: int) -> FloatArray:
        """(M, m, periods) plant's inputs at the start of each period's first, 0, or second segment."""
        motors = self.period.acting.shape[0] // 2
        return self.starting[:, -2 * motors :][:, arriving * motors :][:, :motors]

    def rounding(self, flow: Flow) -> FloatArray:
        """(M,) rounding error of y'' there: `ROUNDING` times the largest sum of the absolute values of its terms."""
        acting = self.acting[..., : self.period.at_switching.stop]
        return np.asarray(ROUNDING * self.period.terms.largest(acting, terms=sum(flow.B.shape))[0].max(axis=1))

    def reached(
        self, rows: FloatArray, offsets: Mapping[int, FloatArray], after: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Largest absolute values at all samples of the parts of a course that `Period.bounds` separate.

        Parameters
        ----------
        rows : (r, R + m) values, see `Period.sampled`. offsets : row -> (M, up to N + 1) part of its value, linear
            from one switching instant to the next, constant before the first and after the last.
        after : (a, R + m) further values that are wanted after tau_N only.

        Returns
        -------
        (M, r, 4) and (M, a) largest values; 0 for a part without a sample.
        """
        period, (M, _, periods), K = self.period, self.acting.shape, self.period.to_samples.shape[2]
        inputs = np.concatenate([self.acting, *map(period.at_knots, offsets.values())], axis=1)
        early, late = (period.sampled(of, [*offsets]) for of in (rows, np.vstack([rows, after])))
        cuts = {0, periods, *(min(-(-bound // K), periods) for bound in period.bounds)}
        cuts |= {min(bound // K, periods) for bound in period.bounds}
        found, states = np.zeros((M, len(rows) + len(after), 4)), np.zeros((M, period.starting.A.shape[0]))
        for first, last in itertools.pairwise(sorted(cuts)):
            # Either one period or several between two bounds, whose samples all belong to the same part.
            part = np.searchsorted(period.bounds, first * K + np.arange(K), side="right")
            system = late if part[-1] == len(period.bounds) else early
            values, states = system.largest(inputs[..., first:last], states)
            values = values.reshape(M, -1, K)
            for each in set(part.tolist()):
                kept = found[:, : values.shape[1], each]
                np.maximum(kept, values[..., part == each].max(axis=2), out=kept)
        return found[:, : len(rows)], found[:, len(rows) :, -1]


def _play(
    stage: StageModel, flow: Flow, grid: TimeGrid, commands: FloatArray, period: Period, loop: Loop | None
) -> Course:
    """The course of M taps under the commands (M, N), or (M, m, N) [A]; `loop` adds the wall's feedback."""
    M, N = len(commands), commands.shape[-1]
    behind, periods, late = period.segments[0].behind, period.periods, period.late
    # Before the first command and after the waveform the command is zero, or the wall's feedback.
    issued = period.issued(commands.reshape(M, -1, N))
    if loop is not None:
        x, step, only = np.zeros((M, flow.A.shape[0])), period.starting, issued[:, 0]
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
