"""Independent continuous-time replay of commands.

`continuous` simulates them and shares only the plant's matrices with the design model. Every limit is checked at
every fine step.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from transopt.base.shown import brief
from transopt.base.signals import FloatArray
from transopt.base.threads import one_blas_thread
from transopt.plant.amplifier import Amplifier
from transopt.plant.coil import CoilModel, effective_square, following_square_mean
from transopt.plant.discretise import Motion, StageModel
from transopt.plant.time_grid import TimeGrid
from transopt.plant.wall import HandOver
from transopt.problem.heat import Budget
from transopt.problem.limits.limit import Limit, Limits, tolerated
from transopt.problem.limits.row import COMMAND, INPUT
from transopt.problem.limits.temperature import TemperatureLimit
from transopt.problem.objective.figures import Figures, Yardstick
from transopt.problem.objective.target import Target
from transopt.problem.problem import TransientProblem
from transopt.proof.continuous import (
    AGREEMENT,
    Accurate,
    Course,
    Loop,
    Trajectory,
    accurate,
    fine,
    largest,
    peak_scale,
)
from transopt.proof.flow import Flow

COMMANDS_AT_ONCE = 16  # their samples fit into the processor's cache


@dataclass(frozen=True)
class Replay:
    """The continuous-time motion under one command.

    With p directions accelerations are (p, N) and (p, M); with m motors inputs and commands are (m, N).

    Attributes
    ----------
    acceleration_m_s2, plant_input : (N,) y'' and the plant's input at the switching instants.
    figures : comparison with the recorded tap.
    after_m_s2 : (M,) y'' at the instants of the tail.
    peak_input, peak_command : largest absolute values over all t.
    after_peak_m_s2 : largest |y''| after the waveform (`continuous.after_s`).
    reached : name of a limit -> largest absolute value over all t of the quantity it bounds; 0 for a limit that is
        defined at the ticks only. A motor's value counts over its share of the limit.
    reached_while_stated : the same up to the last switching instant, tau_(N-1). Later values follow from the last
        command and, with a wall, from its feedback alone.
    winding_C, housing_C : highest temperatures over the horizon, or for taps that repeat over the periodic steady
        state; NaN without a coil model and for several motors.
    command : (N,) the total command that was played; with a wall the transient plus the feedback of the replay.
    rounding_m_s2 : rounding error of y'', `ROUNDING` times the largest |C||x| + |D||i| at the switching instants.
    step_error : difference of y'' from a replay with half the step, relative to `scale_m_s2`.
    """

    acceleration_m_s2: FloatArray
    plant_input: FloatArray
    figures: Figures
    after_m_s2: FloatArray
    peak_input: float
    peak_command: float
    after_peak_m_s2: float
    reached: Mapping[str, float]
    reached_while_stated: Mapping[str, float]
    winding_C: float
    housing_C: float
    command: FloatArray
    rounding_m_s2: float
    step_error: float

    __repr__ = brief

    @property
    def scale_m_s2(self) -> float:
        """Reference for relative differences of y''."""
        return float(peak_scale(np.abs(self.acceleration_m_s2).max(), self.rounding_m_s2))

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

    def shortfalls(self, problem: TransientProblem, command: FloatArray, predicted_m_s2: FloatArray) -> list[str]:
        """Reasons not to admit this command (N,), one sentence each; empty if there are none."""
        found: list[str] = []
        tolerance_A = tolerated(problem.limits.input_limit)
        found.extend(limit.replayed(self.peak(limit)) for limit in problem.limits if self.leaves(limit))
        if not self.step_error <= AGREEMENT:
            fastest_Hz = float(np.abs(np.linalg.eigvals(problem.stage.plant.A)).max()) / (2 * np.pi)
            found.append(
                f"replay did not converge: halving its step changes it by {self.step_error:.1e} of its peak; the "
                f"device's fastest mode, at {fastest_Hz:.2g} Hz, is too stiff for double precision: raise the "
                "smallest mass, or lower the stiffness and the damping that act on it"
            )
        feedback_off = float(np.abs(self.command - command).max())
        if not feedback_off <= tolerance_A:
            found.append(
                f"with the wall's feedback the command differs from the predicted one by {feedback_off:.1e} A"
            )
        scale = max(self.scale_m_s2, 1e-9)
        difference = float(np.abs(self.acceleration_m_s2 - predicted_m_s2).max()) / scale
        if not difference <= AGREEMENT:
            found.append(f"replayed acceleration differs from the predicted one by {difference:.1e} of its peak")
        return found


def replayed_figures(
    stage: StageModel, yardstick: Yardstick, commands: FloatArray, targets: Sequence[Target]
) -> list[Figures]:
    """Figures of M commands (M, N), or (M, m, N), relative to their targets, by the same simulation as `replay`."""
    return figures_of(accurate(stage, yardstick.grid, commands, None), yardstick, targets)


def figures_of(simulated: Accurate, yardstick: Yardstick, targets: Sequence[Target]) -> list[Figures]:
    """Figures of M simulated commands relative to their targets."""
    with np.errstate(over="ignore", invalid="ignore"):  # the loop of an unstable wall overflows
        return yardstick.figures_of(targets, simulated.acceleration_m_s2)


def largest_reached(
    runs: Sequence[Trajectory], limits: Sequence[Limits], devices: tuple[StageModel, ...], grid: TimeGrid
) -> list[tuple[dict[str, float], dict[str, float]]]:
    """For each command and limit, the largest absolute value that it bounds, in all and up to tau_(N-1).

    Parameters
    ----------
    runs : the same commands on the entry's own device and, if a limit depends on them, on those of its spread.
    devices : the devices of `runs`; further ones are not used.
    """
    found: list[tuple[dict[str, float], dict[str, float]]] = [({}, {}) for _ in limits]
    for limit, commands in alike(limits):
        reached = _reached(runs, limit, commands, Played(devices, grid, limits[commands[0]]))
        for m, (whole, early) in zip(commands, reached, strict=True):
            found[m][0][limit.name], found[m][1][limit.name] = whole, early
    return found


def _reached(
    runs: Sequence[Trajectory], limit: Limit, commands: list[int], posed: "Played"
) -> list[tuple[float, float]]:
    """For each of these commands the largest absolute value that a limit bounds, in all and up to tau_(N-1)."""
    run, grid = runs[0], posed.grid
    instants = np.append(grid.switching_times_s, grid.end_s)
    # A switching instant has two samples, just before and just after it; the later one has its command.
    at, over = slice(0, run.times_s.size), int(run.at_switching[-1]) + 1
    if not limit.after_the_waveform:
        begins = int(np.searchsorted(run.times_s, grid.switching_times_s[0], side="left"))
        at = slice(begins, int(np.searchsorted(run.times_s, grid.end_s, side="right")))
    taps = slice(None) if len(commands) == run.felt.shape[0] else commands
    whole, early = np.zeros((2, len(commands)))
    for row in limit.watched(posed):
        offset = row.offset
        if isinstance(offset, np.ndarray):
            offset = np.interp(run.times_s[at], instants[: offset.size], offset)
        values = replace(row, offset=offset).value(_motion(runs[row.device], taps, at), run.felt[taps][..., at])
        early = np.maximum(early, largest(values[:, : over - at.start]) / row.share)
        whole = np.maximum(whole, largest(values[:, over - at.start :]) / row.share)
    return list(zip(np.maximum(whole, early).tolist(), early.tolist(), strict=True))


def _motion(run: Trajectory, taps: slice | list[int], at: slice) -> Motion:
    """The motion of some taps at some samples."""
    acceleration, velocity = (each[taps][..., at] for each in (run.acceleration_m_s2, run.velocity_m_s))
    outputs = {name: values[taps, at] for name, values in run.outputs.items()}
    return Motion(acceleration, run.plant_input[taps][..., at], velocity, np.zeros(0), outputs)


def alike(limits: Sequence[Limits]) -> list[tuple[Limit, list[int]]]:
    """Every limit with the indices of the members of `limits` that have it."""
    found: dict[object, tuple[Limit, list[int]]] = {}
    for m, of_entry in enumerate(limits):
        for limit in of_entry:
            found.setdefault(limit if limit.is_hashable else id(limit), (limit, []))[1].append(m)
    return list(found.values())


@dataclass(frozen=True)
class Played:
    """The part of a problem that limits read to state their rows."""

    devices: tuple[StageModel, ...]
    grid: TimeGrid
    limits: Limits

    @property
    def stage(self) -> StageModel:
        return self.devices[0]


def _moves(limit: Limit, posed: Played) -> bool:
    """Whether a limit depends on anything but input and command."""
    return any(not row.linear or set(row.outputs) - {INPUT, COMMAND} for row in limit.watched(posed))


def _temperatures(
    run: Trajectory, amplifier: Amplifier | None, coil: CoilModel, budgets: Sequence[Budget] | None, grid: TimeGrid
) -> tuple[FloatArray, FloatArray]:
    """(M,) highest winding and housing temperature each, up to tau_N."""
    starts = run.times_s[run.segment_starts]
    playing = starts < grid.end_s - 1e-9 * grid.dt_s
    first, lengths = run.segment_starts[playing], np.diff(starts, append=run.times_s[-1])[playing]
    # One step per segment is exact, as the command is constant within it.
    before, felt = run.plant_input[:, first], run.felt[:, first]
    if amplifier is None:
        heat = effective_square(before, coil.ripple_A)
    else:
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
    simulated: Accurate | None = None,
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
    spread : further devices that the commands serve. Limits on the motion are checked on each of them by a separate
        simulation; all other results are those of the first device.
    yardstick : rule by which figures are computed; by default with a tap's intention of 30 ms.
    """
    if simulated is None:
        loop = None if walls is None else Loop(walls, count_m)
        simulated = accurate(stage, grid, commands, loop)
    yardstick = Yardstick(grid) if yardstick is None else yardstick
    devices, found = (stage, *spread), list[Replay]()
    for taps in np.array_split(np.arange(len(commands)), -(-len(commands) // COMMANDS_AT_ONCE)):
        part = slice(int(taps[0]), int(taps[-1]) + 1)
        some = simulated.of(part)
        figures = figures_of(some, yardstick, targets[part])
        its_limits = None if limits is None else limits[part]
        its_budgets = None if budgets is None else budgets[part]
        found += _replays(devices, grid, commands[part], figures, coil, its_limits, its_budgets, some)
    return found


def replayed(
    problems: Sequence[TransientProblem],
    commands: FloatArray,
    coil: CoilModel | None = None,
    *,
    uncorrected: Sequence[Target] | None = None,
    simulated: Accurate | None = None,
) -> list[Replay]:
    """`replay` M commands (M, N), or (M, m, N), each in its problem; with a wall they are the transients.

    Parameters
    ----------
    problems : one per command, all with the same devices and time axis; targets, limits and budgets may differ.
    uncorrected : targets that the figures refer to; by default those of the problems.
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
        spread=first.spread,
        yardstick=first.yardstick,
    )


def _replays(
    devices: tuple[StageModel, ...],
    grid: TimeGrid,
    commands: FloatArray,
    figures: Sequence[Figures],
    coil: CoilModel | None,
    limits: Sequence[Limits] | None,
    budgets: Sequence[Budget] | None,
    simulated: Accurate,
) -> list[Replay]:
    """`replay` of commands that were simulated already, on the first device and those of the spread."""
    stage, course, flow, step_error = devices[0], simulated.course, simulated.flow, simulated.step_error
    moving = limits is not None and any(
        _moves(limit, Played(devices, grid, limits[at[0]])) for limit, at in alike(limits)
    )
    run = fine(course, flow, grid, moving=moving)
    runs, rounding = [run], course.rounding(flow)
    acceleration, later = np.split(simulated.acceleration_m_s2, [grid.stages], axis=-1)
    winding = housing = np.full(len(commands), np.nan)
    if coil is not None:
        winding, housing = _temperatures(run, stage.amplifier, coil, budgets, grid)
    if limits is not None and any(limit.of_each_device for of_entry in limits for limit in of_entry):
        for device in devices[1:]:
            its_own = accurate(device, grid, commands, None)
            runs.append(fine(its_own.course, its_own.flow, grid))
            step_error = np.maximum(step_error, its_own.step_error)
    reached = [({}, {})] * len(commands) if limits is None else largest_reached(runs, limits, devices, grid)
    after = _after_peak(course, flow, run.times_s, grid)
    peaks = map(largest, (run.plant_input, course.command))
    numbers = np.stack([*peaks, after, winding, housing, rounding, step_error], axis=1).tolist()
    return [
        Replay(
            acceleration_m_s2=acceleration[m],
            plant_input=run.plant_input[m][..., run.at_switching],
            figures=figures[m],
            after_m_s2=later[m],
            peak_input=peak_input,
            peak_command=peak_command,
            after_peak_m_s2=after_peak,
            reached=reached[m][0],
            reached_while_stated=reached[m][1],
            winding_C=winding_C,
            housing_C=housing_C,
            command=course.command[m],
            rounding_m_s2=off,
            step_error=by_step,
        )
        for m, (peak_input, peak_command, after_peak, winding_C, housing_C, off, by_step) in enumerate(numbers)
    ]


def _after_peak(course: Course, flow: Flow, times_s: FloatArray, grid: TimeGrid) -> FloatArray:
    """(M,) largest |y''| after the waveform, at the samples after tau_N."""
    first = int(np.searchsorted(times_s, grid.end_s, side="right"))
    period, sample = divmod(first, times_s.size // course.period.periods)
    with np.errstate(over="ignore", invalid="ignore"):  # the loop of an unstable wall overflows
        return largest(course.sampled(slice(flow.tracked), period)[..., sample:])
