"""Experimental transfer-function estimate (ETFE) from several trials with swept sines (seed Sec. 4.1, Figs. 6, 7)."""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np

from transopt.base.errors import InputError
from transopt.base.signals import ComplexArray, FloatArray, Signal
from transopt.identify.condensed import Condensed, condense, pooled, summed_around
from transopt.identify.findings import Check, Finding, refuse
from transopt.identify.fit import LEVEL, quantile
from transopt.identify.measurement import Measurement

OCTAVES_OF_SPREAD = 0.5  # to either side of a bin over which the scatter between trials is averaged
SCATTERED = 1.5  # total variance over that within trials above which the number of trials sets the degrees of freedom
RATE_TOLERANCE = 1e-4


@dataclass(frozen=True)
class Trial:
    """Input and output of one run, sample for sample on the same time grid.

    Attributes
    ----------
    name : name in messages.
    input, output : (n,) samples each, from rest to rest, in units of the caller's choice.

    Raises
    ------
    InputError : input and output differ in rate or length, or the input is constant.
    """

    name: str
    input: Signal
    output: Signal

    @classmethod
    def of(cls, run: Measurement, given: str, answer: str) -> "Trial":
        """The trial from one quantity of a run to another, such as from its command to its current."""
        return cls(run.name, run.require(given), run.require(answer))

    def __post_init__(self) -> None:
        given, answer = self.input, self.output
        if given.values.size != answer.values.size or not np.isclose(given.dt_s, answer.dt_s, rtol=1e-9, atol=0):
            raise InputError(
                f"{self.name}: input {given.values.size} samples at {given.rate_Hz:g} Hz, output "
                f"{answer.values.size} at {answer.rate_Hz:g} Hz: must be on one time grid; record them together"
            )
        if np.ptp(given.values) == 0:
            raise InputError(f"{self.name}: the input stays at {given.values[0]:g}: no excitation; play the sweep")


def check_rates(trials: Sequence[Trial]) -> list[Finding]:
    """Find trials whose sampling rate differs from that of the first."""
    rate, first = trials[0].input.rate_Hz, trials[0].name
    return [
        Check.RATES.at(trial.name, rate_Hz=trial.input.rate_Hz, first=first, wanted_Hz=rate)
        for trial in trials
        if not np.isclose(trial.input.rate_Hz, rate, rtol=RATE_TOLERANCE, atol=0)
    ]


