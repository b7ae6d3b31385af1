"""The amplifier from its sweeps: one pole, a pure delay, a gain and the crossover (seed Sec. 4.1, Fig. 6)."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy import fft, optimize

from transopt.base.errors import InputError
from transopt.base.signals import BoolArray, ComplexArray, FloatArray
from transopt.identify import checks, spectrum
from transopt.identify.amplifier_response import less_dead_band, sampled, simulate_current
from transopt.identify.condensed import Condensed
from transopt.identify.findings import COHERENT, Check, Finding, refuse
from transopt.identify.fit import Fit, intervals_around, known
from transopt.identify.likelihood import Likelihood, Maximum
from transopt.identify.measurement import Measurement

PARAMETERS = ("pole_Hz", "delay_s", "gain")
LEAST_BINS = 12
POLE_RANGE = 1e-3, 10.0  # times the servo's rate: poles outside leave no trace in the samples
LATEST_TICKS = 20.0  # upper bound of the delay sought
GAIN_RANGE = 1e6
COARSE = 4  # the search for starting points takes every fourth bin
RESTED = 10.0  # time constants after which a current has settled
ROUNDED = 1e-6  # relative error of a response by rounding and by the polynomial across a bin
START_POLES, START_STEP, STARTS = (0.01, 0.03, 0.1, 0.3, 1.0), 0.5, 3  # of the rate; ticks of delay; how many to fit
CROSSOVER_ROUNDS, CROSSOVER_SIGMAS = 3, 4.0
CROSSOVER_LEAST, CROSSOVER_MOST = 1e-4, 0.3  # shares of the largest command: least dead band reported, most searched
POLE_WANTED, DELAY_WANTED_S = 0.02, 3e-6  # largest half widths of the intervals (pole: relative) to design with
MISFIT_dB, MISFIT_deg = 1.0, 5.0
CERTAIN = 3.0  # standard deviations by which a misfit must stand out of its noise
GAIN_WANTED = 0.1  # a gain farther from one means that command and current monitor differ in scale
APART_TICKS, APART_GAIN = 0.3, 1.5  # limits on one trial's delay and gain against the others; a crossover costs less


@dataclass(frozen=True)
class Crossover:
    """Dead band around zero: the amplifier follows a command c only as c - min(max(c, -h), h).

    Attributes
    ----------
    half_width_A : h; 0 where no dead band is significant.
    deviation_A : standard deviation of the estimate of h.
    shows : whether h is significant against its noise.
    """

    half_width_A: float
    deviation_A: float
    shows: bool


@dataclass(frozen=True)
class AmplifierFit(Fit):
    """The amplifier i' = 2 pi pole (gain c(t - delay) - i), fitted, with the uncertainty of its parameters.

    Attributes
    ----------
    pole_Hz : closed-loop pole of the amplifier.
    delay_s : pure delay, without the hold of the command.
    gain : current over command; 1 where both share a scale.
    covariance : (3, 3), in the order of `PARAMETERS`, SI.
    intervals : parameter -> its 95 % interval.
    crossover : dead band around zero.
    estimate : response from the command less the dead band to the current; the fit was made to it.
    misfit_dB, misfit_deg : largest error of the fit over the coherent band: means over a third of an octave less
        three standard deviations of their noise.
    trial_gains : (K,) gain of each trial's response over the response of pole and delay; a crossover lowers it.
    dt_s : servo period.
    low_Hz : lowest frequency that the trials swept.
    """

    pole_Hz: float
    delay_s: float
    gain: float
    covariance: FloatArray
    intervals: Mapping[str, tuple[float, float]]
    crossover: Crossover
    estimate: spectrum.TransferEstimate
    misfit_dB: float
    misfit_deg: float
    trial_gains: FloatArray
    dt_s: float
    low_Hz: float

    @property
    def delay_with_hold_s(self) -> float:
        """Delay plus the half sample by which the hold delays a command on average."""
        return self.delay_s + 0.5 * self.dt_s

    def response(self, frequencies_Hz: FloatArray) -> ComplexArray:
        """(m,) response of the fit, from samples of the command to samples of the current."""
        return self.gain * sampled(frequencies_Hz, self.pole_Hz, self.delay_s, self.dt_s)[0]

    def shortfalls(self) -> list[str]:
        found = []
        low, high = self.intervals["pole_Hz"]
        if not 0.5 * (high - low) <= POLE_WANTED * self.pole_Hz:
            width = 50 * (high - low) / self.pole_Hz
            limit = f"must be within {100 * POLE_WANTED:g} %"
            found.append(f"the pole is known to {width:.2g} % only, {limit}: record longer or larger sweeps")
        low, high = self.intervals["delay_s"]
        if not 0.5 * (high - low) <= DELAY_WANTED_S:
            limit = f"must be within {1e6 * DELAY_WANTED_S:g} us"
            found.append(f"the delay is known to {5e5 * (high - low):.2g} us only, {limit}: sweep higher, or longer")
        if not (self.misfit_dB <= MISFIT_dB and self.misfit_deg <= MISFIT_deg):
            misfit = f"{self.misfit_dB:.2g} dB and {self.misfit_deg:.2g} deg"
            limit = f"must be within {MISFIT_dB:g} dB and {MISFIT_deg:g} deg"
            remedy = (
                "the amplifier has further dynamics, the sweep drove it into its supply (sweep with less current), "
                "or its loop is too slow for the motor's own voltage (raise its gain)"
            )
            found.append(f"one pole and a delay miss the response by up to {misfit}, {limit}: {remedy}")
        if not abs(self.gain - 1) <= GAIN_WANTED:
            remedy = "correct the scale of the command or of the current monitor"
            found.append(f"the gain from command to current is {self.gain:.3g}, must be near 1: {remedy}")
        return found

    def supports(self) -> str:
        low, high = self.low_Hz, self.estimate.frequencies_Hz[-1]
        misses = f"by at most {self.misfit_dB:.2g} dB and {self.misfit_deg:.2g} deg beyond its noise"
        return f"one pole and a pure delay miss the current {misses}, {low:.3g} to {high:.4g} Hz; fit to design with"

    def stated(self) -> dict[str, Any]:
        (low, high), half_s = self.intervals["delay_s"], 0.5 * self.dt_s
        fitted = PARAMETERS[:2]
        stated = known(fitted, self.covariance[:2, :2], np.array([self.intervals[name] for name in fitted]))
        stated["intervals"] |= {"gain": self.intervals["gain"], "delay_with_hold_s": (low + half_s, high + half_s)}
        values = (*PARAMETERS, "delay_with_hold_s")
        return {**stated, **{name: getattr(self, name) for name in values}}


def fit_pole(groups: Sequence[Condensed], start: tuple[float, float] | None = None) -> Maximum:
    """Maximum likelihood of pole, delay and gain; the unknowns are log(pole [Hz]), delay [ticks] and gain.

    Parameters
    ----------
    groups : condensed records of one amplifier, from the command to the current, their only output.
    start : pole [Hz] and delay [s] to start the search from. Without them a grid of delays is tried and the best
        are fitted: the phase winds with the delay, so the error has many local minima.
    """
    dt_s = groups[0].dt_s

    def model(theta: FloatArray, _: int, frequencies_Hz: FloatArray) -> tuple[ComplexArray, ComplexArray]:
        log_pole, ticks, gain = theta.tolist()
        value, slopes = sampled(frequencies_Hz, float(np.exp(log_pole)), ticks * dt_s, dt_s)
        return gain * value[None], np.array([gain * slopes[0], gain * dt_s * slopes[1], value])[:, None]

    likelihood, coarse = (Likelihood(groups, model, loose=ROUNDED, step=step) for step in (1, COARSE))
    low, high = np.log(np.array(POLE_RANGE) / dt_s)
    bounds = np.array([[low, 0.0, -GAIN_RANGE], [high, LATEST_TICKS, GAIN_RANGE]])
    silent, _ = coarse.evaluate(np.array([low, 0.0, 0.0]))
    rough: list[tuple[float, FloatArray]] = []
    poles, delays = np.array(START_POLES) / dt_s, np.arange(0.0, LATEST_TICKS + START_STEP, START_STEP)
    for pole, ticks in [(start[0], start[1] / dt_s)] if start else [(p, t) for p in poles for t in delays]:
        moved = coarse.evaluate(np.array([np.log(pole), ticks, 1.0]))[0] - silent
        gain = -float(moved @ silent) / float(moved @ moved)
        rough.append((gain * float(moved @ silent), np.array([np.log(pole), ticks, gain])))
    rough.sort(key=lambda one: one[0])
    best, _ = likelihood.searches([begun for _, begun in rough[:STARTS]], *bounds)[0]
    # The bounds are moved outward here: a delay of zero lies at its bound, yet its variance is that of any other.
    return likelihood.maximum_at(best, bounds[0] - 1, bounds[1] + 1, np.ones(3, dtype=bool))


def _share(good: BoolArray) -> str:
    """The number of coherent bins and the number needed, as a phrase for messages."""
    count = f"{np.count_nonzero(good)} of {good.size} bins have a coherence of {COHERENT:g}"
    return f"{count}, at least {LEAST_BINS} are needed"


@dataclass(frozen=True)
class _Fit:
    """The condensed data, the response, and pole [Hz], delay [s] and gain with their covariance."""

    data: Condensed
    estimate: spectrum.TransferEstimate
    values: FloatArray
    covariance: FloatArray


def _fit(trials: Sequence[spectrum.Trial]) -> _Fit:
    """The fit to the coherent bins."""
    data = spectrum.condense_trials(trials).moved()
    estimate = spectrum.transfer(data)
    good = estimate.coherence >= COHERENT
    if np.count_nonzero(good) < LEAST_BINS:
        raise InputError(f"from command to current {_share(good)}; sweep with more current")
    data = replace(data, known=good[None])
    found = fit_pole([data])
    pole = float(np.exp(found.unknowns[0]))
    scale = np.array([pole, data.dt_s, 1.0])
    values = np.array([pole, found.unknowns[1] * data.dt_s, found.unknowns[2]])
    return _Fit(data, estimate, values, found.covariance * np.outer(scale, scale))


def fit_amplifier(trials: Sequence[spectrum.Trial]) -> AmplifierFit:
    """Pole, delay, gain and crossover from sweeps.

    One pole and a delay, with hold and sampling, are fitted to all lines of all trials (`likelihood`). A crossover
    biases a linear fit: it lowers the gain by 4 h / (pi A) (describing function) and adds harmonics within the band.
    So the dead band is estimated in the time domain and subtracted from the command, and the fit is repeated until
    the dead band settles.

    Parameters
    ----------
    trials : command [A] and measured current [A].

    Raises
    ------
    InputError : too little of the band is coherent.
    """
    fit, crossover = _fit(trials), Crossover(0.0, float("nan"), False)
    plain = fit
    for again in range(CROSSOVER_ROUNDS):
        pole, delay, _ = fit.values.tolist()
        last, crossover = crossover.half_width_A, estimate_crossover(trials, pole, delay)
        if not crossover.shows:
            crossover = replace(crossover, half_width_A=0.0)
        if again and abs(crossover.half_width_A - last) < 0.1 * crossover.deviation_A:
            break
        fit = _fit([_at_rest(trial, crossover.half_width_A, pole, delay) for trial in trials])
    covariance, dt_s = fit.covariance, fit.data.dt_s
    if crossover.shows:
        # One standard deviation of the dead band moves pole, delay and gain together.
        wider_A = crossover.half_width_A + crossover.deviation_A
        moved = _fit([_at_rest(trial, wider_A, pole, delay) for trial in trials]).values - fit.values
        covariance = covariance + np.outer(moved, moved)
    pole, delay, gain = fit.values.tolist()
    misfit = _misfit(fit.estimate, gain * sampled(fit.estimate.frequencies_Hz, pole, delay, dt_s)[0])
    spans = np.maximum(intervals_around(fit.values, covariance), [0.0, -np.inf]).tolist()
    return AmplifierFit(
        pole_Hz=pole,
        delay_s=delay,
        gain=gain,
        covariance=covariance,
        intervals={name: (low, high) for name, (low, high) in zip(PARAMETERS, spans, strict=True)},
        crossover=crossover,
        estimate=fit.estimate,
        misfit_dB=misfit[0],
        misfit_deg=misfit[1],
        trial_gains=_gains(plain.data, sampled(plain.data.frequencies_Hz, pole, delay, dt_s)[0]),
        dt_s=dt_s,
        low_Hz=checks.swept_from(trials, fit.estimate),
    )


def trials_of(runs: Sequence[Measurement]) -> tuple[list[spectrum.Trial], list[Finding]]:
    """Trials from command to current, and the findings about them that are not fatal.

    Raises
    ------
    InputError : a finding is fatal.
    """
    findings = refuse(finding for run in runs for finding in checks.check_measurement(run, ("command", "current")))
    trials = [spectrum.Trial.of(run, "command", "current") for run in runs]
    refuse(spectrum.check_rates(trials))
    # Each trial is checked by itself, so that the message names its file.
    each = [spectrum.estimate_transfer([trial]) for trial in trials]
    refuse(check_alike([trial.name for trial in trials], each))
    for trial, alone in zip(trials, each, strict=True):
        refuse(checks.check_sign(trial.name, alone))
    together = spectrum.estimate_transfer(trials)
    findings += refuse(checks.check_cycles("all files", trials, together, checks.swept_from(trials, together)))
    findings += checks.low_coherence("all files", together)
    return trials, findings


def check_alike(names: Sequence[str], estimates: Sequence[spectrum.TransferEstimate]) -> list[Finding]:
    """Find trials whose current does not follow the command, or follows it unlike in the other trials.

    A fit to all trials together would hide it: one trial of eight that is read a tick late moves the pole by 7 %.

    Parameters
    ----------
    estimates : response of each trial alone, from command to current.
    """
    found, delays, gains = [], [], []
    for name, one in zip(names, estimates, strict=True):
        good = one.coherence >= COHERENT
        if good.size < LEAST_BINS:
            found += checks.check_bins(name, one, LEAST_BINS)
            continue
        if np.count_nonzero(good) < LEAST_BINS:
            found.append(Check.CURRENT_ALONE.at(name, share=_share(good)))
            continue
        w, phase = 2 * np.pi * one.frequencies_Hz[good], np.unwrap(np.angle(one.response[good]))
        # A sweep's end leaves noisy bins, which would move an unweighted line by half a sample.
        known = np.abs(one.response[good]) / np.maximum(one.deviation[good], ROUNDED * np.abs(one.response[good]))
        line = np.polynomial.Polynomial.fit(w, phase, 1, w=known).convert()
        delays.append((name, float(-line.coef[1] / one.dt_s)))
        gains.append((name, float(np.median(np.abs(one.response[good][:LEAST_BINS])))))
    if found or len(estimates) < 3:
        return found
    usual_delay, usual_gain = (float(np.median([value for _, value in each])) for each in (delays, gains))
    for (name, delay), (_, gain) in zip(delays, gains, strict=True):
        if abs(np.log(gain / usual_gain)) > np.log(APART_GAIN):
            found.append(Check.GAIN_APART.at(name, ratio=gain / usual_gain))
        elif abs(delay - usual_delay) > APART_TICKS:
            found.append(Check.DELAY_APART.at(name, samples=delay - usual_delay))
    return found


def estimate_crossover(trials: Sequence[spectrum.Trial], pole_Hz: float, delay_s: float) -> Crossover:
    """Half-width of the dead band by least squares in the time domain, with pole and delay known.

    current = gain LTI{c - min(max(c, -h), h)} + offset of the trial's monitor + noise. For a given h this is linear
    in gain and offsets; h is found by a one-dimensional search. Two things tell h from the gain: a dead band gives a
    sine through zero other harmonics, and sweeps with an offset never enter the dead band. The deviation of h takes
    the spectrum of the residual for that of the noise, which need not be white.
    """
    peak = max(float(np.abs(trial.input.values).max()) for trial in trials)
    measured = np.concatenate([trial.output.values - trial.output.values.mean() for trial in trials])

    def followed(shape: Callable[[FloatArray], FloatArray]) -> FloatArray:
        parts = []
        for trial in trials:
            x = simulate_current(shape(trial.input.values), pole_Hz, delay_s, trial.input.dt_s)
            parts.append(x - x.mean())  # each trial loses its own mean: the offset of its current monitor
        return np.concatenate(parts)

    def misfit(half_width: float) -> float:
        x = followed(lambda c: less_dead_band(c, half_width))
        return float(measured @ measured - (x @ measured) ** 2 / (x @ x))

    fine = 0.03 * CROSSOVER_LEAST * peak
    best = optimize.minimize_scalar(
        misfit, bounds=(0.0, CROSSOVER_MOST * peak), method="bounded", options={"xatol": fine}
    )
    h = float(best.x)
    x = followed(lambda c: less_dead_band(c, h))
    gain = float(x @ measured / (x @ x))
    slope = -gain * followed(lambda c: np.where(np.abs(c) > h, np.sign(c), 0.0))
    along, residual = slope - x * float(x @ slope) / float(x @ x), measured - gain * x
    lengths = [trial.input.values.size for trial in trials]
    deviation = _deviation_of_sum(along, residual, lengths) / float(along @ along)
    return Crossover(h, deviation, h > max(CROSSOVER_SIGMAS * deviation, CROSSOVER_LEAST * peak))


def _deviation_of_sum(weights: FloatArray, noise: FloatArray, lengths: Sequence[int]) -> float:
    """Standard deviation of the sum of weights times noise (n,), stationary within each trial of these lengths.

    Lines of different frequencies are independent, so by Parseval's theorem each adds |W|^2 |E|^2 / length^2.
    """
    variance, ends = 0.0, np.cumsum(lengths)[:-1]
    for each, e in zip(np.split(weights, ends), np.split(noise, ends), strict=True):
        variance += float(np.sum(np.abs(fft.fft(each) * fft.fft(e)) ** 2)) / each.size**2
    return float(np.sqrt(variance))


def _at_rest(trial: spectrum.Trial, half_width_A: float, pole_Hz: float, delay_s: float) -> spectrum.Trial:
    """The trial with the dead band subtracted from its command, extended by the fit until the current has settled.

    A record that ends before the current has settled disturbs the lowest lines of its spectrum, and those are too
    few to estimate the disturbance from them.
    """
    dt_s, recorded = trial.input.dt_s, trial.output.values
    more = int(np.ceil((delay_s + RESTED / (2 * np.pi * pole_Hz)) / dt_s))
    command = np.pad(less_dead_band(trial.input.values, half_width_A), (0, more), mode="edge")
    followed = simulate_current(command, pole_Hz, delay_s, dt_s)
    gain, offset = np.polyfit(followed[: recorded.size], recorded, 1)
    current = np.append(recorded, gain * followed[recorded.size :] + offset)
    return replace(trial, input=replace(trial.input, values=command), output=replace(trial.output, values=current))


def _gains(data: Condensed, shape: ComplexArray) -> FloatArray:
    """(K,) real gain of each trial relative to a response `shape` (b, q) of gain one."""
    weight = data.known[0] / data.noise[0]
    along = np.einsum("bi,kbi,b->k", shape.conj(), data.right[:, 0], weight).real
    return np.asarray(along / np.einsum("bi,kbij,bj,b->k", shape.conj(), data.normal, shape, weight).real)


def _misfit(estimate: spectrum.TransferEstimate, fit: ComplexArray) -> tuple[float, float]:
    """Largest error of the fit in dB and in degrees, of means over a third of an octave of the coherent bins.

    The part that noise alone explains (`CERTAIN` standard deviations) is subtracted: the rest is the model's error.
    """
    good = estimate.coherence >= COHERENT
    f, ratio = estimate.frequencies_Hz[good], estimate.response[good] / fit[good]
    weight = (np.abs(fit[good]) / estimate.deviation[good]) ** 2
    first, last = np.searchsorted(f, f * 2 ** (-1 / 6)), np.searchsorted(f, f * 2 ** (1 / 6), side="right")
    parts = [slice(a, b) for a, b in zip(first, last, strict=True)]
    mean = np.array([np.average(ratio[part], weights=weight[part]) for part in parts])
    noise = CERTAIN * np.array([float(np.sum(weight[part])) ** -0.5 for part in parts])
    error_dB = np.abs(20 * np.log10(np.abs(mean))) - 20 * np.log10(1 + noise)
    error_deg = np.abs(np.degrees(np.angle(mean))) - np.degrees(noise)
    return max(float(error_dB.max()), 0.0), max(float(error_deg.max()), 0.0)
