"""Independent continuous-time replay of commands (DESIGN 4).

Nothing but the plant's matrices is shared with the design model: the time axis is the true one (commands issued at
t_k, felt a delay later), the integrator is an implicit Runge-Kutta method on a finer step instead of a matrix
exponential, and every limit is checked at every fine step.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import linalg, special

from transopt.discretise import StageModel, TimeGrid, split_delay
from transopt.heat import Budget
from transopt.problem import Certificate, TransientProblem
from transopt.signals import FloatArray, nrmse
from transopt.supply import Supply
from transopt.thermal import CoilModel, effective_square_mean
from transopt.wall import FeedbackLoop, HandOver

SAMPLES_PER_PERIOD = 8  # at which the trajectory is kept
STEP_RADIUS = 0.5  # largest |eigenvalue| times step to begin with: a stiff mode that is not resolved would die out
STEP_ERROR = 1e-10  # wanted relative difference between a step and half of it
MOST_HALVINGS = 6
AFTER_S = 20e-3  # of free motion after the waveform
TEMPERATURE_TOLERANCE_K = 1e-3  # the problem states the temperature at the switching instants
SUPPLY_TOLERANCE = 1e-3  # of the limit: between switching instants only the back-EMF is left to its own devices
AGREEMENT = 1e-6  # largest excusable difference between replay and prediction, relative to the peak
# Where link and current forces cancel at the switching instants (a mass on a link that decays within one tick), what
# is left of y'' is rounding of C x and D i. Differences up to this share of them say nothing.
ROUNDING = 16 * float(np.finfo(float).eps)


@dataclass(frozen=True)
class Replay:
    """What one command does in continuous time.

    Attributes
    ----------
    acceleration_m_s2, current_A : (N,) y'' and i at the switching instants.
    nrmse : of that acceleration against the reference.
    peak_current_A, peak_command_A : over all t.
    after_peak_m_s2 : largest |y''| in the 20 ms after the waveform, when no current flows any more.
    after_peak_A : largest |i| there, all of it the wall's feedback.
    peak_voltage_V : largest terminal voltage over all t; NaN without a supply.
    winding_C, housing_C : highest temperatures over the horizon, or for taps that repeat over the periodic steady
        state; NaN without a coil model.
    command_A : (N,) the total command that was played; with a wall the transient plus the feedback of the replay.
    fine_times_s, fine_acceleration_m_s2, fine_current_A : (K,) at every fine step, with the values before and
        after each switching instant.
    rounding_m_s2 : `ROUNDING` of the largest |C||x| + |D||i| at the switching instants, the terms that add up to y''.
    step_error : difference of y'' to a replay with half the step, relative to `scale_m_s2`.
    """

    acceleration_m_s2: FloatArray
    current_A: FloatArray
    nrmse: float
    peak_current_A: float
    peak_command_A: float
    after_peak_m_s2: float
    after_peak_A: float
    peak_voltage_V: float
    winding_C: float
    housing_C: float
    command_A: FloatArray
    fine_times_s: FloatArray
    fine_acceleration_m_s2: FloatArray
    fine_current_A: FloatArray
    rounding_m_s2: float
    step_error: float

    @property
    def scale_m_s2(self) -> float:
        """What differences of y'' are relative to."""
        return float(_scale(np.abs(self.acceleration_m_s2).max(), self.rounding_m_s2))

    def shortfalls(self, problem: TransientProblem, command_A: FloatArray, predicted_m_s2: FloatArray) -> list[str]:
        """What speaks against admitting this command (N,), one sentence each; empty if clean."""
        found = []
        limits = problem.limits
        tolerance_A = Certificate.tolerated(limits.current_A)
        if not self.peak_current_A <= limits.current_A + tolerance_A:
            found.append(f"replayed current {self.peak_current_A:.6f} A, limit {limits.current_A:g} A")
        bound = limits.command_bound_A
        if not self.peak_command_A <= bound + Certificate.tolerated(bound):
            found.append(f"command {self.peak_command_A:.6f} A, limit {bound:g} A")
        supply, thermal = problem.supply, problem.thermal
        if supply is not None and not self.peak_voltage_V <= supply.limit_V * (1 + SUPPLY_TOLERANCE):
            found.append(f"terminal voltage {self.peak_voltage_V:.4f} V, limit {supply.limit_V:g} V")
        if thermal is not None and not self.winding_C <= thermal.limit_C + TEMPERATURE_TOLERANCE_K:
            found.append(f"winding {self.winding_C:.3f} C, limit {thermal.limit_C:.8g} C")
        if not self.step_error <= AGREEMENT:
            found.append(f"replay did not converge: halving its step changes it by {self.step_error:.1e} of its peak")
        feedback_off = float(np.abs(self.command_A - command_A).max())
        if not feedback_off <= tolerance_A:
            found.append(
                f"with the wall's feedback the command differs from the predicted one by {feedback_off:.1e} A"
            )
        scale = max(self.scale_m_s2, 1e-9)
        difference = float(np.abs(self.acceleration_m_s2 - predicted_m_s2).max()) / scale
        if not difference <= AGREEMENT:
            found.append(f"replayed acceleration differs from the predicted one by {difference:.1e} of its peak")
        return found


def _scale(peak_m_s2: FloatArray, rounding_m_s2: FloatArray | float) -> FloatArray:
    """The peak, unless `AGREEMENT` of it is less than the rounding of what adds up to it."""
    return np.maximum(np.maximum(peak_m_s2, rounding_m_s2 / AGREEMENT), np.finfo(float).tiny)


def _radau(stages: int) -> tuple[FloatArray, FloatArray]:
    """Butcher matrix (s, s) and weights (s,) of Radau IIA: order 2 s - 1, L-stable, last node at 1.

    Nodes as in Hairer & Wanner, Solving Ordinary Differential Equations II, Sec. IV.5.
    """
    nodes = np.append((special.roots_jacobi(stages - 1, 1.0, 0.0)[0] + 1) / 2, 1.0)
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
class _Segment:
    """The part of a servo period in which one command is felt: maps from its start to each kept sample.

    `behind` is how many ticks that command was issued before the period's own.
    """

    behind: int
    offsets_s: FloatArray  # (m + 1,) from the start of the period, the segment's start first
    P: FloatArray  # (m + 1, n, n)
    Q: FloatArray  # (m + 1, n, 1)


def _segment(A: FloatArray, B: FloatArray, start_s: float, end_s: float, behind: int, halvings: int) -> _Segment:
    """Kept samples a fraction of a period apart, reached by as many Radau steps as the stiffest mode needs."""
    n = A.shape[0]
    samples = SAMPLES_PER_PERIOD // 2
    spacing = (end_s - start_s) / samples
    fastest = float(np.abs(np.linalg.eigvals(A)).max())
    doublings = int(np.ceil(np.log2(max(fastest * spacing / STEP_RADIUS, 1.0)))) + halvings
    step = np.eye(n + 1)
    step[:n, :n], step[:n, n:] = _step_map(A, B, spacing / 2**doublings)
    between = np.linalg.matrix_power(step, 2**doublings)
    maps = [np.eye(n + 1)]
    for _ in range(samples):
        maps.append(between @ maps[-1])
    stacked = np.stack(maps)
    return _Segment(behind, np.linspace(start_s, end_s, samples + 1), stacked[:, :n, :n], stacked[:, :n, n:])


def _segments(A: FloatArray, B: FloatArray, grid: TimeGrid, halvings: int) -> list[_Segment]:
    """A period [t_k, t_(k+1)) feels the command of one tick earlier until the delay's fraction has passed."""
    dt = grid.dt_s
    whole, late = split_delay(grid.delay_s, dt)
    if late <= 1e-9 * dt:
        # Two halves all the same, so that a period always has as many kept samples.
        return [_segment(A, B, 0.0, dt / 2, whole, halvings), _segment(A, B, dt / 2, dt, whole, halvings)]
    return [_segment(A, B, 0.0, late, whole + 1, halvings), _segment(A, B, late, dt, whole, halvings)]


