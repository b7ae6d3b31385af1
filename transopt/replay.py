"""Independent continuous-time replay of commands (DESIGN 4).

Nothing but the plant's matrices is shared with the design model: the time axis is the true one (commands issued at
t_k, felt a delay later), the integrator is an implicit Runge-Kutta method on a finer step instead of a matrix
exponential, and every limit is checked at every fine step.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import special

from transopt.discretise import StageModel, TimeGrid
from transopt.problem import TransientProblem
from transopt.signals import FloatArray, nrmse
from transopt.thermal import CoilModel, effective_square_mean

SAMPLES_PER_PERIOD = 8  # at which the trajectory is kept
STEP_RADIUS = 0.5  # largest |eigenvalue| times step to begin with: a stiff mode that is not resolved would die out
STEP_ERROR = 1e-10  # wanted relative difference between a step and half of it
MOST_HALVINGS = 6
AFTER_S = 20e-3  # of free motion after the waveform
CURRENT_TOLERANCE_A = 1e-6  # what counts as leaving a limit, as in the certificate
AGREEMENT = 1e-6  # largest excusable difference between replay and prediction, relative to the peak


@dataclass(frozen=True)
class Replay:
    """What one command does in continuous time.

    Attributes
    ----------
    acceleration_m_s2, current_A : (N,) y'' and i at the switching instants.
    nrmse : of that acceleration against the reference.
    peak_current_A, peak_command_A : over all t.
    after_peak_m_s2 : largest |y''| in the 20 ms after the waveform, when no current flows any more.
    winding_C, housing_C : highest temperatures over the horizon; NaN without a coil model.
    fine_times_s, fine_acceleration_m_s2, fine_current_A : (K,) at every fine step, with the values before and
        after each switching instant.
    step_error : relative difference of y'' to a replay with half the step.
    """

    acceleration_m_s2: FloatArray
    current_A: FloatArray
    nrmse: float
    peak_current_A: float
    peak_command_A: float
    after_peak_m_s2: float
    winding_C: float
    housing_C: float
    fine_times_s: FloatArray
    fine_acceleration_m_s2: FloatArray
    fine_current_A: FloatArray
    step_error: float

    def shortfalls(self, problem: TransientProblem, coil: CoilModel | None, predicted_m_s2: FloatArray) -> list[str]:
        """What speaks against admitting this command, one sentence each; empty if clean."""
        found = []
        limits = problem.limits
        if not self.peak_current_A <= limits.current_A + CURRENT_TOLERANCE_A:
            found.append(f"replayed current {self.peak_current_A:.6f} A, limit {limits.current_A:g} A")
        if limits.command_A is not None and not self.peak_command_A <= limits.command_A + CURRENT_TOLERANCE_A:
            found.append(f"command {self.peak_command_A:.6f} A, limit {limits.command_A:g} A")
        if coil is not None and not self.winding_C <= coil.limit_C:
            found.append(f"winding {self.winding_C:.2f} C, limit {coil.limit_C:g} C")
        if not self.step_error <= AGREEMENT:
            found.append(f"replay did not converge: halving its step changes it by {self.step_error:.1e} of its peak")
        peak = max(float(np.abs(self.acceleration_m_s2).max()), 1e-9)
        difference = float(np.abs(self.acceleration_m_s2 - predicted_m_s2).max()) / peak
        if not difference <= AGREEMENT:
            found.append(f"replayed acceleration differs from the predicted one by {difference:.1e} of its peak")
        return found


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
    whole = int(np.floor(grid.delay_s / dt + 1e-9))
    late = max(grid.delay_s - whole * dt, 0.0)
    if late <= 1e-9 * dt:
        # Two halves all the same, so that a period always has as many kept samples.
        return [_segment(A, B, 0.0, dt / 2, whole, halvings), _segment(A, B, dt / 2, dt, whole, halvings)]
    return [_segment(A, B, 0.0, late, whole + 1, halvings), _segment(A, B, late, dt, whole, halvings)]


@dataclass(frozen=True)
class _Trajectory:
    times_s: FloatArray  # (K,)
    acceleration_m_s2: FloatArray  # (M, K)
    current_A: FloatArray  # (M, K)
    at_switching: NDArray[np.intp]  # (N,) indices of the fine samples just after each switching instant
    segment_starts: NDArray[np.intp]  # (S,) indices of the first sample of each segment


def _simulate(stage: StageModel, grid: TimeGrid, commands_A: FloatArray, halvings: int) -> _Trajectory:
    """Fine trajectories of M commands (M, N) from the first tick until `AFTER_S` after tau_N."""
    plant, amplifier = stage.plant, stage.amplifier
    n, (M, N) = plant.order, commands_A.shape
    if amplifier is None:
        A, B = plant.A, plant.B
    else:
        w = amplifier.rate_rad_s
        A = np.block([[plant.A, plant.B], [np.zeros((1, n)), -w * np.eye(1)]])
        B = np.append(np.zeros((n, 1)), [[w]], axis=0)
    segments = _segments(A, B, grid, halvings)
    # With a whole delay the command arrives with the tick, else with the second segment.
    arriving = segments[0] if segments[0].behind == segments[1].behind else segments[1]
    periods = N + segments[0].behind + int(np.ceil(AFTER_S / grid.dt_s))
    x = np.zeros((A.shape[0], M))
    silence = np.zeros(M)
    states, felt, times, at_switching, starts, count = [], [], [], [], [], 0
    for k in range(periods):
        for segment in segments:
            index = k - segment.behind
            u = commands_A[:, index] if 0 <= index < N else silence
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
    current = command if amplifier is None else trajectory[:, n]
    acceleration = np.einsum("n,knm->km", plant.C[0], trajectory[:, :n]) + plant.D[0, 0] * current
    return _Trajectory(np.concatenate(times), acceleration.T, current.T, np.asarray(at_switching), np.asarray(starts))


def _temperatures(run: _Trajectory, coil: CoilModel) -> tuple[FloatArray, FloatArray]:
    """(M,) highest winding and housing temperature; the heat is summed over each segment."""
    steps = np.diff(run.times_s)
    # Exact for a current that is linear within a fine step; the steps between segments have no length.
    heat = steps * effective_square_mean(run.current_A[:, :-1], run.current_A[:, 1:])
    lengths = np.add.reduceat(np.append(steps, 0.0), run.segment_starts)
    energy = np.add.reduceat(
        np.append(heat, np.zeros((run.current_A.shape[0], 1)), axis=1), run.segment_starts, axis=1
    )
    winding, housing = coil.simulate(energy / lengths, lengths)
    return winding.max(axis=1), housing.max(axis=1)


def replay(
    stage: StageModel, grid: TimeGrid, commands_A: FloatArray, references_m_s2: FloatArray, coil: CoilModel | None
) -> list[Replay]:
    """Play M commands (M, N) through one device, from rest, and compare each with its reference (M, N).

    The integrator's step resolves the fastest mode and is halved until the acceleration at the switching instants
    changes by less than 1e-10 of its peak; the difference reached is reported as `step_error`.
    """
    run = _simulate(stage, grid, commands_A, 0)
    for halvings in range(1, MOST_HALVINGS + 1):
        finer = _simulate(stage, grid, commands_A, halvings)
        coarse = run.acceleration_m_s2[:, run.at_switching]
        accurate = finer.acceleration_m_s2[:, finer.at_switching]
        peak = np.maximum(np.abs(accurate).max(axis=1), np.finfo(float).tiny)
        step_error = np.abs(accurate - coarse).max(axis=1) / peak
        run = finer
        if np.all(step_error <= STEP_ERROR):
            break
    current = run.current_A[:, run.at_switching]
    M = commands_A.shape[0]
    winding, housing = (np.full(M, np.nan),) * 2 if coil is None else _temperatures(run, coil)
    return [
        Replay(
            acceleration_m_s2=accurate[m],
            current_A=current[m],
            nrmse=nrmse(accurate[m], references_m_s2[m]),
            peak_current_A=float(np.abs(run.current_A[m]).max()),
            peak_command_A=float(np.abs(commands_A[m]).max()),
            after_peak_m_s2=float(np.abs(run.acceleration_m_s2[m, run.times_s > grid.end_s]).max()),
            winding_C=float(winding[m]),
            housing_C=float(housing[m]),
            fine_times_s=run.times_s,
            fine_acceleration_m_s2=run.acceleration_m_s2[m],
            fine_current_A=run.current_A[m],
            step_error=float(step_error[m]),
        )
        for m in range(M)
    ]
