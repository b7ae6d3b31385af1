"""The command that excites a device for identification; for a device on a port and for the simulator alike."""

import numpy as np

from transopt.base.errors import InputError
from transopt.base.signals import FloatArray

RISE_PART, RISE_PERIODS, FALL_PERIODS = 0.05, 0.5, 10.0
LEAST_SAMPLES = 16
TAP_S, TAP_FADES_S, TAP_HZ = 0.1, 5e-3, 120.0  # of a burst like a tap


def sweep_command(
    low_Hz: float,
    high_Hz: float,
    seconds: float,
    amplitude_A: float,
    dt_s: float,
    offset_A: float = 0.0,
) -> FloatArray:
    """Logarithmic swept sine around an offset, with smooth ends: sample k is the command held from k dt on.

    phi(t) = 2 pi f_1 L (exp(t / L) - 1), L = T / ln(f_2 / f_1) (Farina 2000): equal time per octave, so that the low
    frequencies, where a device needs it most, get their cycles. Sine and offset together rise as half a cosine over
    half a period of the lowest frequency and fall over ten of the highest, at most 5 % of the time each, so that the
    whole band but its outermost 2 % or so is played in full and nothing starts or ends with a bang. First and last
    sample are zero. The other polarity is the negative of the whole.

    Parameters
    ----------
    low_Hz, high_Hz : 0 < low < high < half the rate. seconds : at least one period of `low_Hz`.
    amplitude_A : > 0. offset_A : of the sine's middle, e.g. beyond an amplifier's crossover.

    Returns
    -------
    (N,) commands [A], N = round(seconds / dt); |c| <= |offset| + amplitude.

    Raises
    ------
    InputError : a number out of its range.
    """
    numbers = {
        "low": (low_Hz, " Hz"),
        "high": (high_Hz, " Hz"),
        "seconds": (seconds, " s"),
        "amplitude": (amplitude_A, " A"),
        "dt": (dt_s, " s"),
    }
    for name, (value, unit) in numbers.items():
        if not 0 < value < np.inf:
            raise InputError(f"sweep: {name} {value:g}{unit}: must be above 0 and finite")
    if not np.isfinite(offset_A):
        raise InputError(f"sweep: offset {offset_A:g} A: must be finite")
    if not high_Hz < 0.5 / dt_s:
        raise InputError(f"sweep: high {high_Hz:g} Hz: must be below half the servo's rate, {0.5 / dt_s:g} Hz")
    if not low_Hz < high_Hz:
        raise InputError(f"sweep: low {low_Hz:g} Hz: must be below high, {high_Hz:g} Hz")
    if not seconds * low_Hz >= 1 - 1e-9:
        raise InputError(
            f"sweep: seconds {seconds:g}: one period of {low_Hz:g} Hz takes {1 / low_Hz:g} s; sweep longer"
        )
    samples = round(seconds / dt_s)
    if samples < LEAST_SAMPLES:
        raise InputError(f"sweep: seconds {seconds:g}: {samples} samples are too few, at least {LEAST_SAMPLES}")
    times = dt_s * np.arange(samples)
    last = times[-1]
    spread = last / np.log(high_Hz / low_Hz)
    phase = 2 * np.pi * low_Hz * spread * np.expm1(times / spread)
    rise, fall = min(RISE_PART * last, RISE_PERIODS / low_Hz), min(RISE_PART * last, FALL_PERIODS / high_Hz)
    window = 0.25 * (1 - np.cos(np.pi * np.clip(times / rise, 0, 1)))
    window *= 1 - np.cos(np.pi * np.clip((last - times) / fall, 0, 1))
    return np.asarray(window * (offset_A + amplitude_A * np.sin(phase)))


def tap_command(peak_A: float, dt_s: float) -> FloatArray:
    """A burst like the transient of a tap: a decaying sine of 120 Hz, with which the device is met at full current.

    Parameters
    ----------
    peak_A : largest current, > 0.

    Returns
    -------
    (N,) commands [A] over 0.1 s, the first and the last zero.

    Raises
    ------
    InputError : the current is out of its range, or the servo too slow for such a burst.
    """
    if not 0 < peak_A < np.inf:
        raise InputError(f"tap: peak {peak_A:g} A: must be above 0 and finite")
    if not 0.1 / dt_s > TAP_HZ:
        raise InputError(f"tap: a servo of {1 / dt_s:g} Hz is too slow for a burst of {TAP_HZ:g} Hz")
    times = dt_s * np.arange(round(TAP_S / dt_s))
    burst = np.exp(-times / TAP_FADES_S) * np.sin(2 * np.pi * TAP_HZ * times)
    burst[-1] = 0.0
    return np.asarray(peak_A * burst / np.abs(burst).max())
