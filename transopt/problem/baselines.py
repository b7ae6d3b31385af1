"""The two baselines with which every table compares the optimum: the seed's inversion and the clipped optimum."""

import numpy as np

from transopt.base.signals import AnyArray, FloatArray, fast_length, splined
from transopt.plant.amplifier import prefilter
from transopt.plant.discretise import StageModel
from transopt.plant.time_grid import TimeGrid
from transopt.problem.problem import TransientProblem

PADDING = 2  # the record is zero-padded to this multiple of its length
REST_S = 2e-3  # span before contact over which the mean of the wanted current is set to zero


def seed_inversion(
    stage: StageModel,
    grid: TimeGrid,
    reference_m_s2: FloatArray,
    current_limit_A: float | FloatArray,
    taper_samples: int,
) -> FloatArray:
    """The seed's method (Sec. 6): invert the model, taper, clip the wanted current, prefilter.

    The inverse I = R / G is taken in the frequency domain over the zero-padded record and sampled at the ticks t_k.
    As in the seed, neither the hold nor the amplifier's delay is compensated. G vanishes at 0 Hz, so the mean current
    is undetermined: it is set so that no current flows before contact, the choice in favour of this baseline.

    Parameters
    ----------
    reference_m_s2 : (..., N), or (p, N) for a plant with p directions, whose response matrix is inverted.
    current_limit_A : a number, or an array that broadcasts against the references.

    Returns
    -------
    (..., N) commands [A] in the broadcast shape, tapered to zero over the last `taper_samples`.
    """
    N = grid.stages
    at_ticks = splined(grid.switching_times_s, reference_m_s2, grid.issue_times_s)
    length = fast_length(PADDING * N)
    frequencies = np.fft.rfftfreq(length, grid.dt_s).astype(float)
    spectrum = np.fft.rfft(at_ticks, length)
    courses = (stage.motors,) if stage.motors > 1 else spectrum.shape[:-1]
    current = np.zeros((*courses, spectrum.shape[-1]), dtype=complex)
    current[..., 1:] = _inverted(spectrum[..., 1:], stage.plant.response(frequencies[1:]))
    periodic = np.fft.irfft(current, length)
    wanted = periodic[..., :N] - periodic[..., -max(round(REST_S / grid.dt_s), 1) :].mean(axis=-1, keepdims=True)
    wanted[..., -taper_samples:] *= 0.5 * (1 + np.cos(np.pi * np.arange(1, taper_samples + 1) / taper_samples))
    wanted = np.clip(wanted, -current_limit_A, current_limit_A)
    return _play(stage, grid, wanted)


def _inverted(spectrum: AnyArray, response: AnyArray) -> AnyArray:
    """Currents (..., F) or (m, F) for accelerations (..., F) or (p, F), by the inverse of the response.

    The response is (F,), or (F, p, m), whose matrices are pseudo-inverted.
    """
    if response.ndim == 1:
        return np.asarray(spectrum / response)
    return np.asarray(np.einsum("fmp,pf->mf", np.linalg.pinv(response), np.atleast_2d(spectrum)))


def clipped_optimum(
    stage: StageModel, grid: TimeGrid, unlimited_command: FloatArray, current_limit_A: float | FloatArray
) -> FloatArray:
    """The optimum without limits, (..., N), with its current clipped; hold and delay are compensated exactly.

    Each of several motors, (m, N), is clipped separately.

    Parameters
    ----------
    current_limit_A : a number, or an array that broadcasts against the commands.

    Returns
    -------
    (..., N) commands [A] in the broadcast shape.
    """
    _, current = stage.rollout(unlimited_command)
    wanted = np.clip(current, -current_limit_A, current_limit_A)
    if stage.amplifier is None:
        return wanted
    # c_k drives the current from tau_k to tau_(k+1); the last command is zero, as in every waveform.
    after = _play(stage, grid, wanted[..., 1:])
    return np.concatenate([after, np.zeros((*after.shape[:-1], 1))], axis=-1)


def input_bounds(problem: TransientProblem) -> FloatArray:
    """(m, 1) largest size that the plant's input may have at each motor."""
    return np.array([[float(np.max(row.upper))] for row in problem.limits.input.rows(problem)])


def _play(stage: StageModel, grid: TimeGrid, wanted: FloatArray) -> FloatArray:
    """(..., N) commands whose current through the amplifier is the wanted one, clipped to the command's range."""
    if stage.amplifier is None:
        return wanted
    bound = stage.amplifier.command_limit
    return np.clip(prefilter(wanted, stage.amplifier, grid.dt_s), -bound, bound)
