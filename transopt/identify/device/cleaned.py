"""Remove from records what is not the device's response: a pure delay, a drift of clocks, and leakage of slow motion.

Current and acceleration often come from two instruments: a DAQ that starts later, a wireless sensor, a filter of
linear phase. No device responds that late, and no chain of masses can be fitted: a delay of 50 ms leaves 94 % of the
response unexplained. The delay is where the nominal device's response to the current best matches the record.

Two instruments also have two clocks. The acceleration y(t (1 + p)) is read in place of y(t), and p = 20 ppm is 0.4
samples after 2 s at 10 kHz, which a fit explains by a false pole of the accelerometer. To first order the record
gains p t y'(t), a further column beside the slopes of the chain: one Gauss-Newton step finds p with its deviation.

A record ends amid a hand's tremor or a drift. To the Fourier transform that is a jump from the record's end to its
beginning, whose lines fall off only in proportion to 1 / frequency: they vary slowly over the bins, look like a
response to the input, and in a few trials may agree by chance. The slow motion is the residual of a first model below
`SLOW_HZ`; its lines above `TAKEN_HZ` are leakage only, and are subtracted. Lines below stay unchanged.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import fft, interpolate

from transopt.base.signals import FloatArray, Signal
from transopt.identify.condensed import condense
from transopt.identify.device.chain import ChainSearch, GripResponse
from transopt.identify.device.chain_fit import SIGNIFICANT, ChainFit
from transopt.identify.device.response import ACCELERATION, CURRENT, INSTRUMENT, Instrument, sampled_response
from transopt.identify.device.trials import Grip, felt_current, response_of
from transopt.identify.device.validation import Model, predict
from transopt.identify.findings import Check, Finding, beside
from transopt.identify.measurement import Measurement
from transopt.identify.squares import inverse
from transopt.plant.amplifier import Amplifier
from transopt.plant.state_space import StateSpace

LEAST_S = 2e-3  # a shorter delay could be the device's own, which the model's amplifier and hold account for
LONGEST_S = 0.5  # longest delay searched
CLEARLY = 2.0  # least likeness at the delay over that at a delay below `LEAST_S`
LEAST_LIKENESS = 0.2  # least likeness at the delay; a device equal to the nominal one has 1
EXCITED = 0.02  # share of the current's largest line above which a line is used
FEWEST_LINES = 50
BAND_HZ = (5.0, 1000.0)
SLOW_HZ, TAKEN_HZ = 20.0, 25.0
NOTICED_HZ = 100.0  # frequency up to which leakage is compared with the rest of the residual
SPLINE = 7  # degree of the splines between the samples: at a fifth of the rate they are 1e-5 off, cubic ones 4e-3
NOTICED = 0.05  # energy of the leakage over that of the rest above which it is removed


def _likeness(run: Measurement, amplifier: Amplifier | None, plant: StateSpace, instrument: Instrument) -> FloatArray:
    """(n,) likeness of the recorded acceleration and the nominal device's response to the current, over lags from 0.

    Only the phases of the cross-spectrum are used, at the lines that the current excites: the peak over lags is then
    sharp, while the plain correlation of a resonant device has one maximum per period of the resonance.
    """
    current, recorded = felt_current(run, amplifier), run.require("acceleration")
    size = fft.next_fast_len(2 * recorded.values.size, real=True)
    lines = fft.rfftfreq(size, recorded.dt_s)
    given = fft.rfft(current.values - current.values.mean(), size)
    inside = (lines >= BAND_HZ[0]) & (lines <= min(BAND_HZ[1], 0.4 * recorded.rate_Hz))
    inside &= np.abs(given) > EXCITED * np.abs(given).max()
    if np.count_nonzero(inside) < FEWEST_LINES:
        return np.zeros(1)
    coarse = np.linspace(lines[inside][0], lines[inside][-1], 4000)
    nominal = np.interp(lines[inside], coarse, sampled_response(plant, instrument, coarse)[0])
    answer = fft.rfft(recorded.values - recorded.values.mean(), size)[inside]
    cross = np.zeros(lines.size, dtype=complex)
    product = answer * (nominal * given[inside]).conj()
    cross[inside] = product / np.maximum(np.abs(product), np.finfo(float).tiny)
    course = fft.irfft(cross, size) * size / (2 * np.count_nonzero(inside))
    return np.asarray(course[: min(round(LONGEST_S / recorded.dt_s), recorded.values.size)])


def delay_samples(
    runs: Sequence[Measurement],
    amplifier: Amplifier | None,
    nominal: Callable[[float], StateSpace],
    instrument: Instrument,
) -> int:
    """Pure delay [samples] of the acceleration's channel, common to all runs; 0 if it is not clear."""
    courses = [np.abs(_likeness(run, amplifier, nominal(run.grip_N or 0.0), instrument)) for run in runs]
    together = np.mean([course[: min(map(len, courses))] for course in courses], axis=0)
    best = int(np.argmax(together))
    soon = float(together[: max(round(LEAST_S / instrument.dt_s), 1)].max())
    late = best * instrument.dt_s > LEAST_S and together[best] > max(CLEARLY * soon, LEAST_LIKENESS)
    return best if late else 0


