"""Continuous-time simulation of a device under held commands, for the replay only.

The replay checks the design by independent means, so it shares only the plant's matrices with the design model
(`transopt.plant.discretise`). On its time axis commands are issued at t_k and act a delay later. The integrator is an
implicit Runge-Kutta method with a finer step, where the design uses a matrix exponential. Under held commands a
Runge-Kutta step is a linear map, the same in every period.
"""

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from transopt.base.recursions import LinearSystem
from transopt.base.signals import FloatArray
from transopt.plant.amplifier import Amplifier
from transopt.plant.discretise import StageModel, split_delay
from transopt.plant.time_grid import TimeGrid
from transopt.plant.wall import FeedbackLoop, HandOver
from transopt.proof.flow import Flow

SAMPLES_PER_PERIOD = 8  # samples of the trajectory per servo period
STEP_RADIUS = 0.5  # largest |eigenvalue| times step at the start; an unresolved stiff mode would be damped out
STEP_ERROR = 1e-10  # wanted relative difference between results with a step and with half of it
MOST_HALVINGS = 6
AFTER_S = 20e-3  # least simulated time after the waveform
MOST_KEPT = 8  # systems of a period, two for the limits of an entry on each device
SMALLEST = float(np.finfo(float).tiny)
AGREEMENT = 1e-6  # largest accepted difference between replay and prediction, relative to the peak
# If link and current forces cancel at the switching instants (a mass on a link that decays within one tick), y'' is
# the rounding error of C x and D i. Differences up to this share of the two are not significant.
ROUNDING = 16 * float(np.finfo(float).eps)


def peak_scale(peak_m_s2: FloatArray, rounding_m_s2: FloatArray | float) -> FloatArray:
    """The peak, as reference for relative differences; raised where `AGREEMENT` of it is below rounding errors."""
    return np.maximum(np.maximum(peak_m_s2, rounding_m_s2 / AGREEMENT), SMALLEST)


def _radau(stages: int) -> tuple[FloatArray, FloatArray]:
    """Butcher matrix (s, s) and weights (s,) of Radau IIA: order 2 s - 1, L-stable, last node at 1.

    Nodes as in Hairer & Wanner, Solving Ordinary Differential Equations II, Sec. IV.5.
    """
    # Roots of the difference of two Legendre polynomials, P_s - P_(s-1): real, but from numpy 2.5 on of complex type.
    nodes = (np.polynomial.legendre.legroots([0.0] * (stages - 1) + [-1.0, 1.0]).real + 1) / 2
    powers = np.arange(stages)
    integrals = nodes[:, None] ** (powers + 1) / (powers + 1)
    butcher = integrals @ np.linalg.inv(nodes[:, None] ** powers)
    return butcher, butcher[-1]


_BUTCHER, _WEIGHTS = _radau(5)


def _step_maps(A: FloatArray, B: FloatArray, h_s: FloatArray) -> FloatArray:
    """(J, n + m, n + m) Radau steps of these lengths of dx/dt = A x + B u with u held, as maps of x and u."""
    (n, m), s = B.shape, _WEIGHTS.size
    stages = np.einsum("ij,kl->ikjl", _BUTCHER, A).reshape(s * n, s * n)
    slopes = np.linalg.solve(np.eye(s * n) - h_s[:, None, None] * stages, np.tile(np.hstack([A, B]), (s, 1)))
    found = np.tile(np.eye(n + m), (h_s.size, 1, 1))
    found[:, :n] += h_s[:, None, None] * np.einsum("s,jsnm->jnm", _WEIGHTS, slopes.reshape(-1, s, n, n + m))
    return found


@dataclass(frozen=True)
class Segment:
    """The part of a servo period in which one command c (m,) acts, with maps from its start to each sample.

    Attributes
    ----------
    behind : number of ticks by which c was issued before the period's own command.
    offsets_s : (S,) times of the samples from the start of the period, the segment's start first.
    maps : (S, n + m, n + m) from states and command (x_0, c) to those at each sample.
    """

    behind: int
    offsets_s: FloatArray
    maps: FloatArray


