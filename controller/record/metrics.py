"""Metrics of a played tap: latency, error after alignment, spectral error, rate-hardness."""

from dataclasses import dataclass

import numpy as np
import scipy

from transopt.base.signals import FloatArray, nrmse

MOST_SHIFT_S = 1e-3
SHIFT_STEP_S = 2e-5  # step of the first search, well within the pulse's width
SHIFT_TOLERANCE_S = 1e-9
BANDS_HZ = 10.0 ** (np.arange(10, 31) / 10)  # third octaves, 10 Hz to 1 kHz (IEC 61260, base ten)
BAND_EDGE = 10.0**0.05
BAND_FLOOR_DB = -40.0  # level below the strongest band of the reference at which weaker bands are clipped
SPECTRUM_HZ = 0.1  # resolution to which the spectrum is interpolated by zero padding
RATE_WINDOW_S = 1e-3  # averaging time of the rate of force: ten servo steps
RATE_WITHIN_S = 5e-3  # time from contact that counts as initial


@dataclass(frozen=True)
class Aligned:
    """A played acceleration aligned with a predicted one.

    Attributes
    ----------
    latency_s : the shift, positive if played later. nrmse : relative rms error after the shift.
    played_m_s2 : (N,) played acceleration, shifted back by the latency, at the times of the prediction.
    """

    latency_s: float
    nrmse: float
    played_m_s2: FloatArray


def align(times_s: FloatArray, played_m_s2: FloatArray, at_s: FloatArray, predicted_m_s2: FloatArray) -> Aligned:
    """Align by the shift |s| <= 1 ms that minimises the mean square of played(t + s) - predicted(t).

    Parameters
    ----------
    times_s, played_m_s2 : (K,) any increasing times that reach 1 ms beyond `at_s` on both sides; interpolated by a
        cubic spline.
    at_s, predicted_m_s2 : (N,).
    """
    spline = scipy.interpolate.CubicSpline(times_s, played_m_s2)
    size = max(float(predicted_m_s2 @ predicted_m_s2), np.finfo(float).tiny)

    def error(shift_s: float) -> float:
        difference = spline(at_s + shift_s) - predicted_m_s2
        return float(difference @ difference) / size

    shifts = np.arange(-MOST_SHIFT_S, MOST_SHIFT_S + SHIFT_STEP_S / 2, SHIFT_STEP_S)
    errors = [error(shift) for shift in shifts]
    best = float(shifts[int(np.argmin(errors))])
    bounds = (max(best - SHIFT_STEP_S, -MOST_SHIFT_S), min(best + SHIFT_STEP_S, MOST_SHIFT_S))
    found = scipy.optimize.minimize_scalar(
        error, bounds=bounds, method="bounded", options={"xatol": SHIFT_TOLERANCE_S}
    )
    shift = float(found.x)
    moved = np.asarray(spline(at_s + shift))
    return Aligned(shift, nrmse(moved, predicted_m_s2), moved)


def band_levels_dB(signal: FloatArray, dt_s: float) -> FloatArray:
    """(21,) energy of a transient (N,) in the third octaves from 10 Hz to 1 kHz, re 1."""
    n = int(np.ceil(1 / (SPECTRUM_HZ * dt_s)))
    energy = np.abs(np.fft.rfft(signal, n)) ** 2
    frequencies = np.fft.rfftfreq(n, dt_s)
    bands = [energy[(frequencies >= f / BAND_EDGE) & (frequencies < f * BAND_EDGE)].sum() for f in BANDS_HZ]
    return np.asarray(10 * np.log10(np.maximum(bands, np.finfo(float).tiny)))


def spectral_error_dB(played: FloatArray, reference: FloatArray, dt_s: float) -> float:
    """Rms over the third octaves from 10 Hz to 1 kHz of the difference of their energies in dB.

    Both are clipped from below at 40 dB under the reference's strongest band, so that quiet bands compare as equal.
    """
    wanted = band_levels_dB(reference, dt_s)
    floor = wanted.max() + BAND_FLOOR_DB
    difference = np.maximum(band_levels_dB(played, dt_s), floor) - np.maximum(wanted, floor)
    return float(np.sqrt(np.mean(difference**2)))


def rate_hardness_N_m(times_s: FloatArray, force_N: FloatArray, speed_m_s: float) -> float:
    """Initial rate of change of force over initial penetration velocity (Lawrence et al. 2000) [(N/s)/(m/s)].

    The rate is the largest mean over 1 ms that begins within 1 ms before and 5 ms after contact at t = 0. The force
    is what stops the device at the surface: of a real object its contact force, of a rendered one the motor's
    k_f i at the tip.
    """
    starts = np.arange(-RATE_WINDOW_S, RATE_WITHIN_S, RATE_WINDOW_S / 20)
    rise = np.interp(starts + RATE_WINDOW_S, times_s, force_N) - np.interp(starts, times_s, force_N)
    return float(rise.max() / RATE_WINDOW_S / speed_m_s)