def without_delay(runs: Sequence[Measurement], samples: int) -> list[Measurement]:
    """The runs with their accelerations shifted earlier by `samples`; the end without acceleration is cut off."""

    def moved(quantity: str, x: Signal) -> Signal:
        values = x.values[samples:] if quantity == "acceleration" else x.values[: x.values.size - samples]
        return replace(x, values=values)

    return [run.changed(moved) for run in runs]


def finding(samples: int, dt_s: float) -> Finding:
    """The finding that tells the user which delay was removed."""
    return Check.DELAYED.at("acceleration", late_ms=1e3 * samples * dt_s, samples=samples)


@dataclass(frozen=True)
class Drift:
    """Drift of the accelerometer's clock against the current's.

    Attributes
    ----------
    relative : period of its samples over the current's, less 1.
    deviation : standard deviation of `relative`.
    moves : (p,) change of the fit's unknowns by one standard deviation of the drift.
    """

    relative: float
    deviation: float
    moves: FloatArray

    @property
    def shows(self) -> bool:
        """Whether the drift is significant against its noise."""
        return abs(self.relative) > SIGNIFICANT * self.deviation

    def finding(self, longest_samples: int) -> Finding:
        """The finding that tells the user which drift was removed from records of up to `longest_samples`."""
        text = (
            f"sampled by a second clock, {1e6 * self.relative:+.3g} +- {2e6 * self.deviation:.2g} ppm longer a "
            f"period than the current's, {abs(self.relative) * longest_samples:.2g} samples at a record's end: "
            "taken out; record both by one clock"
        )
        return beside("acceleration", text, "two clocks")


def _spline(x: Signal) -> interpolate.BSpline:
    """Spline through the samples, over their numbers."""
    return interpolate.make_interp_spline(np.arange(x.values.size), x.values, k=SPLINE)


