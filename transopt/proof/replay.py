"""Independent continuous-time replay of commands.

`continuous` simulates them and shares only the plant's matrices with the design model. Every limit is checked at
every fine step.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import NamedTuple

import numpy as np

from transopt.base.shown import brief
from transopt.base.signals import FloatArray
from transopt.base.threads import one_blas_thread
from transopt.plant.amplifier import Amplifier
from transopt.plant.coil import CoilModel, effective_square, following_square_mean
from transopt.plant.discretise import StageModel
from transopt.plant.time_grid import TimeGrid
from transopt.plant.wall import HandOver
from transopt.problem.heat import Budget
from transopt.problem.limits.limit import Limit, Limits, tolerated
from transopt.problem.limits.row import COMMAND, INPUT, VELOCITY, Row
from transopt.problem.limits.temperature import TemperatureLimit
from transopt.problem.objective.figures import Figures, Yardstick
from transopt.problem.objective.target import Target
from transopt.problem.problem import TransientProblem
from transopt.proof.continuous import AGREEMENT, Course, Loop, accurate, largest, lone, peak_scale
from transopt.proof.flow import Flow


class Sampled(NamedTuple):
    """Courses of M replays: (M, instants) y'' in window and tail, (M, N) the plant's inputs and total commands."""

    accelerations_m_s2: FloatArray
    plant_inputs: FloatArray
    commands: FloatArray


class Samples:
    """Courses of M replays, which may be let go: `play` makes them again when they are read."""

    def __init__(self, play: Callable[[], Sampled]) -> None:
        self._play = play

    @cached_property
    def courses(self) -> Sampled:
        return self._play()

    def let_go(self) -> None:
        """Free the courses until they are read again."""
        vars(self).pop("courses", None)


@dataclass(frozen=True)
class Replay:
    """The continuous-time motion under one command.

    With p directions accelerations are (p, N) and (p, M); with m motors inputs and commands are (m, N).

    Attributes
    ----------
    samples, number : the courses of the replays that were played together, and the number of this one among them.
    figures : comparison with the recorded tap.
    peak_input, peak_command : largest absolute values over all t.
    after_peak_m_s2 : largest |y''| after the waveform (`continuous.after_s`).
    reached : name of a limit -> largest absolute value over all t of the quantity it bounds; 0 for a limit that is
        defined at the ticks only. A motor's value counts over its share of the limit.
    reached_while_stated : the same up to the last switching instant, tau_(N-1). Later values follow from the last
        command and, with a wall, from its feedback alone.
    winding_C, housing_C : highest temperatures over the horizon, or for taps that repeat over the periodic steady
        state; NaN without a coil model and for several motors.
    scale_m_s2 : reference for relative differences of y'': its peak, or what its rounding error makes significant.
    step_error : difference of y'' from a replay with half the step, relative to `scale_m_s2`.
    """

    samples: Samples
    number: int
    figures: Figures
    peak_input: float
    peak_command: float
    after_peak_m_s2: float
    reached: Mapping[str, float]
    reached_while_stated: Mapping[str, float]
    winding_C: float
    housing_C: float
    scale_m_s2: float
    step_error: float

    __repr__ = brief

    @property
    def lasting_m_s2(self) -> FloatArray:
        """(N + M,) y'' at the switching instants and at those of the tail."""
        return np.asarray(self.samples.courses.accelerations_m_s2[self.number])

    @property
    def acceleration_m_s2(self) -> FloatArray:
        """(N,) y'' at the switching instants."""
        return self.lasting_m_s2[..., : self.command.shape[-1]]

    @property
    def after_m_s2(self) -> FloatArray:
        """(M,) y'' at the instants of the tail."""
        return self.lasting_m_s2[..., self.command.shape[-1] :]

    @property
    def plant_input(self) -> FloatArray:
        """(N,) plant's input at the switching instants."""
        return np.asarray(self.samples.courses.plant_inputs[self.number])

    @property
    def command(self) -> FloatArray:
        """(N,) the total command that was played; with a wall the transient plus the feedback of the replay."""
        return np.asarray(self.samples.courses.commands[self.number])

    def peak(self, limit: Limit) -> float:
        """Largest absolute value over all t of the quantity a limit bounds; NaN if the replay did not check it."""
        return self.winding_C if limit.name == TemperatureLimit.name else self.reached.get(limit.name, float("nan"))

    def leaves(self, limit: Limit) -> bool:
        """Whether a limit is violated at any time; a NaN violates every limit."""
        return not self.peak(limit) <= limit.stated + limit.replay_tolerance

    def leaves_late(self, limit: Limit) -> bool:
        """Whether a limit is violated only after the last switching instant."""
        early = self.reached_while_stated.get(limit.name, np.inf)
        return limit.after_the_waveform and self.leaves(limit) and early <= limit.stated + limit.replay_tolerance

    def shortfalls(
        self, problem: TransientProblem, command: FloatArray, predicted_m_s2: FloatArray, cause: str = ""
    ) -> list[str]:
        """Reasons not to admit this command (N,), one sentence each; empty if there are none.

        Parameters
        ----------
        cause : why a replay may not converge, and what to change; by default the fastest mode of a linear device.
        """
        found: list[str] = []
        tolerance_A = tolerated(problem.limits.input_limit)
        found.extend(limit.replayed(self.peak(limit)) for limit in problem.limits if self.leaves(limit))
        if not self.step_error <= AGREEMENT:
            fastest_Hz = float(np.abs(np.linalg.eigvals(problem.stage.plant.A)).max()) / (2 * np.pi)
            too_stiff = (
                f"the device's fastest mode, at {fastest_Hz:.2g} Hz, is too stiff for double precision: raise the "
                "smallest mass, or lower the stiffness and the damping that act on it"
            )
            found.append(
                f"replay did not converge: smaller steps change it by {self.step_error:.1e} of its peak; "
                f"{cause or too_stiff}"
            )
        feedback_off = float(np.abs(self.command - command).max())
        if not feedback_off <= tolerance_A:
            found.append(
                f"with the wall's feedback the command differs from the predicted one by {feedback_off:.1e} A"
            )
        difference = self.off(predicted_m_s2)
        if not difference <= AGREEMENT:
            found.append(f"replayed acceleration differs from the predicted one by {difference:.1e} of its peak")
        return found

    def off(self, predicted_m_s2: FloatArray) -> float:
        """Largest difference of y'' (N,) from a predicted one, relative to its peak."""
        return float(np.abs(self.acceleration_m_s2 - predicted_m_s2).max()) / max(self.scale_m_s2, 1e-9)


