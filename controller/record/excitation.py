"""Commands that excite a device for identification, on a port or in the simulator."""

import numpy as np

from transopt.base.errors import InputError
from transopt.base.signals import FloatArray
from transopt.base.writing import rounded_up

RISE_PART, RISE_PERIODS, FALL_PERIODS = 0.05, 0.5, 10.0
LEAST_SAMPLES = 16
TAP_S, TAP_FADES_S, TAP_HZ = 0.1, 5e-3, 120.0  # duration, decay time and frequency of a burst like a tap
PERIOD_S, PERIODS, FADE_S = 0.4, 4, 50e-3  # multisine; its first period is the device's transient
LOWEST_HZ, HIGHEST_HZ, LINES = 10.0, 1000.0, 90  # range and number of its lines, equally many per octave
DRAWINGS, PHASES = 100, 3  # number of random draws of the phases, and their seed


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
            f"sweep: seconds {seconds:g} s: must be {rounded_up(1 / low_Hz):g} s or more, one period of low "
            f"{low_Hz:g} Hz: give --seconds {rounded_up(1 / low_Hz):g} or a higher --low"
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
    """A burst like the transient of a tap: a decaying sine of 120 Hz, which excites the device at full current.

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


def multisine_period_s(dt_s: float) -> float:
    """Period of `multisine_command`: whole samples, about 0.4 s."""
    return round(PERIOD_S / dt_s) * dt_s


def multisine_command(peak_A: float, dt_s: float) -> FloatArray:
    """A periodic multisine of odd harmonics: any response at other lines is distortion or noise.

    A linear device responds at excited lines only. An odd nonlinearity (friction, backlash, saturation) responds at
    all odd lines, an even one (unequal stiffness to either side) at even lines. So every third odd line and all even
    ones are left out as detection lines (Pintelon & Schoukens 2012, System Identification, Ch. 4). Of a hundred
    random draws of the phases the one with the lowest peak is taken.

    Parameters
    ----------
    peak_A : largest current, > 0.

    Returns
    -------
    (N,) commands [A]: whole periods of `multisine_period_s`, the first faded in, and 50 ms of a further one, faded
    out; the first and the last are zero.

    Raises
    ------
    InputError : the current is out of its range, or the servo too slow for such lines.
    """
    if not 0 < peak_A < np.inf:
        raise InputError(f"multisine: peak {peak_A:g} A: must be above 0 and finite")
    if not 0.5 / dt_s > HIGHEST_HZ:
        raise InputError(f"multisine: a servo of {1 / dt_s:g} Hz is too slow for lines up to {HIGHEST_HZ:g} Hz")
    samples = round(PERIOD_S / dt_s)
    wanted = np.geomspace(LOWEST_HZ, HIGHEST_HZ, LINES) * samples * dt_s
    odd = np.unique(2 * np.round((wanted - 1) / 2).astype(int) + 1)
    lines = np.delete(odd, slice(2, None, 3))
    random = np.random.default_rng(PHASES)
    spectra = np.zeros((DRAWINGS, samples // 2 + 1), dtype=complex)
    spectra[:, lines] = np.exp(2j * np.pi * random.uniform(size=(DRAWINGS, lines.size)))
    waves = np.fft.irfft(spectra, samples)
    best = waves[int(np.argmin(np.abs(waves).max(axis=1)))]
    wave = np.tile(peak_A / float(np.abs(best).max()) * best, PERIODS + 1)
    fade = max(round(FADE_S / dt_s), 2)
    wave = wave[: PERIODS * samples + fade]
    rising = 0.5 * (1 - np.cos(np.pi * np.arange(fade) / (fade - 1)))
    wave[:fade] *= rising
    wave[-fade:] *= rising[::-1]
    return np.asarray(wave)
