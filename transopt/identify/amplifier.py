"""The amplifier from its sweeps: one pole, a pure delay, a gain and the crossover (seed Sec. 4.1, Fig. 6)."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import optimize, signal, special

from transopt.base.errors import InputError
from transopt.base.signals import FloatArray, Signal
from transopt.identify.checks import COHERENT, Fault, Finding
from transopt.identify.spectrum import ComplexArray, TransferEstimate, Trial, estimate_transfer
from transopt.plant.discretise import split_delay

PARAMETERS = ("pole_Hz", "delay_s", "gain")
LEAST_BINS = 12
POLE_RANGE = 1e-3, 10.0  # of the servo's rate: poles outside leave no trace in the samples
LATEST_TICKS = 20.0  # of delay
START_POLES, START_STEP, STARTS = (0.01, 0.03, 0.1, 0.3, 1.0), 0.5, 3  # of the rate; ticks of delay; how many to fit
CROSSOVER_ROUNDS, CROSSOVER_SIGMAS = 3, 4.0
CROSSOVER_LEAST, CROSSOVER_MOST = 1e-4, 0.3  # of the largest command: no part is played below, none searched above
POLE_WANTED, DELAY_WANTED_S = 0.02, 3e-6  # half widths of the intervals that a design needs
MISFIT_dB, MISFIT_deg = 1.0, 5.0
CERTAIN = 3.0  # standard deviations by which a misfit must stand out of its noise
GAIN_WANTED = 0.1  # off one: command and current monitor do not share a scale
LEVEL = 0.95
APART_TICKS, APART_GAIN = 0.3, 1.5  # between one trial and the others; a crossover alone takes less off the gain


@dataclass(frozen=True)
class Crossover:
    """Dead band around zero: of a command c the amplifier follows c - min(max(c, -h), h).

    Attributes
    ----------
    half_width_A : h, 0 where the records do not show one.
    deviation_A : standard deviation of the estimate.
    shows : whether h stands out of its noise.
    """

    half_width_A: float
    deviation_A: float
    shows: bool


@dataclass(frozen=True)
class AmplifierFit:
    """i' = 2 pi pole (gain c(t - delay) - i), with what is known of its numbers.

    Attributes
    ----------
    pole_Hz : of the amplifier.
    delay_s : beyond the hold of the command.
    gain : of current over command, 1 where both share a scale.
    covariance : (3, 3), in the order of `PARAMETERS`, SI.
    intervals : 95 %, of each parameter.
    continuous_pole_Hz, continuous_delay_s : what a continuous pole and delay, fitted to the samples as if there were
        no hold, come out at; the delay then holds the hold's half sample.
    crossover : dead band around zero.
    estimate : response from the command less the dead band to the current, which the fit follows.
    misfit_dB, misfit_deg : of the fit, largest over the coherent band, means over a third of an octave
        less three standard deviations of their noise.
    trial_gains : (K,) of each trial: its response over that of pole and delay, crossover and all.
    dt_s : servo period.
    """

    pole_Hz: float
    delay_s: float
    gain: float
    covariance: FloatArray
    intervals: Mapping[str, tuple[float, float]]
    continuous_pole_Hz: float
    continuous_delay_s: float
    crossover: Crossover
    estimate: TransferEstimate
    misfit_dB: float
    misfit_deg: float
    trial_gains: FloatArray
    dt_s: float

    @property
    def delay_with_hold_s(self) -> float:
        """With the half sample by which a held command is late on average."""
        return self.delay_s + 0.5 * self.dt_s

    def response(self, frequencies_Hz: FloatArray) -> ComplexArray:
        """(m,) of the fit, from command samples to samples of the current."""
        return self.gain * sampled_response(frequencies_Hz, self.pole_Hz, self.delay_s, self.dt_s)

    def shortcomings(self) -> list[str]:
        """What keeps the fit from being one to design with, each with what to record again; empty if nothing does."""
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
                "the amplifier has further dynamics, or the sweep drove it into its supply: sweep with less current"
            )
            found.append(f"one pole and a delay miss the response by up to {misfit}, {limit}: {remedy}")
        if not abs(self.gain - 1) <= GAIN_WANTED:
            remedy = "correct the scale of the command or of the current monitor"
            found.append(f"the gain from command to current is {self.gain:.3g}, must be near 1: {remedy}")
        return found

    def verdict(self) -> str:
        """One sentence for the model file and for the user: fit to design with, or why not."""
        shortcomings = self.shortcomings()
        if shortcomings:
            return "not fit to design with: " + "; ".join(shortcomings)
        low, high = self.estimate.frequencies_Hz[[0, -1]]
        misses = f"by at most {self.misfit_dB:.2g} dB and {self.misfit_deg:.2g} deg beyond its noise"
        return f"one pole and a pure delay miss the current {misses}, {low:.3g} to {high:.4g} Hz; fit to design with"


def sampled_response(frequencies_Hz: FloatArray, pole_Hz: float, delay_s: float, dt_s: float) -> ComplexArray:
    """(m,) exact response from commands issued at t_k and held to the current sampled at t_k, before c_k acts.

    Modified z-transform (Jury 1964): with m whole ticks in the delay, e the rest, p = exp(-w dt),
    q = exp(-w (dt - e)),  G(z) = z^-(m+1) ((1 - q) + (q - p) z^-1) / (1 - p z^-1).
    """
    whole, now, before, keep = _difference_equation(pole_Hz, delay_s, dt_s)
    late = np.exp(-2j * np.pi * frequencies_Hz * dt_s)
    return np.asarray(late ** (whole + 1) * (now + before * late) / (1 - keep * late))


def _difference_equation(pole_Hz: float, delay_s: float, dt_s: float) -> tuple[int, float, float, float]:
    """m and the coefficients of i_(k+1) = keep i_k + now c_(k-m) + before c_(k-m-1)."""
    w = 2 * np.pi * pole_Hz
    whole, rest = split_delay(delay_s, dt_s)
    q = float(np.exp(-w * (dt_s - rest)))
    keep = float(np.exp(-w * dt_s))
    return whole, 1 - q, q - keep, keep


def continuous_response(frequencies_Hz: FloatArray, pole_Hz: float, delay_s: float) -> ComplexArray:
    """(m,) of one pole and a delay without hold or samples."""
    s = 2j * np.pi * frequencies_Hz
    return np.asarray(np.exp(-s * delay_s) / (1 + s / (2 * np.pi * pole_Hz)))


def simulate_current(command_A: FloatArray, pole_Hz: float, delay_s: float, dt_s: float) -> FloatArray:
    """(n,) current sampled at the ticks for commands (n,) held from the ticks, from rest, exactly."""
    whole, now, before, keep = _difference_equation(pole_Hz, delay_s, dt_s)
    numerator = np.concatenate([np.zeros(whole + 1), [now, before]])
    return np.asarray(signal.lfilter(numerator, [1.0, -keep], command_A))


def less_dead_band(command_A: FloatArray, half_width_A: float) -> FloatArray:
    """(n,) what an amplifier with a crossover follows of a command."""
    return np.asarray(command_A - np.clip(command_A, -half_width_A, half_width_A))


def fit_amplifier(trials: Sequence[Trial]) -> AmplifierFit:
    """Pole, delay, gain and crossover from sweeps.

    The response is estimated (`spectrum`), then fitted by least squares weighted with its deviations, with the hold
    and the sampling in the model. The crossover distorts what a linear fit sees, by 4 h / (pi A) in gain (describing
    function) and by harmonics that fall into the band; so the dead band is estimated in time and taken off the
    command, and response and fit are made again until it stays.

    Parameters
    ----------
    trials : command [A] and measured current [A].

    Raises
    ------
    InputError : too little of the band is coherent.
    """
    plain = estimate_transfer(trials)
    dt_s, none = plain.dt_s, Crossover(0.0, float("nan"), False)
    estimate, crossover = plain, none
    fitted = _fit(estimate, _sampled(dt_s))
    for _ in range(CROSSOVER_ROUNDS):
        found = estimate_crossover(trials, fitted.values[0], fitted.values[1])
        if not found.shows:
            crossover, estimate = replace(found, half_width_A=0.0), plain
            fitted = _fit(estimate, _sampled(dt_s))
            break
        settled = abs(found.half_width_A - crossover.half_width_A) < 0.1 * found.deviation_A
        crossover = found
        if settled:
            break
        estimate = estimate_transfer([_without(trial, found.half_width_A) for trial in trials])
        fitted = _fit(estimate, _sampled(dt_s))
    covariance = fitted.covariance
    if crossover.shows:
        # One standard deviation of the dead band moves pole, delay and gain together.
        moved = _fit(
            estimate_transfer([_without(trial, crossover.half_width_A + crossover.deviation_A) for trial in trials]),
            _sampled(dt_s),
        )
        covariance = covariance + np.outer(moved.values - fitted.values, moved.values - fitted.values)
    pole, delay, gain = (float(value) for value in fitted.values)
    naive = _fit(plain.between(0.0, 0.4 / dt_s), continuous_response)
    each = _gains(plain, sampled_response(plain.frequencies_Hz, pole, delay, dt_s))
    misfit = _misfit(estimate, gain * sampled_response(estimate.frequencies_Hz, pole, delay, dt_s))
    half = fitted.quantile * np.sqrt(np.diag(covariance))
    intervals = {
        name: (float(max(value - h, 0.0)), float(value + h))
        for name, value, h in zip(PARAMETERS, (pole, delay, gain), half, strict=True)
    }
    return AmplifierFit(
        pole_Hz=pole,
        delay_s=delay,
        gain=gain,
        covariance=covariance,
        intervals=intervals,
        continuous_pole_Hz=float(naive.values[0]),
        continuous_delay_s=float(naive.values[1]),
        crossover=crossover,
        estimate=estimate,
        misfit_dB=misfit[0],
        misfit_deg=misfit[1],
        trial_gains=each,
        dt_s=dt_s,
    )


def check_alike(names: Sequence[str], estimates: Sequence[TransferEstimate]) -> list[Finding]:
    """Trials by themselves: those whose current does not follow the command, or not as in the other ones.

    All trials together would hide it: one of eight that is read a tick late moves the pole by 7 %.

    Parameters
    ----------
    estimates : of each trial alone, from command to current.
    """
    again = "check the current monitor and record again"
    found, delays, gains = [], [], []
    for name, one in zip(names, estimates, strict=True):
        good = one.coherence >= COHERENT
        if good.size < LEAST_BINS:
            text = f"resolves {good.size} bands of frequency, at least {LEAST_BINS} are needed; sweep longer"
            found.append(Finding(Fault.TOO_FEW_CYCLES, name, text, True))
            continue
        if np.count_nonzero(good) < LEAST_BINS:
            share = f"{np.count_nonzero(good)} of {good.size} bins have a coherence of {COHERENT:g}"
            text = f"the current does not follow the command: {share}, at least {LEAST_BINS} are needed; {again}"
            found.append(Finding(Fault.INCOHERENT, name, text, True))
            continue
        w, phase = 2 * np.pi * one.frequencies_Hz[good], np.unwrap(np.angle(one.response[good]))
        delays.append((name, float(-np.polynomial.Polynomial.fit(w, phase, 1).convert().coef[1] / one.dt_s)))
        gains.append((name, float(np.median(np.abs(one.response[good][:LEAST_BINS])))))
    if found or len(estimates) < 3:
        return found
    usual_delay, usual_gain = (float(np.median([value for _, value in each])) for each in (delays, gains))
    for (name, delay), (_, gain) in zip(delays, gains, strict=True):
        if abs(np.log(gain / usual_gain)) > np.log(APART_GAIN):
            text = (
                f"the gain from command to current is {gain / usual_gain:.3g} times that of the other files; {again}"
            )
            found.append(Finding(Fault.CURRENT_SCALE, name, text, True))
        elif abs(delay - usual_delay) > APART_TICKS:
            text = f"the current comes {delay - usual_delay:+.2f} samples later than in the other files"
            found.append(Finding(Fault.SHIFTED, name, f"{text}; read both at the same tick and record again", True))
    return found


def estimate_crossover(trials: Sequence[Trial], pole_Hz: float, delay_s: float) -> Crossover:
    """Half-width of the dead band by least squares in time, pole and delay being known.

    current = gain LTI{c - min(max(c, -h), h)} + offset of the trial's monitor + noise: for a given h linear in gain
    and offsets; h itself by a search in one dimension. A sine through zero and its dead part have different
    harmonics, sweeps with an offset have no dead part: either tells h from the gain.
    """
    peak = max(float(np.abs(trial.input.values).max()) for trial in trials)
    measured = np.concatenate([trial.output.values - trial.output.values.mean() for trial in trials])

    def followed(shape: Callable[[FloatArray], FloatArray]) -> FloatArray:
        parts = []
        for trial in trials:
            x = simulate_current(shape(trial.input.values), pole_Hz, delay_s, trial.input.dt_s)
            parts.append(x - x.mean())  # a mean of its own per trial: its monitor's offset
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
    variance = float(best.fun) / max(measured.size - 2 - len(trials), 1)
    information = np.array([[x @ x, x @ slope], [x @ slope, slope @ slope]])
    deviation = float(np.sqrt(variance * np.linalg.pinv(information)[1, 1]))
    return Crossover(h, deviation, h > max(CROSSOVER_SIGMAS * deviation, CROSSOVER_LEAST * peak))


def _without(trial: Trial, half_width_A: float) -> Trial:
    """The trial with the dead band taken off its command."""
    given: Signal = replace(trial.input, values=less_dead_band(trial.input.values, half_width_A))
    return replace(trial, input=given)


@dataclass(frozen=True)
class _Fit:
    """Pole [Hz], delay [s], gain; their covariance; the t-quantile of the 95 % intervals."""

    values: FloatArray
    covariance: FloatArray
    quantile: float


def _sampled(dt_s: float) -> Callable[[FloatArray, float, float], ComplexArray]:
    """`sampled_response` at a servo period, as a function of frequencies, pole and delay."""
    return lambda f, pole, delay: sampled_response(f, pole, delay, dt_s)


def _fit(estimate: TransferEstimate, model: Callable[[FloatArray, float, float], ComplexArray]) -> _Fit:
    """Weighted nonlinear least squares over pole, delay >= 0 and gain, from several starts.

    The covariance is scaled with the residuals, so that what the model does not explain widens the intervals.
    """
    good = estimate.coherence >= COHERENT
    if np.count_nonzero(good) < LEAST_BINS:
        share = f"{np.count_nonzero(good)} of {good.size} bins have a coherence of {COHERENT:g}"
        raise InputError(
            f"from command to current {share}, at least {LEAST_BINS} are needed; sweep with more current"
        )
    f, measured = estimate.frequencies_Hz[good], estimate.response[good]
    # No bin is better than one part in a million: rounding, and the polynomial across the bin.
    deviation = np.hypot(estimate.deviation[good], 1e-6 * np.abs(measured))
    dt_s, rate = estimate.dt_s, 1 / estimate.dt_s
    scale = np.array([1.0, dt_s, 1.0])  # logarithm of the pole, ticks, gain

    def residual(x: FloatArray) -> FloatArray:
        log_pole, delay, gain = x * scale
        error = (gain * model(f, np.exp(log_pole), delay) - measured) / deviation
        return np.concatenate([error.real, error.imag])

    bounds = [np.log(POLE_RANGE[0] * rate), 0.0, -np.inf], [np.log(POLE_RANGE[1] * rate), LATEST_TICKS, np.inf]
    # The phase winds with the delay, so that the error has many valleys: all delays are tried, the best are fitted.
    starts = []
    for pole in np.array(START_POLES) * rate:
        for ticks in np.arange(0.0, LATEST_TICKS + START_STEP, START_STEP):
            shape = model(f, pole, ticks * dt_s) / deviation
            along = np.real(np.vdot(shape, measured / deviation))
            level = along / float(np.sum(np.abs(shape) ** 2))
            starts.append((-along * level, (np.log(pole), min(ticks, LATEST_TICKS), level)))
    starts.sort()
    runs = [optimize.least_squares(residual, start, bounds=bounds, x_scale="jac") for _, start in starts[:STARTS]]
    best = min(runs, key=lambda run: float(run.cost))
    log_pole, delay, gain = best.x * scale
    surplus = 2 * f.size - best.x.size
    by_si = scale * [np.exp(log_pole), 1.0, 1.0]
    slopes = np.asarray(best.jac, dtype=float)
    information = slopes.T @ slopes
    covariance = np.linalg.pinv(information) * (2 * best.cost / surplus) * np.outer(by_si, by_si)
    values = np.array([np.exp(log_pole), delay, gain])
    return _Fit(values, covariance, float(special.stdtrit(surplus, (1 + LEVEL) / 2)))


def _gains(estimate: TransferEstimate, shape: ComplexArray) -> FloatArray:
    """(K,) real gain of each trial over a response of gain one, weighted."""
    weight = (estimate.coherence >= COHERENT) / estimate.deviation**2
    along = np.real(estimate.trial_responses * shape.conj()) @ weight
    return np.asarray(along / (weight @ np.abs(shape) ** 2))


def _misfit(estimate: TransferEstimate, fit: ComplexArray) -> tuple[float, float]:
    """Largest error of the fit in dB and in degrees, means over a third of an octave of the coherent bins.

    Less what noise alone may do there, so that it is the model's and not the record's.
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
