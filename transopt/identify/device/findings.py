"""Findings about a device's records beside the verdict: effects the model lacks, noise, and what to record again.

Noise does not bias a fit, which weights every line by its noise. But mains hum, the hand's tremor and the steps of a
converter cost trials, and each has its own remedy.
"""

from collections.abc import Sequence

import numpy as np

from transopt.base.signals import FloatArray
from transopt.identify.checks import runs_of
from transopt.identify.device import effects
from transopt.identify.device.black_box import BlackBox
from transopt.identify.device.chain import RANGE, GripResponse
from transopt.identify.device.chain_fit import MISFIT, ChainFit, GripFit, factor_of
from transopt.identify.device.response import ACCELERATION, Instrument
from transopt.identify.device.result import Candidate, Kind
from transopt.identify.device.trials import BAND_HZ, Grip, incoherent_bands
from transopt.identify.device.validation import Model, called, modelled
from transopt.identify.findings import Finding, beside
from transopt.identify.measurement import Measurement
from transopt.scene.model_error import ModelError

READ_LATE = 0.02  # delay of the acceleration's reading [samples] above which it is reported
RINGS, MOST_HZ = 0.3, 2000.0  # largest damping ratio and frequency of a resonance that is named
DISTORTED = 0.01  # distortion, as a share of the response, above which it is reported
CLOCKS_ALIKE, CLOCKS_APART = 1e-3, 0.05  # relative difference of rates: one clock below; another rate meant above
REMEDIES = {
    "friction": "refine the library on the device (transopt-play refine), or loosen bearings and guides",
    "backlash": "preload the transmission; no library makes up for play",
    "stiffening": "record at the amplitude that is played, and refine the library on the device",
}
MAINS_HZ = (50.0, 60.0)
STANDS_OUT = 6.0  # variance over that of the neighbouring bins above which mains hum is reported
TREMOR_HZ, BESIDE_HZ = (7.0, 13.0), (20.0, 45.0)
TREMBLES = 10.0  # variance over that of the band beside above which tremor is reported
COARSE = 0.1  # share of the noise due to a converter's rounding above which it is reported
FEW_LEVELS = 0.2  # distinct values over samples up to which a converter's steps are looked for
MISFIT_RELATIVE = 0.06  # mean relative error (0.5 dB) above which a band lacks fit
SMOOTHED_BINS = 9
MOST_APART = 1.25  # factor between the scales of accelerometer and encoder, either way; a check finds a fifth
NOT_LINEAR_DB = 1.0  # difference between the hand of one grip and the lines over all grips that the user is warned of


def two_clocks(recorded_s: float, servo_s: float | None) -> list[str]:
    """The shortfall of records whose rate is almost, but not exactly, the servo's: one of the two clocks is wrong."""
    if servo_s is None or not CLOCKS_ALIKE < abs(recorded_s / servo_s - 1) < CLOCKS_APART:
        return []
    return [
        f"clock: the files state {1 / recorded_s:.6g} samples per second, the scene's servo has {1 / servo_s:.6g}: "
        f"one of the two is {100 * abs(recorded_s / servo_s - 1):.2g} % off, and with it every spring and mass; "
        "state the servo's own time in the files, or its period in the scene (time.dt_s)"
    ]


def scales_apart(chain: ChainFit | None, chosen: Candidate) -> list[str]:
    """The shortfall of a chain whose accelerometer and encoder contradict each other by more than sensors are off."""
    gain = next((one.value for one in chain.nuisances if one.name == "gain"), 1.0) if chain is not None else 1.0
    if chosen.kind is not Kind.DRIVE or 1 / MOST_APART <= gain <= MOST_APART:
        return []
    return [
        f"acceleration and position: {gain:.3g} times apart (at most {MOST_APART:g}), and if it is the encoder, the "
        f"model answers a current {1 / gain:.3g} times as much as the device: measure a known way (encoder) and turn "
        "the accelerometer over (2 g), correct the scale of the one that is off, and identify again"
    ]