def replayed_figures(
    stage: StageModel,
    yardstick: Yardstick,
    commands: FloatArray,
    targets: Sequence[Target],
    walls: Sequence[HandOver] = (),
) -> list[Figures]:
    """Figures of M commands (M, N), or (M, m, N), relative to their targets, by the same simulation as `replay`.

    Over walls, one a tap, the commands are transients, to which the simulation adds each wall's feedback.
    """
    loop = Loop(walls, 0.0) if walls else None
    return figures_of(accurate(stage, yardstick.grid, commands, loop), yardstick, targets)


def figures_of(simulated: Course, yardstick: Yardstick, targets: Sequence[Target]) -> list[Figures]:
    """Figures of M simulated commands relative to their targets."""
    with np.errstate(over="ignore", invalid="ignore"):  # the loop of an unstable wall overflows
        return yardstick.figures_of(targets, simulated.accelerations)


@dataclass(frozen=True)
class Played:
    """The part of a problem that limits read to state their rows."""

    devices: tuple[StageModel, ...]
    grid: TimeGrid
    limits: Limits

    @property
    def stage(self) -> StageModel:
        return self.devices[0]


@dataclass(frozen=True)
class _Watched:
    """A row that a limit bounds at all times.

    Attributes
    ----------
    weights : (R + m) its weights in `Period.sampled`.
    moves : length of its offset; 0 where it has none.
    late : whether it is bounded after the waveform too.
    """

    limit: str
    device: int
    weights: tuple[float, ...]
    moves: int
    share: float
    late: bool

    @classmethod
    def of(cls, limit: Limit, row: Row, flow: Flow) -> "_Watched":
        motors, j = flow.B.shape[1], row.motor or 0
        place = {INPUT: flow.tracked + j, VELOCITY: flow.tracked + motors + j, COMMAND: len(flow.rows) + j}
        place |= {name: flow.tracked + 2 * motors + i for i, name in enumerate(flow.names)}
        weights = np.zeros(len(flow.rows) + motors)
        for output, by in row.outputs.items():
            weights[place[output]] += by
        moves = np.size(row.offset) if np.any(row.offset) else 0
        return cls(limit.name, row.device, tuple(weights.tolist()), moves, row.share, limit.after_the_waveform)


