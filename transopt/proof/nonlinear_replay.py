"""Independent continuous-time replay of commands on a nonlinear plant.

The plant's equations with the amplifier's pole are integrated by DOP853, an explicit Runge-Kutta method of order
eight with step control (Hairer, Norsett and Wanner, "Solving Ordinary Differential Equations I", 1993; scipy's), each
period by itself, so that no step crosses a jump of the command. Only the plant's formulas are shared with the design,
neither its splitting nor its steps. All periods are integrated side by side and made to meet by multiple shooting
(Bock and Plitt, "A multiple shooting algorithm for direct solution of optimal control problems", IFAC 1984).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from transopt.base.arithmetic import NUMPY
from transopt.base.signals import FloatArray
from transopt.plant.discretise import Motion, StageModel
from transopt.plant.nonlinear_stage import MEET, NonlinearStage, corrections
from transopt.plant.state_space import VELOCITY
from transopt.plant.time_grid import TimeGrid
from transopt.problem.limits.limit import Limit, Limits
from transopt.problem.nonlinear import NonlinearProblem
from transopt.problem.objective.figures import Yardstick
from transopt.problem.objective.target import Target
from transopt.proof.continuous import after_s, peak_scale
from transopt.proof.replay import Played, Replay, Sampled, Samples

SAMPLES = 4  # per servo period
RELATIVE = 1e-9  # relative tolerance of the integrator
ABSOLUTE = 1e-3  # absolute tolerance over the relative one, per largest predicted value of the state
LEAST_RELATIVE = 1e-13  # of the integrator: less is rounding
MOST_SHOTS = 8
NEAR = 0.1  # largest correction of a guess, relative to the largest predicted value of the state
COARSER = 100.0  # factor on the tolerances of the second replay, which estimates the error of the first


@dataclass(frozen=True)
class _Course:
    """Samples of M commands, K of each.

    Attributes
    ----------
    times_s : (K,).
    states : (M, n, K).
    felt : (M, K) command that acts.
    instants : (N + M',) indices of the samples just after the switching instants of window and tail.
    """

    times_s: FloatArray
    states: FloatArray
    felt: FloatArray
    instants: NDArray[np.intp]


def _integrated(
    stage: NonlinearStage, grid: TimeGrid, commands: FloatArray, guess: FloatArray, sizes: FloatArray, relative: float
) -> _Course:
    """Integrate M commands (M, N) from rest through the window and the time after it, K periods in all.

    The periods do not wait for each other: all are integrated side by side from guessed states (M, K + 1, n) at their
    beginnings, and the guess is moved until every period ends where the next one begins (multiple shooting). The
    motion that is found does not depend on the guess. Without such a guess, or if the periods do not meet, one period
    is integrated after the other.
    """
    M, K = guess.shape[0], guess.shape[1] - 1
    held = np.append(commands, np.zeros((M, K - commands.shape[1])), axis=1)
    samples = _meeting(stage, grid.dt_s, held, guess, sizes, relative) if np.isfinite(guess).all() else None
    if samples is None:
        samples, z = np.full((M, K, stage.order, SAMPLES + 1), np.nan), np.zeros((M, stage.order))
        for k in range(K):
            if not np.isfinite(z).all():
                break
            samples[:, k] = _periods(stage, grid.dt_s, held[:, k], z, sizes, relative)
            z = samples[:, k, :, -1]
    offsets = np.linspace(0.0, grid.dt_s, SAMPLES + 1)
    return _Course(
        times_s=(grid.switching_times_s[0] + grid.dt_s * np.arange(K)[:, None] + offsets).ravel(),
        states=samples.swapaxes(1, 2).reshape(M, stage.order, -1),
        felt=np.repeat(held, SAMPLES + 1, axis=1),
        instants=(SAMPLES + 1) * np.arange(grid.stages + grid.after_stages),
    )


def _meeting(
    stage: NonlinearStage, dt_s: float, held: FloatArray, guess: FloatArray, sizes: FloatArray, relative: float
) -> FloatArray | None:
    """(M, K, n, SAMPLES + 1) samples of periods that each begin where the one before ends; None if they do not meet.

    The beginnings move as by Newton's method, with the derivatives of the discrete stage along the guess.
    """
    M, K, n = *held.shape, stage.order
    A = np.stack([stage.linearised(c, z).A for c, z in zip(held, guess, strict=True)])
    starts = guess.copy()
    for _ in range(MOST_SHOTS):
        samples = _periods(stage, dt_s, held.ravel(), starts[:, :-1].reshape(-1, n), sizes, relative)
        samples = samples.reshape(M, K, n, SAMPLES + 1)
        moved = corrections(A, samples[..., -1] - starts[:, 1:])
        if not np.all(np.abs(moved) <= NEAR * sizes):  # or NaN; far from the motion the plant may be stiff
            return None
        if np.all(np.abs(moved) <= MEET * sizes):
            return samples
        starts += moved
    return None


def _periods(
    stage: NonlinearStage, dt_s: float, commands: FloatArray, starts: FloatArray, sizes: FloatArray, relative: float
) -> FloatArray:
    """(P, n, SAMPLES + 1) samples of P periods, each from its own states (P, n) under its own held command (P,)."""
    P, n = starts.shape
    rate_rad_s = 0.0 if stage.amplifier is None else stage.amplifier.rate_rad_s

    def rate(_: float, z: FloatArray) -> FloatArray:
        states = list(z.reshape(n, P))
        own, u = stage.split(states, commands)
        rates = stage.plant.rate(own, u, NUMPY)
        if stage.amplifier is not None:
            rates.append(rate_rad_s * (commands - u))
        return np.concatenate(rates)

    # The integrator bounds the root mean square of all errors: with the tolerance over sqrt(P), that of each period.
    relative = max(relative / P**0.5, LEAST_RELATIVE)
    offsets, samples = np.linspace(0.0, dt_s, SAMPLES + 1), np.full((SAMPLES + 1, n * P), np.nan)
    absolute = np.repeat(relative * ABSOLUTE * sizes, P)
    ends, begun = (0.0, dt_s), starts.T.ravel()
    if np.isfinite(rate(0.0, begun)).all():  # the integrator's first step does not end where there is no rate
        found = solve_ivp(rate, ends, begun, method="DOP853", t_eval=offsets, rtol=relative, atol=absolute)
        samples[: found.y.shape[1]] = found.y.T
    return np.moveaxis(samples.reshape(SAMPLES + 1, n, P), -1, 0).swapaxes(1, 2)


def _motion(stage: NonlinearStage, course: _Course) -> Motion:
    """(M, K) motion at all samples, without that of the encoder."""
    states = list(course.states.swapaxes(0, 1))
    _, u = stage.split(states, course.felt)
    rows = {name: np.einsum("j,mjk->mk", row, course.states) for name, row in stage.rows.items()}
    acceleration = np.asarray(stage.acceleration(states, course.felt, NUMPY))
    return Motion(acceleration, np.array(u), rows[VELOCITY], np.zeros(0), rows)


def _reached(course: _Course, motion: Motion, limit: Limit, posed: Played) -> tuple[FloatArray, FloatArray]:
    """(M,) largest absolute values that a limit bounds, in all and up to tau_(N-1)."""
    grid, taps, times_s = posed.grid, len(course.felt), course.times_s
    instants = np.append(grid.switching_times_s, grid.end_s)
    # A switching instant has two samples, just before and just after it; the later one has its command.
    first, over, last = 0, int(course.instants[grid.stages - 1]) + 1, times_s.size
    if not limit.after_the_waveform:
        first = int(np.searchsorted(times_s, grid.switching_times_s[0], side="left"))
        last = int(np.searchsorted(times_s, grid.end_s, side="right"))
    early, late = np.zeros(taps), np.zeros(taps)
    for row in limit.watched(posed):
        offset = row.offset
        if isinstance(offset, np.ndarray):
            offset = np.interp(times_s, instants[: offset.size], offset)
        values = np.abs(replace(row, offset=offset).value(motion, course.felt))
        early = np.maximum(early, values[:, first:over].max(axis=1) / row.share)
        late = np.maximum(late, values[:, over:last].max(axis=1, initial=0.0) / row.share)
    return np.maximum(early, late), early


def replay_nonlinear(problem: NonlinearProblem, commands: Sequence[FloatArray]) -> list[Replay]:
    """Play commands (N,) on the problem's nonlinear plant from rest, and compare them with its target and limits."""
    linear = problem.linear
    return played_nonlinear(problem.stage, linear.stage, linear.yardstick, linear.target, linear.limits, commands)


def played_nonlinear(
    stage: NonlinearStage,
    at_rest: StageModel,
    yardstick: Yardstick,
    target: Target,
    watched: Limits,
    commands: Sequence[FloatArray],
) -> list[Replay]:
    """Play commands (N,) on a nonlinear plant from rest.

    The temperatures are NaN, as no winding is simulated. `step_error` is the difference of y'' from a replay with a
    hundredfold tolerance, relative to its peak.

    Parameters
    ----------
    stage : plant and amplifier; its discrete steps over a period of the grid are a first guess and no more.
    at_rest : stage model of the plant linearised at rest, whose outputs the limits refer to.
    yardstick : rule by which figures are computed.
    target : target acceleration.
    watched : limits to check.
    """
    grid, played = yardstick.grid, np.stack(commands)
    N = grid.stages
    after = np.zeros(round(after_s(grid) / grid.dt_s))
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        # For a motion that diverges, the states up to the divergence give their sizes.
        states = [stage.states(np.append(each, after)) for each in played]
        if len(played) > 1 and not np.isfinite(states).all():
            # All commands share the integrator's steps, so a diverging one would end the others: play one by one.
            return [
                found
                for each in played
                for found in played_nonlinear(stage, at_rest, yardstick, target, watched, [each])
            ]
        peaks = np.max([np.nanmax(np.abs(each), axis=0) for each in states], axis=0)
        sizes = np.where(peaks > 0, peaks, 1.0)
        guess = np.stack(states)
        course, coarse = (_integrated(stage, grid, played, guess, sizes, by * RELATIVE) for by in (1.0, COARSER))
        run, other = (_motion(stage, each) for each in (course, coarse))
        found, before = (each.acceleration_m_s2[:, course.instants] for each in (run, other))
        error = np.abs(found - before).max(axis=1) / peak_scale(np.abs(found).max(axis=1), 0.0)
        posed = Played((at_rest,), grid, watched)
        reached = {limit.name: _reached(course, run, limit, posed) for limit in watched}
    later = course.times_s > grid.end_s
    samples = Samples(partial(Sampled, found, run.plant_input[:, course.instants[:N]], played))
    return [
        Replay(
            samples=samples,
            number=m,
            figures=yardstick.figures(target, found[m]),
            peak_input=float(np.abs(run.plant_input[m]).max()),
            peak_command=float(np.abs(played[m]).max()),
            after_peak_m_s2=float(np.abs(run.acceleration_m_s2[m, later]).max()),
            reached={name: float(whole[m]) for name, (whole, _) in reached.items()},
            reached_while_stated={name: float(early[m]) for name, (_, early) in reached.items()},
            winding_C=float("nan"),
            housing_C=float("nan"),
            scale_m_s2=float(peak_scale(np.abs(found[m, :N]).max(), 0.0)),
            step_error=float(error[m]),
        )
        for m in range(len(played))
    ]
