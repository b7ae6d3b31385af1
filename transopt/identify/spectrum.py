"""Experimental transfer-function estimate (ETFE) from several trials with swept sines (seed Sec. 4.1, Figs. 6, 7)."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import special

from transopt.base.errors import InputError
from transopt.base.signals import FloatArray, Signal

ComplexArray = NDArray[np.complex128]

BINS_PER_OCTAVE = 24
MOST_ORDER = 2  # of the local polynomial: curvature across a bin is followed, not averaged
LEAST_LINES_OF_TRANSIENT, ORDER_OF_TRANSIENT = 16, 1  # of each trial in a bin, from where its transient can be fitted
LEAST_SURPLUS = 3  # samples in a bin beyond the polynomial's coefficients, to estimate the noise from
EXCITED = 0.03  # of the strongest energy per octave: below, a bin counts as not excited
OCTAVES_OF_SPREAD = 0.5  # to either side: over which the scatter between trials is averaged
OCTAVES_OF_NOISE = 0.25  # the same, for the noise within them
ODD_ONE_OUT = 1e-3  # chance at which a bin's own noise is taken for higher than its neighbours'
SCATTERED = 1.5  # variance between trials over that within them, above which the trials' number counts
LEVEL = 0.95


@dataclass(frozen=True)
class Trial:
    """Input and output of one run, sample for sample on the same time grid.

    Attributes
    ----------
    name : what messages call it.
    input, output : (n,) samples each, from rest to rest; units are the owner's.

    Raises
    ------
    InputError : the two differ in rate or length, or the input never moves.
    """

    name: str
    input: Signal
    output: Signal

    def __post_init__(self) -> None:
        given, answer = self.input, self.output
        if given.values.size != answer.values.size or not np.isclose(given.dt_s, answer.dt_s, rtol=1e-9, atol=0):
            raise InputError(
                f"{self.name}: input {given.values.size} samples at {given.rate_Hz:g} Hz, output "
                f"{answer.values.size} at {answer.rate_Hz:g} Hz: must be on one time grid; record them together"
            )
        if np.ptp(given.values) == 0:
            raise InputError(f"{self.name}: the input stays at {given.values[0]:g}: no excitation; play the sweep")


@dataclass(frozen=True)
class TransferEstimate:
    """Sampled frequency response from input to output in bins of neighbouring lines of the spectrum.

    No line is in two bins, so the errors of different bins are independent. m bins, K trials.

    Attributes
    ----------
    frequencies_Hz : (m,) mean frequency of a bin's lines, strictly increasing.
    response : (m,) complex, at that frequency.
    deviation : (m,) standard deviation of its real and of its imaginary part.
    degrees : (m,) real degrees of freedom in `deviation`.
    coherence : (m,) in [0, 1]: the part of the output's power that the input explains, SNR / (1 + SNR).
    trial_responses : (K, m) complex, of each trial alone.
    dt_s : sampling period of the records.
    """

    frequencies_Hz: FloatArray
    response: ComplexArray
    deviation: FloatArray
    degrees: FloatArray
    coherence: FloatArray
    trial_responses: ComplexArray
    dt_s: float

    @property
    def trials(self) -> int:
        """K, number of trials."""
        return int(self.trial_responses.shape[0])

    def radius(self, level: float = LEVEL) -> FloatArray:
        """(m,) of the disc around `response` in the complex plane that holds the truth with that probability."""
        # |error|^2 / (2 deviation^2) is distributed as F(2, degrees), whose quantile is elementary.
        half = self.degrees / 2
        return np.asarray(self.deviation * np.sqrt(2 * half * ((1 - level) ** (-1 / half) - 1)))

    def half_width(self, level: float = LEVEL) -> FloatArray:
        """(m,) of the interval around any one component of the response, magnitude included."""
        return np.asarray(self.deviation * special.stdtrit(self.degrees, (1 + level) / 2))

    def magnitude_band(self, level: float = LEVEL) -> tuple[FloatArray, FloatArray]:
        """Lowest and highest magnitude, (m,) each, pointwise."""
        size, half = np.abs(self.response), self.half_width(level)
        return np.maximum(size - half, 0.0), size + half

    def phase_half_width_deg(self, level: float = LEVEL) -> FloatArray:
        """(m,) half the width of the phase's interval; 180 where the phase is not known at all."""
        ratio = self.half_width(level) / np.maximum(np.abs(self.response), np.finfo(float).tiny)
        return np.where(ratio < 1, np.degrees(np.arcsin(np.minimum(ratio, 1.0))), 180.0)

    def between(self, low_Hz: float, high_Hz: float) -> "TransferEstimate":
        """The bins from `low_Hz` to `high_Hz`.

        Raises
        ------
        InputError : there is none.
        """
        kept = (self.frequencies_Hz >= low_Hz) & (self.frequencies_Hz <= high_Hz)
        if not np.any(kept):
            span = f"{self.frequencies_Hz[0]:.4g} to {self.frequencies_Hz[-1]:.4g} Hz"
            raise InputError(f"no excitation from {low_Hz:g} to {high_Hz:g} Hz, only {span}; sweep further")
        return TransferEstimate(
            self.frequencies_Hz[kept],
            self.response[kept],
            self.deviation[kept],
            self.degrees[kept],
            self.coherence[kept],
            self.trial_responses[:, kept],
            self.dt_s,
        )


