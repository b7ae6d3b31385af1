"""Iterative learning control from taps: the correction of the model's reference that makes the device follow r.

A tap is repeated, so the deviation of the device from its prediction repeats too: a = p + w, with p the model's
acceleration for the played command. The next command is the optimum, under the same limits, for the reference r + d,

    d' = Q (d - L H u),

with the gain L, 0 < L <= 1, a zero-phase low-pass Q, and H the significant share of u, 0 <= H <= 1
(`significance`). u is the error of the device. Where no limit binds, u = a - p_0 with p_0 the acceleration of the
model's own optimum for r; for p = r + d, p_0 = r and H = 1 this is the usual rule r + d' = r + Q (d + L e) with
e = r - a. Where limits bind, u = d + w: p is what the limits allow, and d stays bounded, while e would be summed up
endlessly (integrator wind-up). With T = a / p, from model to device, the error of d is multiplied per round by at
most

    unlimited     |Q (1 - L T)|
    limits bind   |Q| (1 - L + L |1 - T|), since the optimum under limits is a projection, which is nonexpansive

at every frequency; below 1 the rounds converge (Bristow, Tharayil and Alleyne 2006, "A survey of iterative learning
control"; with constraints Schoellig, Mueller and D'Andrea 2012). H < 1 brings both factors nearer to 1, never above.
T and its uncertainty are measured, and Q cuts off where convergence is no longer certain.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from transopt.base.filters import lowpass
from transopt.base.signals import ComplexArray, FloatArray, Signal

POINTS = 4096  # length of the Fourier transforms
SMOOTHING_HZ = 40.0  # half-width of the frequency average: the resolution of 30 ms
LOWEST_HZ = 20.0  # below it a window of 30 ms holds no whole period
HIGHEST_HZ = 1000.0  # cutoff of the low-pass on measured accelerations
LARGEST_FACTOR = 0.9  # largest factor of the error per round, uncertainty included
NARROWEST_HZ = 60.0  # a Q with a lower cutoff would leave next to nothing of a tap
SIGMAS = 2.0
LEAST_GAIN = 0.1


@dataclass(frozen=True)
class Ratio:
    """T = a / p, the ratio of the device's acceleration to the model's; (m,) each.

    Attributes
    ----------
    deviation : standard deviation of T, from the scatter of the taps about it.
    """

    frequencies_Hz: FloatArray
    value: ComplexArray
    deviation: FloatArray


def _smooth(values: ComplexArray | FloatArray, bins: int) -> ComplexArray:
    kernel = scipy.signal.windows.hann(2 * bins + 1)
    padded = np.pad(values, bins, mode="reflect")
    return np.asarray(np.convolve(padded, kernel / kernel.sum(), mode="valid"), dtype=complex)


def ratio(predicted_m_s2: Sequence[FloatArray], measured_m_s2: Sequence[FloatArray], dt_s: float) -> Ratio:
    """Least squares over all taps of a grip: T = sum of A P* / sum of |P|^2, averaged over neighbouring frequencies.

    Parameters
    ----------
    predicted_m_s2, measured_m_s2 : one (n,) each per tap, on one time axis, equally filtered; at least two taps.
    """
    P = np.fft.rfft(np.stack(predicted_m_s2), POINTS)
    A = np.fft.rfft(np.stack(measured_m_s2), POINTS)
    frequencies = np.asarray(np.fft.rfftfreq(POINTS, dt_s), dtype=float)
    bins = max(round(SMOOTHING_HZ / float(frequencies[1])), 1)
    power = np.maximum(_smooth((np.abs(P) ** 2).sum(axis=0), bins).real, np.finfo(float).tiny)
    value = _smooth((A * P.conj()).sum(axis=0), bins) / power
    scatter = _smooth((np.abs(A - value * P) ** 2).sum(axis=0), bins).real
    deviation = np.sqrt(scatter / (len(A) - 1) / power)
    band = (frequencies >= LOWEST_HZ) & (frequencies <= HIGHEST_HZ)
    return Ratio(frequencies[band], value[band], deviation[band])


def factors(found: Ratio, gain: float, *, limited: bool) -> FloatArray:
    """(m,) largest factor of the error per round, without Q, for T as measured."""
    if limited:
        return np.asarray(1 - gain + gain * np.abs(1 - found.value))
    return np.asarray(np.abs(1 - gain * found.value))


@dataclass(frozen=True)
class Condition:
    """The convergence condition of one node, as measured.

    Attributes
    ----------
    cutoff_Hz : cutoff of Q. factor : largest |Q| times `factors` over all frequencies; below 1 the rounds converge.
    sure_factor : the same with two standard deviations of T added.
    """

    gain: float
    cutoff_Hz: float
    factor: float
    sure_factor: float

    @property
    def met(self) -> bool:
        return self.sure_factor < 1


def through_q(frequencies_Hz: FloatArray, cutoff_Hz: float) -> FloatArray:
    """(m,) gain of `transopt.base.signals.lowpass`: a second-order Butterworth run forwards and backwards."""
    return np.asarray(1 / (1 + (frequencies_Hz / cutoff_Hz) ** 4))


def condition(found: Ratio, gain: float, *, limited: bool) -> Condition:
    """The widest Q with which a round certainly reduces the error, and the factors.

    Q cuts off half an octave below the first frequency at which the factor may exceed `LARGEST_FACTOR`.
    """
    f = found.frequencies_Hz
    nominal = factors(found, gain, limited=limited)
    sure = nominal + SIGMAS * gain * found.deviation
    doubtful = np.flatnonzero(sure > LARGEST_FACTOR)
    end = f[doubtful[0]] if doubtful.size else f[-1]
    cutoff = max(float(end) / 2**0.5, NARROWEST_HZ)
    Q = through_q(f, cutoff)
    return Condition(gain, cutoff, float((Q * nominal).max()), float((Q * sure).max()))


def widest(found: Ratio, gain: float, *, limited: bool) -> Condition:
    """The condition at the largest of gain, gain / 2, gain / 4, ... at which it is met.

    If it is met at none of them, the unmet condition at the gain itself.
    """
    halved = gain
    while halved >= LEAST_GAIN:
        known = condition(found, halved, limited=limited)
        if known.met:
            return known
        halved /= 2
    return condition(found, gain, limited=limited)


def corrected(
    correction_m_s2: FloatArray, change_m_s2: FloatArray, dt_s: float, cutoff_Hz: float, fade: FloatArray
) -> FloatArray:
    """(N,) d' = Q (d - L H u), faded out at the end of the measured window.

    Parameters
    ----------
    correction_m_s2 : (N,) d.
    change_m_s2 : (N,) L H u, gain times significant share times error of the device.
    cutoff_Hz : cutoff of Q.
    fade : (N,) 1 within the measured window, falling to 0.
    """
    mixed = fade * (correction_m_s2 - change_m_s2)
    return np.asarray(fade * lowpass(Signal(0.0, dt_s, mixed), cutoff_Hz).values)
