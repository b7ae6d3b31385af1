"""Iterative learning from taps on the device: what to ask of the model so that the device makes r.

A tap is repeated, so what the device does beside its prediction comes back: a = p + w with p the model's acceleration
for the command that was played. The next command is the optimum, under the same limits, for the reference r + d,

    d' = Q (d - L H u),

with the gain L, 0 < L <= 1, Q a zero-phase low-pass, and H the part of u that stands out of the scatter of the
taps, 0 <= H <= 1 (`significance`). u is what the device is off by. Where no limit binds that is u = a - p_0 with
p_0 what the model's own optimum for r makes, and with p = r + d, p_0 = r and H = 1 the rule is the usual r + d' = r
+ Q (d + L e), e = r - a. Where limits bind, u = d + w: p is what the limits leave, and d stays bounded; e would be
summed up for ever there (integrator wind-up). With T = a / p, from model to device, the error of d shrinks per
round by

    unlimited     |Q (1 - L T)|
    limits bind   |Q| (1 - L + L |1 - T|), as the optimum under limits is a projection: it brings nothing apart

at most, in every frequency; below 1 the rounds converge (Bristow, Tharayil and Alleyne 2006, "A survey of iterative
learning control"; with constraints Schoellig, Mueller and D'Andrea 2012). H in the place of 1 brings both nearer to
1, and never beyond it. T and its uncertainty are measured, and Q ends where this is no longer sure.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from transopt.base.filters import lowpass
from transopt.base.signals import FloatArray, Signal

POINTS = 4096  # of the spectra
SMOOTHING_HZ = 40.0  # half-width of the frequency average: what 30 ms can resolve
LOWEST_HZ = 20.0  # below, a window of 30 ms sees no period
HIGHEST_HZ = 1000.0  # where what is measured is low-passed
LARGEST_FACTOR = 0.9  # that a round may leave of the error, with the uncertainty on top
NARROWEST_HZ = 60.0  # a Q below this would leave nothing of a tap
SIGMAS = 2.0
LEAST_GAIN = 0.1


@dataclass(frozen=True)
class Ratio:
    """T = a / p, what the device makes of the model's acceleration; (m,) each.

    Attributes
    ----------
    deviation : standard deviation of T, from the scatter of the taps about it.
    """

    frequencies_Hz: FloatArray
    value: NDArray[np.complex128]
    deviation: FloatArray


def _smooth(values: NDArray[np.complex128] | FloatArray, bins: int) -> NDArray[np.complex128]:
    kernel = scipy.signal.windows.hann(2 * bins + 1)
    padded = np.pad(values, bins, mode="reflect")
    return np.asarray(np.convolve(padded, kernel / kernel.sum(), mode="valid"), dtype=complex)


def ratio(predicted_m_s2: Sequence[FloatArray], measured_m_s2: Sequence[FloatArray], dt_s: float) -> Ratio:
    """Least squares over all taps of a grip: T = sum of A P* / sum of |P|^2, averaged over some frequencies.

    Parameters
    ----------
    predicted_m_s2, measured_m_s2 : one (n,) each per tap, on one time axis, filtered alike; at least two taps.
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
    """(m,) what a round leaves of the error at most, without Q, at T as measured."""
    if limited:
        return np.asarray(1 - gain + gain * np.abs(1 - found.value))
    return np.asarray(np.abs(1 - gain * found.value))


@dataclass(frozen=True)
class Condition:
    """The convergence condition of one node, as measured.

    Attributes
    ----------
    cutoff_Hz : of Q. factor : largest |Q| times `factors` over all frequencies; it converges if below 1.
    sure_factor : the same with two standard deviations of T on top.
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
    """The widest Q with which a round surely shrinks the error, and by how much.

    Q ends half an octave before the first frequency at which a round might leave more than `LARGEST_FACTOR` of it.
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
    """The condition at the gain, or at the first half of it, a quarter and so on at which it is met.

    If it is met at none of them, that at the gain itself, which says so.
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
    """(N,) d' = Q (d - L H u), faded out where nothing was measured any more.

    Parameters
    ----------
    correction_m_s2 : (N,) d.
    change_m_s2 : (N,) L H u, of what the device is off by the part that stands out of the scatter.
    cutoff_Hz : of Q.
    fade : (N,) 1 over what was measured, falling to 0.
    """
    mixed = fade * (correction_m_s2 - change_m_s2)
    return np.asarray(fade * lowpass(Signal(0.0, dt_s, mixed), cutoff_Hz).values)