@dataclass(frozen=True)
class _Trajectory:
    times_s: FloatArray  # (K,)
    acceleration_m_s2: FloatArray  # (M, K)
    current_A: FloatArray  # (M, K)
    felt_A: FloatArray  # (M, K) command that the amplifier follows
    velocity_m_s: FloatArray  # (M, K) of the motor mass, what the current adds
    command_A: FloatArray  # (M, N) as issued
    rounding_m_s2: FloatArray  # (M,)
    at_switching: NDArray[np.intp]  # (N,) indices of the fine samples just after each switching instant
    segment_starts: NDArray[np.intp]  # (S,) indices of the first sample of each segment


@dataclass(frozen=True)
class _Loop:
    """The walls of M taps, closed over the replay's own motion; `count_m` rounds the encoder, 0 does not."""

    walls: Sequence[HandOver]
    count_m: float

    def nominal(self, k: int) -> FloatArray:
        """(M,) z_nom at tick k, going on straight after the last."""
        z = np.stack([wall.nominal_m for wall in self.walls], axis=1)
        last = z.shape[0] - 1
        return np.asarray(z[k] if k <= last else z[last] + (k - last) * (z[last] - z[last - 1]))

    def read(self, k: int, deviation_m: FloatArray) -> FloatArray:
        z = self.nominal(k) + deviation_m
        return np.asarray(np.round(z / self.count_m) * self.count_m) if self.count_m else z

    def start(self, stage: StageModel, dt_s: float) -> FeedbackLoop:
        wall = self.walls[0].wall
        approach = np.array([wall.approach_m_s for wall in self.walls])
        first = self.read(0, np.zeros(approach.size))
        return FeedbackLoop(wall, stage.amplifier, dt_s, first, approach)