def distorted(repeated: Sequence[Measurement]) -> list[Finding]:
    """Findings of distortion at the detection lines of periodic records; none for a record without distortion."""
    found = [(run, effects.distortion(run)) for run in repeated]
    return [
        beside(run.name, measured.words())
        for run, measured in found
        if measured is not None and measured.largest >= DISTORTED
    ]


def causes_of(
    chosen: Candidate,
    chain: ChainFit | None,
    grips: Sequence[Grip],
    used: Sequence[effects.Missed],
    error: ModelError,
    repeated: Sequence[Measurement],
) -> list[Finding]:
    """Findings of effects beside the model, each with the name of its cause and a remedy."""
    found = list[Finding]()

    def say(cause: str, where: str, text: str) -> None:
        found.append(beside(where, text, cause))

    if chain is not None and chosen.kind is Kind.DRIVE:
        stated = next((run.accelerometer_Hz for grip in grips for run in grip.fitted), None)
        for one in chain.nuisances:
            if one.name == "accelerometer_pole":
                about = "no file states it" if stated is None else f"the files state {stated:g} Hz"
                text = f"{one.value:.4g} +- {2 * one.deviation:.2g} Hz found, {about}: taken out of the records"
                say("unstated accelerometer pole", "accelerometer pole", text)
            elif one.name == "late" and abs(one.value) > READ_LATE:
                text = f"read {one.value:+.3g} samples after the current: taken out; read both at the same tick"
                say("read delay", "acceleration", text)
            elif one.name == "gain" and abs(one.value - 1) > 0.01:
                text = (
                    f"{one.value:.4g} times what the encoder says: either is off scale, which these records cannot "
                    f"tell; counted to the accelerometer and taken out, so if it is the encoder, the model answers a "
                    f"current {1 / one.value:.4g} times as much as the device: check the scales of both"
                )
                say("accelerometer or encoder gain", "acceleration", text)
        gain = chain.instrument.amplifier_gain
        if abs(gain - 1) > 0.02:
            text = f"{gain:.4g} A per A of command: correct the scale of the command or of the current monitor"
            say("monitor scale", "current_A", text)
    if chain is not None and chain.varying.any():
        most = float(np.sqrt(chain.maximum.between[: chain.coordinates.size][chain.varying].max()))
        text = (
            f"the hand differs between trials by {most:.2g} times what their noise explains: "
            "the intervals are that much wider; hold the stylus steadily, or add trials"
        )
        say("varying hand", "trials", text)
    by_lines = [] if chain is None else effects.named_by_lines(chain, repeated)
    for cause, share in by_lines:
        verb = "neither friction nor stiffening explains" if cause == "backlash" else "explains"
        text = f"{verb} {100 * share:.0f} % of what sounds at lines that were not excited: {REMEDIES[cause]}"
        say(cause, "multisines", text)
    loud = [one for one, tap in zip(used, error.at_use, strict=True) if tap.excess]
    if loud:
        worst = max(tap.excess for tap in error.at_use)
        currents = [effects.current_missed(chosen.instrument, one.run) for one in loud]
        fallen, crossover_A = (max(values) for values in zip(*currents, strict=True))
        if fallen > effects.SHORTFALL:
            text = (
                f"the current falls {100 * fallen:.2g} % short of the largest command: lower limits.current_A, or "
                "raise the supply"
            )
            say("amplifier saturation", "current_A", text)
        elif crossover_A > effects.CROSSOVER:
            text = (
                f"the amplifier follows no command below {1e3 * crossover_A:.2g} mA, so small currents lose most: "
                "identify the amplifier too, and refine the library on the device"
            )
            say("amplifier crossover", "current_A", text)
        listened = any(
            effects.distortion(run) is not None for run in repeated
        )  # detection lines beat taps in telling causes
        if chain is not None and not listened:
            for cause, share in effects.named(chain, loud):
                text = (
                    f"explains {100 * share:.0f} % of what taps at full current miss ({100 * worst:.2g} %): "
                    f"{REMEDIES[cause]}"
                )
                say(cause, "taps at full current", text)
    return found