@dataclass(frozen=True)
class TransferEstimate:
    """Sampled frequency response from input to output in bins of neighbouring lines of the spectrum.

    The errors of different bins are independent. m bins, K trials.

    Attributes
    ----------
    frequencies_Hz : (m,) mean frequency of a bin's lines, strictly increasing.
    response : (m,) complex, at that frequency.
    deviation : (m,) standard deviation of its real and of its imaginary part.
    degrees : (m,) real degrees of freedom in `deviation`.
    coherence : (m,) in [0, 1]: the part of the output's power that the input explains, SNR / (1 + SNR).
    trial_responses : (K, m) complex response of each trial. Within a bin it differs from the response of all trials
        by one complex offset.
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

    def radius(self) -> FloatArray:
        """(m,) radius of the disc around `response` that holds the true response with probability `LEVEL`."""
        # |error|^2 / (2 deviation^2) is distributed as F(2, degrees), whose quantile is elementary.
        half = self.degrees / 2
        return np.asarray(self.deviation * np.sqrt(2 * half * ((1 - LEVEL) ** (-1 / half) - 1)))

    def half_width(self) -> FloatArray:
        """(m,) half width of the `LEVEL` interval of any one component of the response, magnitude included."""
        return np.asarray(self.deviation * quantile(self.degrees))

    def magnitude_band(self) -> tuple[FloatArray, FloatArray]:
        """Lower and upper end of the pointwise `LEVEL` interval of the magnitude, (m,) each."""
        size, half = np.abs(self.response), self.half_width()
        return np.maximum(size - half, 0.0), size + half

    def phase_half_width_deg(self) -> FloatArray:
        """(m,) half width of the `LEVEL` interval of the phase; 180 where the phase is unknown."""
        ratio = self.half_width() / np.maximum(np.abs(self.response), np.finfo(float).tiny)
        return np.where(ratio < 1, np.degrees(np.arcsin(np.minimum(ratio, 1.0))), 180.0)

    def over(self, response: ComplexArray) -> "TransferEstimate":
        """The estimate divided by a known response (m,)."""
        return replace(
            self,
            response=self.response / response,
            deviation=self.deviation / np.abs(response),
            trial_responses=self.trial_responses / response,
        )

    def between(self, low_Hz: float, high_Hz: float) -> "TransferEstimate":
        """The estimate restricted to the bins from `low_Hz` to `high_Hz`.

        Raises
        ------
        InputError : no bin lies in this band.
        """
        kept = (self.frequencies_Hz >= low_Hz) & (self.frequencies_Hz <= high_Hz)
        if not np.any(kept):
            span = f"{self.frequencies_Hz[0]:.4g} to {self.frequencies_Hz[-1]:.4g} Hz"
            raise InputError(f"no excitation from {low_Hz:g} to {high_Hz:g} Hz, only {span}; sweep further")
        return replace(self, **{part.name: getattr(self, part.name)[..., kept] for part in fields(self)[:-1]})


def condense_trials(trials: Sequence[Trial]) -> Condensed:
    """Condense the lines of all trials, from input to output.

    Parameters
    ----------
    trials : at least one, at one rate; lengths and polarities may differ.

    Raises
    ------
    InputError : there is no trial, the rates differ, or the records are too short.
    """
    if not trials:
        raise InputError("no trial at all; record at least one sweep")
    refuse(check_rates(trials))
    inputs, outputs = ([getattr(trial, part).values for trial in trials] for part in ("input", "output"))
    return condense(inputs, [one[None] for one in outputs], trials[0].input.dt_s)


def estimate_transfer(trials: Sequence[Trial]) -> TransferEstimate:
    """Frequency response from the input of the trials to their output: see `condense_trials` and `transfer`."""
    return transfer(condense_trials(trials))


def transfer(data: Condensed, output: int = 0, over: int | None = None) -> TransferEstimate:
    """Frequency response in the middle of each bin, from the input or from another output to an output.

    Another output has noise, unlike the input. The noise of the ratio is the one output less the response times the
    other; disturbances common to both outputs cancel in it.

    Where the trials scatter more than the lines within a trial (a hand is never held twice alike), variance and
    degrees of freedom are those between trials.

    Parameters
    ----------
    output : index of the output whose response is estimated.
    over : index of the output that the response is referred to; None for the input.
    """
    if over is not None:
        data = data.moved()  # elsewhere the ratio of two outputs is a ratio of their noise
    values, middle = data.values(), data.middle
    together = np.einsum("bi,obi->ob", middle, values)
    # Each trial's response is that of all trials plus an offset: the one that fits the lines of this trial best.
    level = data.normal.sum(axis=(2, 3)).real
    level = np.maximum(level, np.finfo(float).eps * level.max(axis=0))  # > 0 for a trial without excitation here
    own = (data.right - np.einsum("kbij,obj->kobi", data.normal, values)).sum(axis=3) / level[:, None]
    each, row = together + own, np.zeros((together.shape[1], together.shape[0]), dtype=complex)
    row[:, output] = 1.0
    response, by_trial, scale = together[output], each[:, output], np.ones(together.shape[1])
    if over is not None:
        response, by_trial = response / together[over], by_trial / each[:, over]
        row[:, over], scale = -response, np.abs(together[over]) ** 2
    noise = np.einsum("bo,bop,bp->b", row, data.residual, row.conj()).real
    coherence = 1 - noise / np.maximum(data.power[output], np.finfo(float).tiny)
    noise, degrees = pooled(data.middles_Hz, noise, 2 * data.surplus)
    leverage = np.einsum("bi,bi->b", middle, np.linalg.solve(data.whole, middle[..., None])[..., 0]).real
    variance = noise * leverage / scale
    more = _between_trials(data.middles_Hz, by_trial, noise * np.mean(1 / level, axis=0) / scale)
    few = np.minimum(degrees, 2.0 * (by_trial.shape[0] - 1))
    degrees = np.where(variance + more > SCATTERED * variance, few, degrees)
    variance = variance + more
    return TransferEstimate(
        frequencies_Hz=data.middles_Hz,
        response=np.asarray(response),
        deviation=np.sqrt(variance / 2),
        degrees=degrees,
        coherence=np.where(data.power[output] > 0, np.clip(coherence, 0.0, 1.0), 0.0),
        trial_responses=np.asarray(by_trial),
        dt_s=data.dt_s,
    )


def _between_trials(frequencies_Hz: FloatArray, by_trial: ComplexArray, variance: FloatArray) -> FloatArray:
    """(m,) variance of the mean over the trials (K, m) in excess of that of noise, `variance` for one trial.

    The scatter within one bin has few degrees of freedom, so its ratio to the noise is averaged over neighbours.
    """
    K = by_trial.shape[0]
    if K < 3:
        return np.zeros(variance.size)
    scatter = np.sum(np.abs(by_trial - by_trial.mean(axis=0)) ** 2, axis=0) / (K - 1)
    summed = summed_around(frequencies_Hz, OCTAVES_OF_SPREAD)
    ratio = summed(scatter / np.maximum(variance, np.finfo(float).tiny)) / summed(np.ones(variance.size))
    return np.asarray(np.maximum(ratio - 1, 0.0) * variance / K)