def _watched(
    limits: Sequence[Limits], devices: tuple[StageModel, ...], flow: Flow, grid: TimeGrid
) -> dict[_Watched, dict[int, Row]]:
    """The rows that limits bound at all times, each with the row of every command that has it."""
    known, found = dict[object, list[tuple[_Watched, Row]]](), dict[_Watched, dict[int, Row]]()
    for m, of_entry in enumerate(limits):
        for limit in of_entry:
            key = limit if limit.is_hashable else id(limit)
            if key not in known:
                rows = limit.watched(Played(devices, grid, of_entry))
                known[key] = [(_Watched.of(limit, row, flow), row) for row in rows]
            for watched, row in known[key]:
                found.setdefault(watched, {})[m] = row
    return found


def _peaks(
    runs: Sequence[Course], limits: Sequence[Limits], devices: tuple[StageModel, ...], grid: TimeGrid
) -> tuple[dict[str, FloatArray], dict[str, FloatArray], FloatArray, FloatArray]:
    """(M,) largest absolute value that each limit bounds, in all and up to tau_(N-1), by name of the limit.

    After these (M,) largest absolute values of the plant's input and, after tau_N, of y''.

    Parameters
    ----------
    runs : the same commands on the entry's own device and, if a limit depends on them, on those of its spread.
    devices : the devices of `runs`; further ones are not used.
    """
    flow, M = runs[0].period.flow, len(limits)
    (R, _), (_, m), p = flow.rows.shape, flow.B.shape, flow.tracked
    rows, own = _watched(limits, devices, flow, grid), np.eye(R + m)
    whole, early = ({limit.name: np.zeros(M) for of_entry in limits for limit in of_entry} for _ in range(2))
    for number, run in enumerate(runs):
        inputs, after = (own[p : p + m], own[:p]) if number == 0 else (own[:0], own[:0])
        of_device, offsets = [each for each in rows if each.device == number], dict[int, FloatArray]()
        for j, each in enumerate(of_device, start=len(inputs)):
            if each.moves:
                offsets[j] = np.zeros((M, each.moves))
                for tap, row in rows[each].items():
                    offsets[j][tap] = row.offset
        weights = np.array([*inputs, *(each.weights for each in of_device)]).reshape(-1, R + m)
        with np.errstate(over="ignore", invalid="ignore"):  # the loop of an unstable wall overflows
            values, lasting = run.reached(weights, offsets, after)
        if number == 0:
            of_input, of_motion = values[:, :m].max(axis=(1, 2)), lasting.max(axis=1)
        for j, each in enumerate(of_device, start=len(inputs)):
            # One that ends with the waveform has no meaning before it either.
            parts = slice(4) if each.late else slice(1, 3)
            for found, part in ((whole, parts), (early, slice(parts.start, 2))):
                value = values[:, j, part].max(axis=1) / each.share
                found[each.limit] = np.maximum(found[each.limit], value)
    return whole, early, of_input, of_motion