@dataclass(frozen=True)
class Bin:
    """Lines of all trials in one bin.

    Attributes
    ----------
    frequency_Hz : (s,).
    input : (s,) spectrum.
    outputs : (s, o) spectra.
    trial : (s,) number of the trial.
    """

    frequency_Hz: FloatArray
    input: ComplexArray
    outputs: ComplexArray
    trial: NDArray[np.int_]

    @property
    def places(self) -> FloatArray:
        """(s,) where the lines lie in the bin, from -1 to 1."""
        off = self.frequency_Hz - self.frequency_Hz.mean()
        return np.asarray(off / max(float(np.abs(off).max()), np.finfo(float).tiny))


def estimate_transfer(trials: Sequence[Trial]) -> TransferEstimate:
    """Frequency response by local polynomials over neighbouring lines and over trials.

    A record from rest to rest has an exact plain DFT: Y_j(f) = G(f) U_j(f) + V_j(f), without a window, and the noise
    V of different lines is independent. In a bin, G is a polynomial of at most second degree about the bin's mean
    frequency; its coefficients follow from least squares over all lines and trials in the bin. A bin is a 24th of an
    octave wide where the lines are dense; elsewhere it takes as many lines as it needs, one with at least four trials
    of one length. Bins count where the input's energy per octave is at least 3 % of its highest. Where a bin has
    lines enough, each trial has a transient of first degree beside it: what is missing of an answer that the end of
    the record cuts off (local polynomial method: Pintelon & Schoukens 2012, System Identification, Ch. 7).
    The polarity of a trial drops out, since Y and U change sign together; what does not change sign with the input,
    distortion of even order, cancels between trials of either polarity. Harmonics of a sweep arrive at other times
    than the fundamental, so that their phase turns from line to line: they count as noise and average out.

    The noise's variance is that of the residuals, a bin's own and its neighbours'. Where the trials scatter more than
    their own lines do (a hand is never held twice alike), variance and degrees of freedom are those between trials.

    Parameters
    ----------
    trials : at least one, at one rate; lengths and polarities may differ.

    Raises
    ------
    InputError : no trial, rates that differ, records too short.
    """
    if not trials:
        raise InputError("no trial at all; record at least one sweep")
    dt_s = trials[0].input.dt_s
    for trial in trials:
        if not np.isclose(trial.input.dt_s, dt_s, rtol=1e-4, atol=0):
            raise InputError(
                f"{trial.name}: {trial.input.rate_Hz:.6g} Hz, {trials[0].name} {trials[0].input.rate_Hz:.6g} Hz: "
                "must be one rate; record all trials at the servo's"
            )
    bins = bins_of([trial.input.values for trial in trials], [trial.output.values[None] for trial in trials], dt_s)
    if not bins:
        shortest = min(trial.input.values.size for trial in trials) * dt_s
        raise InputError(f"records of {shortest:g} s are too short for a spectrum; sweep longer")
    fitted = [_fit(one, len(trials)) for one in bins]
    frequencies = np.array([one.frequency_Hz.mean() for one in bins])
    response = np.array([fit[0] for fit in fitted])
    noise, leverage, surplus, coherence = (np.array([fit[j] for fit in fitted]) for j in (1, 2, 3, 4))
    each = np.array([fit[5] for fit in fitted]).T
    noise, degrees = pooled(frequencies, noise, 2.0 * surplus)
    variance = noise * leverage
    inflation, degrees = _between_trials(frequencies, each, variance, degrees)
    return TransferEstimate(
        frequencies_Hz=frequencies,
        response=response,
        deviation=np.sqrt(variance * inflation / 2),
        degrees=degrees,
        coherence=coherence,
        trial_responses=each,
        dt_s=dt_s,
    )