def _segments(flow: Flow, grid: TimeGrid, halvings: int) -> list[Segment]:
    """The two segments of a period [t_k, t_(k+1)): the earlier command acts until the delay's fraction has passed.

    Each sample is reached by as many Radau steps as the stiffest mode needs.
    """
    (whole, late), dt = split_delay(grid.delay_s, grid.dt_s), grid.dt_s
    # Two halves without such a fraction too, so that a period always has the same number of samples.
    parted = late > 1e-9 * dt
    ends, behind = np.array([0.0, late if parted else dt / 2, dt]), (whole + parted, whole)
    samples = SAMPLES_PER_PERIOD // 2
    spacing = np.diff(ends) / samples
    doublings = halvings + np.ceil(np.log2(np.maximum(flow.fastest_rad_s * spacing / STEP_RADIUS, 1.0)))
    between = _step_maps(flow.A, flow.B, spacing / 2**doublings)
    for doubled in range(int(doublings.max())):
        between = np.where((doubled < doublings)[:, None, None], between @ between, between)
    maps = [np.broadcast_to(np.eye(between.shape[-1]), between.shape)]
    for _ in range(samples):
        maps.append(between @ maps[-1])
    return [
        Segment(behind[j], np.linspace(ends[j], ends[j + 1], samples + 1), of)
        for j, of in enumerate(np.stack(maps, axis=1))
    ]


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

    def close(self, period: "Period", amplifier: Amplifier | None, commands: FloatArray) -> None:
        """Add the feedback to the commands (M, behind + periods) of a period's segments, in place."""
        dt_s, z = period.grid.dt_s, np.stack([each.nominal_m for each in self.walls])[:, : period.periods]
        approach = np.array([each.approach_m_s for each in self.walls])
        # After the last known tick the nominal motion goes on at constant speed; before the first one it approaches.
        beyond = np.arange(1, period.periods - z.shape[1] + 1)
        known = np.hstack([z[:, :1] + dt_s * approach[:, None], z])
        nominal = np.hstack([z, z[:, -1:] + beyond * (known[:, -1:] - known[:, -2:-1])])
        first = np.round(z[:, 0] / self.count_m) * self.count_m if self.count_m else z[:, 0]
        A, B = period.step
        encoder = np.append(np.zeros(B.shape[1]), period.flow.encoder)
        law = FeedbackLoop(self.walls[0].wall, amplifier, dt_s, first, approach)
        law.close((A, B, encoder), nominal, commands, count_m=self.count_m)