def _simulate(
    stage: StageModel, grid: TimeGrid, commands_A: FloatArray, halvings: int, loop: _Loop | None
) -> _Trajectory:
    """Fine trajectories of M commands (M, N) from the first tick until `AFTER_S` after tau_N."""
    plant, amplifier = stage.plant, stage.amplifier
    n, (M, N) = plant.order, commands_A.shape
    if amplifier is None:
        A, B = plant.A, plant.B
    else:
        w = amplifier.rate_rad_s
        A = np.block([[plant.A, plant.B], [np.zeros((1, n)), -w * np.eye(1)]])
        B = np.append(np.zeros((n, 1)), [[w]], axis=0)
    # In balanced units (powers of two, exact) no state drowns in the rounding of another.
    balanced, (units, _) = linalg.matrix_balance(A, permute=False, separate=True)
    A, B, inner = np.asarray(balanced, dtype=float), B / units[:, None], units[:n]
    encoder, output, moving = plant.Ce[0] * inner, plant.C[0] * inner, (plant.Ce @ plant.A)[0] * inner
    current_unit = units[-1]
    segments = _segments(A, B, grid, halvings)
    # With a whole delay the command arrives with the tick, else with the second segment.
    arriving = segments[0] if segments[0].behind == segments[1].behind else segments[1]
    periods = N + segments[0].behind + int(np.ceil(AFTER_S / grid.dt_s))
    # After the waveform there is silence, or what the wall's feedback goes on asking for.
    issued = np.concatenate([commands_A, np.zeros((M, periods - N))], axis=1)
    feedback = None if loop is None else loop.start(stage, grid.dt_s)
    x = np.zeros((A.shape[0], M))
    silence = np.zeros(M)
    states, felt, times, at_switching, starts, count = [], [], [], [], [], 0
    for k in range(periods):
        if loop is not None and feedback is not None:
            issued[:, k] += feedback.step(loop.read(k, encoder @ x[:n]))
        for segment in segments:
            index = k - segment.behind
            u = issued[:, index] if index >= 0 else silence
            if segment is arriving and 0 <= index < N:
                at_switching.append(count)
            fine = segment.P @ x + segment.Q * u
            x = fine[-1]
            states.append(fine)
            felt.append(np.broadcast_to(u, (fine.shape[0], M)))
            times.append(segment.offsets_s + (k * grid.dt_s - grid.lead_s))
            starts.append(count)
            count += fine.shape[0]
    trajectory, command = np.concatenate(states), np.concatenate(felt)
    current = command if amplifier is None else trajectory[:, n] * current_unit
    acceleration = np.einsum("n,knm->km", output, trajectory[:, :n]) + plant.D[0, 0] * current
    velocity = np.einsum("n,knm->km", moving, trajectory[:, :n])
    terms = np.einsum("n,knm->km", np.abs(output), np.abs(trajectory[at_switching, :n]))
    terms += np.abs(plant.D[0, 0] * current[at_switching])
    return _Trajectory(
        times_s=np.concatenate(times),
        acceleration_m_s2=acceleration.T,
        current_A=current.T,
        felt_A=command.T,
        velocity_m_s=velocity.T,
        command_A=issued[:, :N],
        rounding_m_s2=ROUNDING * terms.max(axis=0),
        at_switching=np.asarray(at_switching),
        segment_starts=np.asarray(starts),
    )


def _peak_voltages(run: _Trajectory, supplies: Sequence[Supply], grid: TimeGrid) -> FloatArray:
    """(M,) largest terminal voltage while the waveform plays."""
    peaks = []
    playing = (run.times_s >= grid.switching_times_s[0]) & (run.times_s <= grid.end_s)
    for m, supply in enumerate(supplies):
        nominal = np.interp(run.times_s[playing], grid.switching_times_s, supply.nominal_m_s)
        current, felt = run.current_A[m, playing], run.felt_A[m, playing]
        velocity = run.velocity_m_s[m, playing] + nominal
        voltage = supply.circuit.voltage_V(current, supply.pole_rad_s * (felt - current), velocity)
        peaks.append(float(np.abs(voltage).max()))
    return np.array(peaks)