def beyond_a_chain(box: BlackBox) -> Finding:
    """The finding that no chain of drive and hand fits, with the resonances of the black box at the middle grip."""
    poles = np.linalg.eigvals(box.plants[len(box.plants) // 2].A)
    rings = (poles.imag > 0) & (-poles.real < RINGS * np.abs(poles))
    named_Hz = sorted(np.abs(poles[rings]) / (2 * np.pi))
    at = ", ".join(f"{value:.3g} Hz" for value in named_Hz if BAND_HZ[0] <= value <= MOST_HZ)
    text = (
        f"no chain of drive and hand makes what is recorded; resonances of the state space: {at or 'none'}; "
        "a part that swings by itself, or a hand that goes its own way with the grip: tighten what is loose"
    )
    return beside("further dynamics", text)


def noise_findings(grips: Sequence[Grip]) -> list[Finding]:
    """One finding for each significant kind of noise, with its remedy."""
    spectra = [_noise(grip) for grip in grips]
    # Each text is empty if its kind of noise is not significant.
    texts = {
        "mains hum": _hum(spectra),
        "hand tremor": _tremor(grips, spectra),
        "converter steps": _steps(grips, spectra),
    }
    return [beside(where, text) for where, text in texts.items() if text]


def _noise(grip: Grip) -> tuple[FloatArray, FloatArray]:
    """Middles of the bins [Hz] and noise variances of the acceleration's lines in them, (b,) each."""
    data = grip.response.data
    return data.frequencies_Hz.mean(axis=1), data.noise[grip.response.outputs.index(ACCELERATION)]


def _hum(spectra: Sequence[tuple[FloatArray, FloatArray]]) -> str:
    """Mains hum: bins at its frequency or the first harmonics whose noise exceeds that of their neighbours."""
    most, which = 0.0, 0.0
    for mains in MAINS_HZ:
        ratios = []
        for f, noise in spectra:
            for line in mains * np.arange(1, 4):
                at = int(np.argmin(np.abs(f - line)))
                beside = np.r_[noise[max(at - 6, 0) : max(at - 1, 0)], noise[at + 2 : at + 7]]
                if f[0] < line < f[-1] and beside.size >= 4:
                    ratios.append(float(noise[at] / np.median(beside)))
        if ratios and max(ratios) > most:
            most, which = max(ratios), mains
    if most < STANDS_OUT:
        return ""
    return (
        f"the acceleration's noise at multiples of {which:g} Hz is {most:.2g} times that beside it, and those lines "
        "count less: keep the sensor's cable off the mains' and the amplifier's, or ground it at one end"
    )


def _tremor(grips: Sequence[Grip], spectra: Sequence[tuple[FloatArray, FloatArray]]) -> str:
    """Tremor of the hand at 7 to 13 Hz, compared with the band just above it."""
    most = 0.0
    for grip, (f, noise) in zip(grips, spectra, strict=True):
        inside, beside = ((f >= low) & (f <= high) for low, high in (TREMOR_HZ, BESIDE_HZ))
        if grip.grip_N > 0 and inside.any() and beside.any():
            most = max(most, float(noise[inside].max() / np.median(noise[beside])))
    if most < TREMBLES:
        return ""
    return (
        f"the acceleration's noise at {TREMOR_HZ[0]:g} to {TREMOR_HZ[1]:g} Hz is {most:.2g} times that beside it; "
        "what it leaks into other lines is taken out: rest the forearm, or add trials"
    )


def _steps(grips: Sequence[Grip], spectra: Sequence[tuple[FloatArray, FloatArray]]) -> str:
    """Steps of a converter whose rounding noise, step^2 / 12, is a large share of a line's noise."""
    worst, largest = 0.0, 0.0
    for grip, (_, noise) in zip(grips, spectra, strict=True):
        for run in grip.fitted:
            values = run.require("acceleration").values
            levels = np.unique(values)
            gaps = np.diff(levels)
            gaps = gaps[gaps > 1e-6 * np.ptp(values)]
            if levels.size > FEW_LEVELS * values.size or gaps.size < 2:
                continue
            step = float(np.median(gaps))
            share = step**2 / 12 / float(np.median(noise))
            worst, largest = max(worst, share), max(largest, step)
    if worst < COARSE:
        return ""
    return (
        f"the acceleration moves in steps of {largest:.2g} m/s^2, whose rounding makes {100 * min(worst, 1):.0f} % "
        "of its noise: take a converter of more bits, or a sensor of smaller range"
    )


def lack_of_fit(response: GripResponse, model: Model, instrument: Instrument) -> list[tuple[float, float]]:
    """Bands [Hz] where the model's error exceeds both what noise explains and half a decibel."""
    e = response.estimate
    error = modelled(model, response.grip_N, instrument, e.frequencies_Hz) - e.response
    window = np.ones(min(SMOOTHED_BINS, e.response.size))
    count = np.convolve(np.ones(error.size), window, "same")
    surprise = np.convolve(np.abs(error / response.deviation) ** 2 / 2, window, "same") / count
    relative = np.abs(np.convolve(error / e.response, window, "same")) / count
    inside = (e.frequencies_Hz >= BAND_HZ[0]) & (e.frequencies_Hz <= BAND_HZ[1])
    return runs_of(e.frequencies_Hz, (surprise > MISFIT) & (relative > MISFIT_RELATIVE) & inside)


def _band(low_Hz: float, high_Hz: float) -> str:
    return f"{low_Hz:.3g} Hz" if low_Hz == high_Hz else f"{low_Hz:.3g}-{high_Hz:.3g} Hz"


def advice(grips: Sequence[Grip], model: Model, instrument: Instrument, played_N: Sequence[float]) -> list[str]:
    """Sentences that tell what to record again, and where."""
    sentences = []
    for grip in grips:
        for band in incoherent_bands(grip.response):
            sentences.append(
                f"coherence low at {_band(*band)} at {called(grip.grip_N)}: sweep there, with more current (record "
                "sweep --low, --high, --amplitude)"
            )
        for band in lack_of_fit(grip.response, model, instrument):
            sentences.append(
                f"lack of fit at {_band(*band)} at {called(grip.grip_N)}: more than noise; record this grip again, "
                "held steadily, or try --kind state_space with a higher --order"
            )
    held = [grip.grip_N for grip in grips if grip.grip_N > 0]
    if held and len(held) == len(grips):
        sentences.append(
            "no free device: record it too (record sweep --grips 0): it tells the drive's masses from the hand's"
        )
    if len(held) == 1:
        sentences.append(
            f"one held grip, {held[0]:.3g} N: the hand is taken to be the same at all; record at least three"
        )
    for wanted in played_N:
        if wanted > 0 and held and not held[0] * 0.9 <= wanted <= held[-1] * 1.1:
            sentences.append(
                f"the scene plays {wanted:g} N, recorded are {held[0]:.3g} to {held[-1]:.3g} N: record there"
            )
        if wanted == 0 and len(held) == len(grips):
            sentences.append("the scene plays the free device, which was not recorded: record at grip 0")
    return sentences


def about_chain(fit: ChainFit, own_hands: Sequence[GripFit]) -> list[str]:
    """Sentences on weaknesses of the chain's fit: undetermined parameters, a hand not linear in grip, lone starts."""
    sentences = [f"{name} ended at its bound: these records do not determine it" for name in fit.at_bounds]
    for name, sigma in fit.unidentified.items():
        if name not in fit.at_bounds:
            factor = factor_of(sigma)
            known = f"is known to a factor of {factor:.2g} only" if factor < RANGE else "is open"
            sentences.append(f"{name} {known}: these records do not determine it")
    sentences += [
        f"the hand at {own.grip_N:.3g} N is not on the lines of all grips (up to {own.difference_dB:.2g} dB off): "
        "record this grip again, or more grips beside it"
        for own in own_hands
        if own.difference_dB > NOT_LINEAR_DB and own.scatter > MISFIT
    ]
    if fit.agreeing == 1 and fit.starts > 1 and fit.scatter > MISFIT:
        sentences.append(f"only one of {fit.starts} starts led to this device: give a --scene nearer to yours")
    return sentences