def drift_of(grips: Sequence[Grip], fit: ChainFit) -> Drift:
    """Drift of the accelerometer's clock: one Gauss-Newton step from `fit`, beside all its unknowns and the delay."""
    responses, free = [grip.response for grip in grips], fit.maximum.free & ~fit.maximum.bounded
    free[fit.coordinates.size + INSTRUMENT.index("late")] = True
    force = fit.device.force_per_current_N_A
    search = ChainSearch(responses, fit.coordinates, fit.instrument, force, free)
    residuals, slopes = search.likelihood.evaluate(fit.maximum.unknowns)
    column = []
    for grip, response in zip(grips, responses, strict=True):
        accelerations = [run.require("acceleration") for run in grip.fitted]
        ticks = [np.arange(x.values.size) for x in accelerations]
        drifting = [(t * _spline(x).derivative()(t))[None] for t, x in zip(ticks, accelerations, strict=True)]
        inputs = [
            (run.require("command") if response.commanded else felt_current(run, fit.instrument.amplifier)).values
            for run in grip.fitted
        ]
        data, j = response.data, response.outputs.index(ACCELERATION)
        part = np.zeros((len(response.outputs), *data.used.shape), dtype=complex)
        part[j] = np.einsum("bij,bj->bi", data.roots()[j], condense(inputs, drifting, data.dt_s).values()[0])
        column += [part.real.ravel(), part.imag.ravel()]
    whole = np.column_stack([slopes[:, free], np.concatenate(column)])
    covariance = inverse(whole)
    step = -covariance @ (whole.T @ residuals)
    left = residuals + whole @ step
    covariance *= max(float(left @ left) / max(int(np.count_nonzero(left)) - step.size, 1), 1.0)
    deviation, moves = float(np.sqrt(covariance[-1, -1])), np.zeros(free.size)
    moves[free] = covariance[:-1, -1] / deviation
    return Drift(float(step[-1]), deviation, moves)


def without_drift(runs: Sequence[Measurement], drift: float) -> list[Measurement]:
    """The runs with their accelerations at the ticks of the current; both clocks start together."""

    def moved(quantity: str, x: Signal) -> Signal:
        if quantity != "acceleration":
            return x
        ticks = np.arange(x.values.size)
        return replace(x, values=_spline(x)(np.clip(ticks / (1 + drift), 0, ticks[-1])))

    return [run.changed(moved) for run in runs]


def grip_without_drift(grip: Grip, drift: float, instrument: Instrument) -> Grip:
    """The grip with the response of its runs without drift."""
    fitted, kept = (tuple(without_drift(runs, drift)) for runs in (grip.fitted, grip.kept))
    return replace(grip, fitted=fitted, kept=kept, response=_again(grip, fitted, instrument))


def _again(grip: Grip, runs: Sequence[Measurement], instrument: Instrument) -> GripResponse:
    """The response of a grip from cleaned runs."""
    return response_of(grip.grip_N, runs, instrument, follows=CURRENT in grip.response.outputs)


def leakage(residual_m_s2: FloatArray, dt_s: float) -> tuple[FloatArray, float]:
    """(n,) leakage of the slow part of a residual (n,) into faster lines, and its energy there over the rest's."""
    n = residual_m_s2.size
    parts = fft.dct(residual_m_s2, norm="ortho")
    parts[int(2 * n * dt_s * SLOW_HZ) + 1 :] = 0.0  # the k-th cosine has k half periods in the record
    lines, frequencies = fft.rfft(fft.idct(parts, norm="ortho")), fft.rfftfreq(n, dt_s)
    lines[frequencies <= TAKEN_HZ] = 0.0
    near = (frequencies > TAKEN_HZ) & (frequencies <= NOTICED_HZ)
    rest = fft.rfft(residual_m_s2)[near] - lines[near]
    share = float(np.sum(np.abs(lines[near]) ** 2) / max(np.sum(np.abs(rest) ** 2), np.finfo(float).tiny))
    return np.asarray(fft.irfft(lines, n)), share


def without_leakage(grip: Grip, model: Model, instrument: Instrument) -> Grip | None:
    """The grip with the response of records without leakage; None if the leakage is negligible."""
    found, most = [], 0.0
    for run in grip.fitted:
        recorded = run.require("acceleration")
        current = felt_current(run, instrument.amplifier).values
        expected = predict(model, grip.grip_N, instrument, current - current[0])
        leaked, share = leakage(recorded.values - expected, recorded.dt_s)
        found.append(replace(run, acceleration=replace(recorded, values=recorded.values - leaked)))
        most = max(most, share)
    if most < NOTICED:
        return None
    return replace(grip, response=_again(grip, found, instrument))