def _temperatures(
    run: _Trajectory, coil: CoilModel, budgets: Sequence[Budget] | None, grid: TimeGrid
) -> tuple[FloatArray, FloatArray]:
    """(M,) highest winding and housing temperature; the heat is summed over each segment."""
    steps = np.diff(run.times_s)
    # Exact for a current that is linear within a fine step; the steps between segments have no length.
    heat = steps * effective_square_mean(run.current_A[:, :-1], run.current_A[:, 1:])
    lengths = np.add.reduceat(np.append(steps, 0.0), run.segment_starts)
    energy = np.add.reduceat(
        np.append(heat, np.zeros((run.current_A.shape[0], 1)), axis=1), run.segment_starts, axis=1
    )
    # Up to tau_N; what plays after the waveform is no part of it.
    playing = run.times_s[run.segment_starts] < grid.end_s - 1e-9 * grid.dt_s
    energy, lengths = energy[:, playing], lengths[playing]
    rate_Hz = None if budgets is None else budgets[0].tap_rate_Hz
    if budgets is None or rate_Hz is None:
        winding, housing = coil.simulate(energy / lengths, lengths)
    else:
        pause = 1 / rate_Hz - float(lengths.sum())
        idle = np.array([budget.pause_A for budget in budgets])
        winding, housing = coil.steady_course(energy / lengths, lengths, pause, idle)
    return winding.max(axis=1), housing.max(axis=1)


def replay(
    stage: StageModel,
    grid: TimeGrid,
    commands_A: FloatArray,
    references_m_s2: FloatArray,
    coil: CoilModel | None,
    *,
    supplies: Sequence[Supply] | None = None,
    walls: Sequence[HandOver] | None = None,
    budgets: Sequence[Budget] | None = None,
    count_m: float = 0.0,
) -> list[Replay]:
    """Play M commands (M, N) through one device, from rest, and compare each with its reference (M, N).

    The integrator's step resolves the fastest mode and is halved until the acceleration at the switching instants
    changes by less than 1e-10 of its scale; the difference reached is reported as `step_error`.

    Parameters
    ----------
    supplies : one per command, for the terminal voltage.
    walls : one per command: the commands are then the transients, and the feedback is added tick by tick from the
        replay's own encoder position, which `count_m` rounds to whole counts.
    budgets : one per command, of one tap rate; with it the temperatures are those of the periodic steady state.
    """
    loop = None if walls is None else _Loop(walls, count_m)
    run = _simulate(stage, grid, commands_A, 0, loop)
    for halvings in range(1, MOST_HALVINGS + 1):
        finer = _simulate(stage, grid, commands_A, halvings, loop)
        coarse = run.acceleration_m_s2[:, run.at_switching]
        accurate = finer.acceleration_m_s2[:, finer.at_switching]
        scale = _scale(np.abs(accurate).max(axis=1), finer.rounding_m_s2)
        step_error = np.abs(accurate - coarse).max(axis=1) / scale
        run = finer
        if np.all(step_error <= STEP_ERROR):
            break
    current = run.current_A[:, run.at_switching]
    M, after = commands_A.shape[0], run.times_s > grid.end_s
    unknown = np.full(M, np.nan)
    winding, housing = (unknown, unknown) if coil is None else _temperatures(run, coil, budgets, grid)
    voltage = unknown if supplies is None else _peak_voltages(run, supplies, grid)
    return [
        Replay(
            acceleration_m_s2=accurate[m],
            current_A=current[m],
            nrmse=nrmse(accurate[m], references_m_s2[m]),
            peak_current_A=float(np.abs(run.current_A[m]).max()),
            peak_command_A=float(np.abs(run.command_A[m]).max()),
            after_peak_m_s2=float(np.abs(run.acceleration_m_s2[m, after]).max()),
            after_peak_A=float(np.abs(run.current_A[m, after]).max()),
            peak_voltage_V=float(voltage[m]),
            winding_C=float(winding[m]),
            housing_C=float(housing[m]),
            command_A=run.command_A[m],
            fine_times_s=run.times_s,
            fine_acceleration_m_s2=run.acceleration_m_s2[m],
            fine_current_A=run.current_A[m],
            rounding_m_s2=float(run.rounding_m_s2[m]),
            step_error=float(step_error[m]),
        )
        for m in range(M)
    ]