def bins_of(inputs: Sequence[FloatArray], outputs: Sequence[FloatArray], dt_s: float) -> list[Bin]:
    """All lines between 0 and half the rate, both exclusive, in bins of at least as many as a fit needs.

    Only bins where the input's energy per octave is at least 3 % of its highest, and those between two such.

    Parameters
    ----------
    inputs : (n,) of each trial.
    outputs : (o, n) of each trial.
    """
    lengths = [given.size for given in inputs]
    spacing = 1 / (min(lengths) * dt_s)
    needed = -(-(MOST_ORDER + 1 + LEAST_SURPLUS) // len(inputs))
    if max(lengths) != min(lengths):
        needed = max(needed, 2)  # lines of different trials at different frequencies: no mean without a slope
    spectra: list[tuple[FloatArray, ComplexArray, ComplexArray, NDArray[np.int_]]] = []
    for j, (given, answers) in enumerate(zip(inputs, outputs, strict=True)):
        lines = np.arange(1, (lengths[j] + 1) // 2)
        size = np.sqrt(lengths[j])  # noise of one variance whatever the length
        spectrum: ComplexArray = np.fft.rfft(given)[lines] / size
        read: ComplexArray = np.fft.rfft(answers)[:, lines].T / size
        spectra.append((lines / (lengths[j] * dt_s), spectrum, read, np.full(lines.size, j)))
    frequency = np.concatenate([one[0] for one in spectra])
    order = np.argsort(frequency, kind="stable")
    frequency = frequency[order]
    excitation = np.concatenate([one[1] for one in spectra])[order]
    answer = np.concatenate([one[2] for one in spectra])[order]
    trial_of = np.concatenate([one[3] for one in spectra])[order]
    bins: list[Bin] = []
    low = 0.5 * spacing
    while True:
        high = max(low * 2 ** (1 / BINS_PER_OCTAVE), low + needed * spacing)
        if high > 0.5 / dt_s:  # a rest of the lines just below half the rate would be a bin too small
            break
        inside = slice(*np.searchsorted(frequency, [low, high]).tolist())
        if trial_of[inside].size >= LEAST_SURPLUS + 1 and np.unique(trial_of[inside]).size == len(inputs):
            bins.append(Bin(frequency[inside], excitation[inside], answer[inside], trial_of[inside]))
        low = high
    middle = np.array([one.frequency_Hz.mean() for one in bins])
    energy = middle * np.array([np.mean(np.abs(one.input) ** 2) for one in bins])
    strong = np.flatnonzero(energy >= EXCITED * energy.max(initial=0.0))
    return bins[strong[0] : strong[-1] + 1] if strong.size else []


def _fit(one: Bin, trials: int) -> tuple[complex, float, float, int, float, ComplexArray]:
    """Response at the bin's mean; the noise's variance and the factor from it to E|error|^2; samples beyond the
    coefficients; coherence; (K,) responses by trial."""
    samples = one.frequency_Hz.size
    x, output = one.places, one.outputs[:, 0]
    distinct = np.unique(np.round(x, 9)).size
    order = min(MOST_ORDER, distinct - 1, samples - 1 - LEAST_SURPLUS)
    regressors = one.input[:, None] * x[:, None] ** np.arange(order + 1)
    lines = samples / trials
    if lines >= LEAST_LINES_OF_TRANSIENT:
        ends = [
            np.where(one.trial == j, x**power, 0.0) for j in range(trials) for power in range(ORDER_OF_TRANSIENT + 1)
        ]
        regressors = np.column_stack([regressors, *ends])
    Q, R = np.linalg.qr(regressors)
    inverse = np.linalg.pinv(R)
    projected = Q.conj().T @ output
    response = complex(inverse[0] @ projected)
    surplus = samples - regressors.shape[1]
    noise = float(np.sum(np.abs(output - Q @ projected) ** 2)) / surplus
    power = float(np.mean(np.abs(output) ** 2))
    coherence = min(max(1 - noise / power, 0.0), 1.0) if power > 0 else 0.0
    each = np.empty(trials, dtype=complex)
    for j in range(trials):
        of = one.trial == j
        columns = regressors.shape[1] if lines >= LEAST_LINES_OF_TRANSIENT else min(order + 1, int(of.sum()))
        each[j] = np.linalg.lstsq(regressors[of, :columns], output[of], rcond=None)[0][0]
    return response, noise, float(np.sum(np.abs(inverse[0]) ** 2)), surplus, coherence, each


def _around(frequencies_Hz: FloatArray, octaves: float) -> Callable[[FloatArray], FloatArray]:
    """Sums over the bins within so many octaves of each."""
    place = np.log2(frequencies_Hz)
    first, last = np.searchsorted(place, place - octaves), np.searchsorted(place, place + octaves, side="right")

    def summed(values: FloatArray) -> FloatArray:
        total = np.concatenate([[0.0], np.cumsum(values)])
        return np.asarray(total[last] - total[first])

    return summed


def pooled(frequencies_Hz: FloatArray, noise: FloatArray, degrees: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(m,) variances of the noise and their degrees of freedom, the neighbours' residuals taken in.

    A bin of few lines knows its noise badly, and weights that follow such luck make fits overconfident. A bin that
    stands out of its neighbours (the mains' hum) keeps its own.
    """
    summed = _around(frequencies_Hz, OCTAVES_OF_NOISE)
    together = summed(degrees)
    pooled = summed(noise * degrees) / together
    apart = noise > pooled * special.fdtri(degrees, together, 1 - ODD_ONE_OUT)
    return np.where(apart, noise, pooled), np.where(apart, degrees, together)


def _between_trials(
    frequencies_Hz: FloatArray, each: ComplexArray, variance: FloatArray, degrees: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """(m,) factor >= 1 on the variance, and (m,) degrees of freedom, from the scatter between the trials."""
    K = each.shape[0]
    if K < 3:
        return np.ones(variance.size), degrees
    scatter = np.sum(np.abs(each - each.mean(axis=0)) ** 2, axis=0) / (K * (K - 1))
    # One bin's scatter has few degrees of freedom: its ratio to the variance is averaged over its neighbours.
    ratio = scatter / np.maximum(variance, np.finfo(float).tiny)
    summed = _around(frequencies_Hz, OCTAVES_OF_SPREAD)
    factor = np.maximum(summed(ratio) / summed(np.ones(ratio.size)), 1.0)
    return factor, np.where(factor > SCATTERED, np.minimum(degrees, 2.0 * (K - 1)), degrees)