def _temperatures(
    course: Course, amplifier: Amplifier | None, coil: CoilModel, budgets: Sequence[Budget] | None
) -> tuple[FloatArray, FloatArray]:
    """(M,) highest winding and housing temperature each, up to tau_N."""
    period, M, lengths = course.period, len(course.acting), course.period.lengths_s
    playing = lengths.size
    # One step per segment is exact, as the command is constant within it.
    whole = slice((playing + 1) // 2)
    before = course.inputs[:, :, 0, whole].swapaxes(1, 2).reshape(M, -1)[:, :playing]
    if amplifier is None:
        heat = effective_square(before, coil.ripple_A)
    else:
        felt = course.acting[:, [0, period.late], whole].swapaxes(1, 2).reshape(M, -1)[:, :playing]
        heat = following_square_mean(before, felt, amplifier.rate_rad_s * lengths, coil.ripple_A)
    rate_Hz = None if budgets is None else budgets[0].tap_rate_Hz
    if budgets is None or rate_Hz is None:
        winding, housing = coil.simulate(heat, lengths)
    else:
        pause = 1 / rate_Hz - float(lengths.sum())
        idle = np.array([budget.pause_A for budget in budgets])
        winding, housing = coil.steady_course(heat, lengths, pause, idle)
    return winding.max(axis=1), housing.max(axis=1)


@one_blas_thread()
def replay(
    stage: StageModel,
    grid: TimeGrid,
    commands: FloatArray,
    targets: Sequence[Target],
    coil: CoilModel | None,
    *,
    limits: Sequence[Limits] | None = None,
    walls: Sequence[HandOver] | None = None,
    budgets: Sequence[Budget] | None = None,
    count_m: float = 0.0,
    simulated: Course | None = None,
    again: Callable[[], FloatArray] | None = None,
    spread: tuple[StageModel, ...] = (),
    yardstick: Yardstick | None = None,
) -> list[Replay]:
    """Play M commands (M, N), or (M, m, N) of m motors, on one device from rest; compare each with its target.

    The integrator's step resolves the fastest mode and is halved until the acceleration at the switching instants
    changes by less than 1e-10 of its scale; the remaining difference is reported as `step_error`.

    Parameters
    ----------
    targets : one per command.
    coil : thermal model of the coil; None leaves the temperatures NaN. For several motors it has to be None.
    limits : one set per command, whose bounded quantities are evaluated.
    walls : one per command. The commands are then the transients, and the feedback is added tick by tick from the
        replay's own encoder position, which `count_m` rounds to whole counts.
    budgets : one per command, with a common tap rate; with a tap rate the temperatures are those of the periodic
        steady state.
    simulated : the simulation of these commands, if they were simulated together with others.
    again : makes the commands again where the replays' courses are let go and then read; by default they are kept.
    spread : further devices that the commands serve. Limits on the motion are checked on each of them by a separate
        simulation; all other results are those of the first device.
    yardstick : rule by which figures are computed; by default with a tap's intention of 30 ms.
    """
    loop = None if walls is None else Loop(walls, count_m)
    course = accurate(stage, grid, commands, loop) if simulated is None else simulated
    again = partial(np.asarray, commands) if again is None else again
    samples = Samples(partial(_sampled, stage, grid, again, loop))
    samples.courses = _at_instants(course)
    acceleration = samples.courses.accelerations_m_s2[..., : grid.stages]
    figures = figures_of(course, Yardstick(grid) if yardstick is None else yardstick, targets)
    runs, step_error, limits = [course], course.step_error, limits or [Limits()] * len(commands)
    winding = housing = np.full(len(commands), np.nan)
    if coil is not None:
        winding, housing = _temperatures(course, stage.amplifier, coil, budgets)
    if any(limit.of_each_device for of_entry in limits for limit in of_entry):
        runs += [accurate(device, grid, commands, None) for device in spread]
        step_error = np.array([run.step_error for run in runs]).max(axis=0)
    whole, early, of_input, of_motion = _peaks(runs, limits, (stage, *spread), grid)
    peaks = of_input, largest(course.command), of_motion
    scale = peak_scale(largest(acceleration), course.rounding)
    numbers = np.stack([*peaks, winding, housing, scale, step_error], axis=1).tolist()
    return [
        Replay(
            samples=samples,
            number=m,
            figures=figures[m],
            peak_input=peak_input,
            peak_command=peak_command,
            after_peak_m_s2=after_peak,
            reached={limit.name: float(whole[limit.name][m]) for limit in limits[m]},
            reached_while_stated={limit.name: float(early[limit.name][m]) for limit in limits[m]},
            winding_C=winding_C,
            housing_C=housing_C,
            scale_m_s2=scale_m_s2,
            step_error=by_step,
        )
        for m, (peak_input, peak_command, after_peak, winding_C, housing_C, scale_m_s2, by_step) in enumerate(numbers)
    ]


def _sampled(stage: StageModel, grid: TimeGrid, again: Callable[[], FloatArray], loop: Loop | None) -> Sampled:
    """The courses of commands that are simulated again, at the switching instants."""
    return _at_instants(accurate(stage, grid, again(), loop))


def _at_instants(course: Course) -> Sampled:
    at_switching = course.inputs[:, course.period.arriving, :, course.period.at_switching]
    plant_inputs = lone(at_switching[..., : course.command.shape[-1]].copy())
    return Sampled(course.accelerations, plant_inputs, course.command)


def replayed(
    problems: Sequence[TransientProblem],
    commands: FloatArray,
    coil: CoilModel | None = None,
    *,
    uncorrected: Sequence[Target] | None = None,
    simulated: Course | None = None,
    again: Callable[[], FloatArray] | None = None,
) -> list[Replay]:
    """`replay` M commands (M, N), or (M, m, N), each in its problem; with a wall they are the transients.

    Parameters
    ----------
    problems : one per command, all with the same devices and time axis; targets, limits and budgets may differ.
    uncorrected : targets that the figures refer to; by default those of the problems.
    simulated, again : as of `replay`.
    """
    first = problems[0]
    return replay(
        first.stage,
        first.grid,
        commands,
        [problem.target for problem in problems] if uncorrected is None else uncorrected,
        coil,
        limits=[problem.limits for problem in problems],
        walls=[problem.wall for problem in problems if problem.wall is not None] or None,
        budgets=[problem.thermal.budget for problem in problems if problem.thermal is not None] or None,
        simulated=simulated,
        again=again,
        spread=first.spread,
        yardstick=first.yardstick,
    )