@dataclass(frozen=True)
class Period:
    """One servo period as one map, its two segments in sequence, for n states and m motors.

    The commands that act in a period, (1 + late) m, are those of its first and of its second segment if they differ.
    Rows over the states at its start and the commands of both segments are (n + 2 m).

    Attributes
    ----------
    segments : the two segments, integrated with the same number of steps.
    """

    flow: Flow
    grid: TimeGrid
    segments: list[Segment]
    _kept: dict[tuple[object, ...], LinearSystem] = field(default_factory=dict, init=False, repr=False, compare=False)

    @property
    def late(self) -> int:
        """Ticks by which the second segment's command was issued after the first's."""
        return self.segments[0].behind - self.segments[1].behind

    @property
    def arriving(self) -> int:
        """Index of the segment in which a tick's own command begins to act.

        If the delay is a whole number of periods, it begins to act at a tick, else within the period.
        """
        return 0 if self.late == 0 else 1

    @property
    def periods(self) -> int:
        """Number of simulated periods, until `after_s` after tau_N."""
        return self.grid.stages + self.segments[0].behind + int(np.ceil(after_s(self.grid) / self.grid.dt_s))

    @cached_property
    def _acting(self) -> FloatArray:
        """(2 m, (1 + late) m) map of the commands that act to those of both segments."""
        m, late = self.flow.B.shape[1], self.late
        found = np.zeros((2 * m, (1 + late) * m))
        found[:m, :m] = found[m:, late * m :] = np.eye(m)
        return found

    @cached_property
    def _starts(self) -> tuple[FloatArray, FloatArray]:
        """(n + m, n + 2 m) rows of the states at the start of each segment, and of the command that acts in it."""
        n, m = self.flow.B.shape
        first, second = (np.eye(n + m, n + 2 * m), np.eye(n + m, n + 2 * m, m))
        second[:n] = self.segments[0].maps[-1, :n] @ first
        return first, second

    @cached_property
    def _rows(self) -> FloatArray:
        """(R + m, n + m) every row of the flow, and the commands, over states and the command that acts."""
        n, m = self.flow.B.shape
        return np.block([[self.flow.rows, self.flow.direct], [np.zeros((m, n)), np.eye(m)]])

    @cached_property
    def step(self) -> tuple[FloatArray, FloatArray]:
        """A (n, n) and B (n, (1 + late) m) from the start of a period to that of the next."""
        n = self.flow.B.shape[0]
        over = self.segments[1].maps[-1, :n] @ self._starts[1]
        return over[:, :n], over[:, n:] @ self._acting

    def _system(self, rows: FloatArray) -> LinearSystem:
        """From the commands that act to rows (r, n + 2 m)."""
        n = self.flow.B.shape[0]
        return LinearSystem(*self.step, rows[:, :n], rows[:, n:] @ self._acting)

    @cached_property
    def starting(self) -> LinearSystem:
        """From commands that act to y'' (p) at the start of the arriving segment, and inputs (2 m) of both."""
        p, m = self.flow.tracked, self.flow.B.shape[1]
        inputs = [self._rows[p : p + m] @ start for start in self._starts]
        return self._system(np.concatenate([self._rows[:p] @ self._starts[self.arriving], *inputs]))

    @cached_property
    def terms(self) -> LinearSystem:
        """From commands that act to the terms of y'' there, for each direction one of every state and motor."""
        starts = self._starts[self.arriving]
        return self._system(np.concatenate([row[:, None] * starts for row in self._rows[: self.flow.tracked]]))

    @cached_property
    def to_samples(self) -> FloatArray:
        """(R + m, n + 2 m, K) rows of the flow and of the commands that act, at the K samples of a period."""
        parts = [self._rows @ of.maps @ start for of, start in zip(self.segments, self._starts, strict=True)]
        return np.concatenate(parts).transpose(1, 2, 0)

    @cached_property
    def lengths_s(self) -> FloatArray:
        """(S,) lengths of the segments that begin before tau_N, in turn."""
        grid, offsets_s = self.grid, [segment.offsets_s[0] for segment in self.segments]
        starts_s = np.add.outer(grid.dt_s * np.arange(self.periods) - grid.lead_s, offsets_s).ravel()
        playing = int(np.searchsorted(starts_s, grid.end_s - 1e-9 * grid.dt_s))
        return np.diff(starts_s[: playing + 1])

    @cached_property
    def bounds(self) -> tuple[int, int, int]:
        """Numbers of samples before tau_0, up to the one just after tau_(N-1), and up to tau_N."""
        grid, offsets_s = self.grid, np.concatenate([each.offsets_s for each in self.segments])
        times_s = np.add.outer(grid.dt_s * np.arange(self.periods) - grid.lead_s, offsets_s).ravel()
        begins = int(np.searchsorted(times_s, grid.switching_times_s[0], side="left"))
        ends = int(np.searchsorted(times_s, grid.end_s, side="right"))
        last = 2 * (self.at_switching.start + grid.stages - 1) + self.arriving  # segment that begins at tau_(N-1)
        return begins, last * self.segments[0].offsets_s.size + 1, ends

    @cached_property
    def parts(self) -> list[tuple[slice, list[tuple[int, slice]]]]:
        """Ranges of like periods, in turn, with each part (see `bounds`) and its samples of such a period."""
        K, found = self.to_samples.shape[2], []
        cuts = {0, self.periods, *(min(cut, self.periods) for at in self.bounds for cut in (at // K, -(-at // K)))}
        for first, last in itertools.pairwise(sorted(cuts)):
            part = np.searchsorted(self.bounds, first * K + np.arange(K), side="right").tolist()
            ends = {each: slice(part.index(each), part.index(each) + part.count(each)) for each in part}
            found.append((slice(first, last), [*ends.items()]))
        return found

    @property
    def at_switching(self) -> slice:
        """The periods whose arriving segments start at the switching instants of window and tail."""
        behind = self.segments[self.arriving].behind
        return slice(behind, behind + self.grid.stages + self.grid.after_stages)

    def issued(self, commands: FloatArray) -> FloatArray:
        """(M, m, periods + late or more) commands (M, m, N) with zeros before the first and after the last."""
        behind = self.segments[0].behind
        found = np.zeros((*commands.shape[:2], behind + self.periods))
        found[..., behind : behind + commands.shape[2]] = commands
        return found

    def sampled(self, rows: FloatArray, offset: Sequence[int] = ()) -> LinearSystem:
        """From the commands that act, and offsets by `at_knots`, to values at the K samples of a period, r K outputs.

        The latest are kept, as the taps of a scene bound the same rows.

        Parameters
        ----------
        rows : (r, R + m) weights of the rows of the flow and of the commands that act.
        offset : rows to whose values an offset is added, in the order in which their offsets follow the commands.
        """
        key = rows.tobytes(), *offset
        if (found := self._kept.get(key)) is not None:
            return found
        n, K, acting = self.flow.A.shape[0], self.to_samples.shape[2], self._acting.shape[1]
        values = np.tensordot(rows, self.to_samples, 1).swapaxes(1, 2)
        direct = np.zeros((len(rows), K, acting + 3 * len(offset)))
        direct[..., :acting] = values[..., n:] @ self._acting
        for number, row in enumerate(offset):
            at = acting + 3 * number
            direct[row, :, at : at + 3] = self._hats
        A, B = self.step
        by_inputs = np.hstack([B, np.zeros((n, direct.shape[-1] - acting))])
        if len(self._kept) >= MOST_KEPT:
            self._kept.clear()
        found = LinearSystem(A, by_inputs, values[..., :n].reshape(-1, n), direct.reshape(len(rows) * K, -1))
        return self._kept.setdefault(key, found)

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
    step_error : (M,) largest difference of y'' from the result with twice the step, relative to its peak.
    """

    period: Period
    acting: FloatArray
    command: FloatArray
    step_error: FloatArray

    def of(self, taps: slice) -> "Course":
        """The course of some of the taps."""
        found = Course(self.period, self.acting[taps], self.command[taps], self.step_error[taps])
        vars(found)["starting"] = self.starting[taps]
        return found

    @cached_property
    def starting(self) -> FloatArray:
        """(M, p + 2 m, periods) outputs of `Period.starting`."""
        return self.period.starting.outputs(self.acting)

    @cached_property
    def accelerations(self) -> FloatArray:
        """(M, instants), or (M, p, instants): y'' just after the switching instants of window and tail."""
        # A copy, which does not keep the other outputs in memory.
        return lone(self.starting[:, : self.period.flow.tracked, self.period.at_switching].copy())

    @property
    def inputs(self) -> FloatArray:
        """(M, 2, m, periods) plant's inputs at the starts of the two segments of each period."""
        M, (p, m) = len(self.starting), (self.period.flow.tracked, self.period.flow.B.shape[1])
        return self.starting[:, p:].reshape(M, 2, m, -1)

    @cached_property
    def rounding(self) -> FloatArray:
        """(M,) rounding error of y'' there: `ROUNDING` times the largest sum of the absolute values of its terms."""
        period, acting = self.period, self.acting[..., : self.period.at_switching.stop]
        return np.asarray(ROUNDING * period.terms.largest(acting, terms=sum(period.flow.B.shape))[0].max(axis=1))

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
        period, M, K = self.period, len(self.acting), self.period.to_samples.shape[2]
        inputs = np.concatenate([self.acting, *map(period.at_knots, offsets.values())], axis=1)
        early, late = (period.sampled(of, [*offsets]) for of in (rows, np.vstack([rows, after])))
        found, states = np.zeros((M, len(rows) + len(after), 4)), np.zeros((M, period.flow.A.shape[0]))
        for at, parts in period.parts:
            system = late if parts[-1][0] == len(period.bounds) else early
            values, states = system.largest(inputs[..., at], states)
            values = values.reshape(M, -1, K)
            for each, samples in parts:
                kept = found[:, : values.shape[1], each]
                np.maximum(kept, values[..., samples].max(axis=2), out=kept)
        return found[:, : len(rows)], found[:, len(rows) :, -1]


def _play(stage: StageModel, commands: FloatArray, period: Period, loop: Loop | None) -> Course:
    """The course of M taps under the commands (M, N), or (M, m, N) [A]; `loop` adds the wall's feedback."""
    M, N = len(commands), commands.shape[-1]
    behind, periods, late = period.segments[0].behind, period.periods, period.late
    # Before the first command and after the waveform the command is zero, or the wall's feedback.
    issued = period.issued(commands.reshape(M, -1, N))
    if loop is not None:
        loop.close(period, stage.amplifier, issued[:, 0])
        commands = issued[:, 0, behind : behind + N]
    acting = np.concatenate([issued[..., by : by + periods] for by in range(1 + late)], axis=1)
    return Course(period, acting, commands, np.full(M, np.nan))


def after_s(grid: TimeGrid) -> float:
    """Simulated time after the waveform: at least `AFTER_S`, and the problem's whole tail."""
    return max(AFTER_S, grid.after_stages * grid.dt_s)


def largest(values: FloatArray) -> FloatArray:
    """(M,) largest absolute values of M courses (M, ...)."""
    flat = values.reshape(len(values), -1)
    return np.asarray(np.maximum(flat.max(axis=1, initial=0.0), -flat.min(axis=1, initial=0.0)))


def accurate(stage: StageModel, grid: TimeGrid, commands: FloatArray, loop: Loop | None) -> Course:
    """Play commands (M, N), or (M, m, N) [A], halving the step until that changes y'' by at most `STEP_ERROR`.

    After `MOST_HALVINGS` the finest course is returned with the `step_error` that remains.

    Parameters
    ----------
    loop : the walls whose feedback is added to the commands; None without a wall.
    """
    flow = stage.kept(Flow, (), None, lambda: Flow.of(stage))

    def period(halvings: int) -> Period:
        key = Period, halvings
        return stage.kept(key, (), grid, lambda: Period(flow, grid, _segments(flow, grid, halvings)))

    course = _play(stage, commands, period(0), loop)
    for halvings in range(1, MOST_HALVINGS + 1):
        coarse, finer = course.accelerations, period(halvings)
        # Without a wall the same commands act, whatever the step.
        course = replace(course, period=finer) if loop is None else _play(stage, commands, finer, loop)
        found = course.accelerations
        difference, peak = largest(found - coarse), largest(found)
        course.step_error[:] = difference / peak_scale(peak, 0.0)
        if not np.all(course.step_error <= STEP_ERROR):
            course.step_error[:] = difference / peak_scale(peak, course.rounding)
        if np.all(course.step_error <= STEP_ERROR):
            break
    return course
