"""The two methods that the optimum is compared with in every table."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from transopt.base.signals import FloatArray, fast_length, splined
from transopt.plant.amplifier import prefilter
from transopt.plant.discretise import StageModel, TimeGrid

PADDING = 2  # the record is zero-padded to this many times its length
REST_S = 2e-3  # before the first tick, where the wanted current is zero


def seed_inversion(
    stage: StageModel,
    grid: TimeGrid,
    reference_m_s2: FloatArray,
    current_limit_A: float | FloatArray,
    taper_samples: int,
) -> FloatArray:
    """The seed's method (Sec. 6): invert the model, taper, clip the wanted current, prefilter.

    Frequency-domain inverse I = R / G over the whole zero-padded record, sampled at the ticks t_k; neither the
    hold nor the amplifier's delay is compensated, as in the seed. G vanishes at 0 Hz, which leaves the mean
    current open: it is chosen so that no current flows before contact, which favours this method.

    Parameters
    ----------
    reference_m_s2 : (..., N), or (p, N) of a plant with several directions, whose response is inverted as a matrix.
    current_limit_A : one, or several that broadcast against the references.

    Returns
    -------
    (..., N) commands [A], of their common shape, faded out over the last `taper_samples`.
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


def _inverted(spectrum: NDArray[Any], response: NDArray[Any]) -> NDArray[Any]:
    """Currents (..., F), or (m, F), that make accelerations (..., F), or (p, F), of a response (F,) or (F, p, m)."""
    if response.ndim == 1:
        return np.asarray(spectrum / response)
    return np.asarray(np.einsum("fmp,pf->mf", np.linalg.pinv(response), spectrum))


def clipped_optimum(
    stage: StageModel, grid: TimeGrid, unlimited_command: FloatArray, current_limit_A: float | FloatArray
) -> FloatArray:
    """The unlimited optimum (..., N) with its current cut at the limit, hold and delay compensated exactly.

    Of several motors, (m, N), each current is cut by itself.

    Parameters
    ----------
    current_limit_A : one, or several that broadcast against the commands.

    Returns
    -------
    (..., N) commands [A], of their common shape.
    """
    _, current = stage.rollout(unlimited_command)
    wanted = np.clip(current, -current_limit_A, current_limit_A)
    if stage.amplifier is None:
        return wanted
    # c_k carries the current from tau_k to tau_(k+1); the last command is zero, as in every waveform.
    after = _play(stage, grid, wanted[..., 1:])
    return np.concatenate([after, np.zeros((*after.shape[:-1], 1))], axis=-1)


def _play(stage: StageModel, grid: TimeGrid, wanted: FloatArray) -> FloatArray:
    if stage.amplifier is None:
        return wanted
    bound = stage.amplifier.command_limit
    return np.clip(prefilter(wanted, stage.amplifier, grid.dt_s), -bound, bound)
