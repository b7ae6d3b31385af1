"""Identification of a device: the likeliest chain, a black box where no chain explains the records, and a verdict."""

from collections.abc import Callable, Sequence
from dataclasses import astuple, dataclass, replace
from enum import StrEnum
from typing import Any

import numpy as np

from transopt.base.signals import FloatArray
from transopt.identify.checks import COHERENT, Fault, Finding, by_grip, check_rates, runs_of
from transopt.identify.device.black_box import BlackBox, fit_black_box
from transopt.identify.device.chain import HAND, SHARED, DriveChain
from transopt.identify.device.chain_fit import (
    EXPLAINED,
    RANDOM_STARTS,
    RANGE,
    ChainFit,
    GripFit,
    GripResponse,
    fit_chain,
    fit_per_grip,
    refit,
    response_variance,
)
from transopt.identify.device.delay import delay_samples, finding, without_delay
from transopt.identify.device.effects import (
    CROSSOVER,
    SHORTFALL,
    Missed,
    at_use,
    current_missed,
    distortion,
    missed,
    named,
    named_by_lines,
)
from transopt.identify.device.noise import noise_findings
from transopt.identify.device.response import Instrument, sampled_response
from transopt.identify.device.slow import without_leakage
from transopt.identify.device.trials import (
    BAND_HZ,
    Grip,
    Records,
    instrument_of,
    low_coherence,
    sort_trials,
)
from transopt.identify.device.validation import Model, Transient, called, compare, together
from transopt.identify.device.verdict import Taps, model_error, predict_taps, relative, short_of, verdict
from transopt.identify.measurement import Measurement
from transopt.identify.spectrum import Trial
from transopt.plant.amplifier import Amplifier
from transopt.plant.state_space import StateSpace
from transopt.scene.model_error import ModelError, Predicted
from transopt.scene.model_parts import DriveDevice, StateSpaceDevice

PREFERENCE = 0.9  # a black box must be that much better than the chain, whose parameters mean something
MISFIT, MISFIT_RELATIVE = 3.0, 0.06  # mean square residual, and mean error (0.5 dB), from where the fit is lacking
SMOOTHED_BINS = 9
NOT_LINEAR_DB = 1.0  # between the hand of one grip and the functions of all, from where the user is warned
READ_LATE = 0.02  # samples, from which on it is said
RINGS, MOST_HZ = 0.3, 2000.0  # damping ratio of a resonance, and the highest that is named
DISTORTED = 0.01  # of the answer, from which on distortion is said
CLOCKS_ALIKE, CLOCKS_APART = 1e-3, 0.05  # relative: closer is one clock, farther another rate
SIGMAS = 1.959964  # 95 %
REMEDIES = {
    "friction": "refine the library on the device (transopt-play refine), or loosen bearings and guides",
    "backlash": "preload the transmission; no library makes up for play",
    "stiffening": "record at the amplitude that is played, and refine the library on the device",
}


class Kind(StrEnum):
    """Which model to fit; AUTO fits both and keeps the better one."""

    AUTO = "auto"
    DRIVE = "drive"
    STATE_SPACE = "state_space"


@dataclass(frozen=True)
class Candidate:
    """One kind of model, fitted and validated.

    Attributes
    ----------
    kind : of model.
    model : gives the plants of a grip.
    instrument : what stood between it and the records.
    transients : grip -> those of its transients that were kept out of the fit.
    between : NRMSE at grips that the model does not know: those with transients only, and inner held ones by the
        same kind of model fitted without them.
    error : how far its response is off.
    off : the same as a part of the answer to a current of even spectrum.
    """

    kind: Kind
    model: Model
    instrument: Instrument
    transients: dict[float, list[Transient]]
    between: dict[float, float]
    error: ModelError
    off: float

    @property
    def recorded(self) -> dict[float, float]:
        """Grip -> NRMSE of what was kept out; NaN where nothing was."""
        return {grip: together(runs) for grip, runs in self.transients.items()}


@dataclass(frozen=True)
class DeviceResult:
    """What identification found.

    Attributes
    ----------
    grips : with their responses.
    chosen : the better candidate.
    other : the other one; None where only one kind was asked for or possible.
    chain : the fit behind the drive chain, if there is one.
    own_hands : its lack of fit by grip.
    black_box : the fit behind the state space, if there is one.
    error : how far the response of the chosen one is off, and what taps at the amplitude of use missed beyond it.
    predicted : what that makes of the scene's taps; None where no scene was named.
    causes : what was found to be in the records or the device beside the model, by name.
    findings : of the records.
    advice : what to record again, where.
    short : why the result is not good enough.
    """

    grips: list[Grip]
    chosen: Candidate
    other: Candidate | None
    chain: ChainFit | None
    own_hands: list[GripFit]
    black_box: BlackBox | None
    error: ModelError
    predicted: Predicted | None
    causes: list[str]
    findings: list[Finding]
    advice: list[str]
    short: list[str]

    @property
    def residuals(self) -> list[float]:
        """Of the chosen model by grip: mean square over the noise's."""
        if self.chosen.kind is Kind.STATE_SPACE:
            assert self.black_box is not None
            return [float(value) for value in self.black_box.scatter]
        assert self.chain is not None
        maximum = self.chain.maximum
        return [float(value) for value in maximum.chi_square.sum(axis=1) / maximum.points.sum(axis=1)]

    @property
    def verdict(self) -> str:
        """One sentence for the model file and for the user: how far the chosen model can be relied upon."""
        words = [verdict(self.predicted, self.chosen.recorded)]
        if self.chosen.kind is Kind.DRIVE and self.chain is not None:
            words += _not_the_devices(self.chain)
        return "; ".join(words)


@dataclass(frozen=True)
class Settings:
    """What is known or asked for.

    Attributes
    ----------
    nominal : device to start from, with the known force per ampere.
    scene_plant : to check units by; None for none.
    amplifier : identified or known; None is ideal.
    kind, order : of the model; order None finds one.
    played_N : grips that the scene plays.
    random_starts : of the chain's fit.
    taps : designs the taps of the scene with a model; None where no scene is to be played.
    servo_s : period that the device's servo is said to have; None where nobody says.
    """

    nominal: DriveChain
    scene_plant: Callable[[float], StateSpace] | None
    amplifier: Amplifier | None
    kind: Kind = Kind.AUTO
    order: int | None = None
    played_N: tuple[float, ...] = ()
    random_starts: int = RANDOM_STARTS
    taps: Callable[[DriveDevice | StateSpaceDevice], Taps | None] | None = None
    servo_s: float | None = None


def identify(
    runs: Sequence[Measurement],
    transients: Sequence[Measurement],
    settings: Settings,
    *,
    tick: Callable[[str], None] = lambda _: None,
) -> DeviceResult:
    """Responses, both fits, validation, advice.

    Parameters
    ----------
    runs : sweeps.
    transients : for validation only.
    settings : what is known or asked for.
    tick : called with what was just done.

    Raises
    ------
    InputError : records that cannot be used, an order that cannot be.
    """
    repeated = [run for run in runs if run.period_s is not None]
    transients = [*transients, *(run for run in runs if run.held_out and run.period_s is None)]
    runs = [run for run in runs if run.period_s is None and not run.held_out]
    runs, transients, late = _on_one_clock(runs, transients, settings)
    records = sort_trials(runs, transients, settings.amplifier, settings.scene_plant, tick=lambda: tick("responses"))
    grips = records.grips
    measured = [grip.response for grip in grips]
    held = any(grip.grip_N > 0 for grip in grips)
    chain: ChainFit | None = None
    box: BlackBox | None = None
    if settings.kind is Kind.DRIVE or (settings.kind is Kind.AUTO and held):
        chain = fit_chain(
            measured,
            records.instrument,
            settings.nominal,
            random_starts=settings.random_starts,
            tick=lambda: tick("drive chain"),
        )
        calm = [without_leakage(grip, chain.device, chain.instrument) for grip in grips]
        if any(calm):
            grips = [new or old for new, old in zip(calm, grips, strict=True)]
            measured = [grip.response for grip in grips]
            records = replace(records, grips=grips)
            chain = refit(chain, measured)
    if settings.kind is Kind.STATE_SPACE or (settings.kind is Kind.AUTO and _worth_a_box(chain, repeated)):
        box = fit_black_box(measured, records.instrument, settings.order, tick=lambda: tick("state space"))
    candidates = []
    if chain is not None:
        candidates.append(_validated_chain(chain, records, measured))
        tick("validation")
    if box is not None:
        candidates.append(_validated_box(box, records, measured))
        tick("validation")
    chosen, *others = candidates
    if others and others[0].off < PREFERENCE * chosen.off:
        chosen, others = others[0], [chosen]
    own_hands = [] if chain is None else fit_per_grip(chain, measured, least_coherence=COHERENT)
    error, used = _at_use(chosen, transients, [grip.grip_N for grip in grips])
    causes, found = _causes(chosen, chain, grips, used, error, repeated)
    found += noise_findings(grips)
    if chain is not None and box is not None and chosen.kind is Kind.STATE_SPACE:
        found.append(_beyond_a_chain(box))
    found += [said for run in repeated if (said := _distorted(run)) is not None]
    advice = _advice(grips, chosen, settings.played_N)
    if chain is not None and chosen.kind is Kind.DRIVE:
        advice += _about_chain(chain, own_hands)
    result = DeviceResult(
        grips=grips,
        chosen=chosen,
        other=others[0] if others else None,
        chain=chain,
        own_hands=own_hands,
        black_box=box,
        error=error,
        predicted=None,
        causes=causes,
        findings=[*late, *records.findings, *found],
        advice=advice,
        short=[],
    )
    wrong = _two_clocks(records.instrument.dt_s, settings.servo_s)
    if wrong:
        # What else was found (a gain, a pole) makes up for the clock.
        result = replace(result, causes=["clock"], findings=[*late, *records.findings], short=wrong)
    taps = None if settings.taps is None else settings.taps(device_part(result))
    if taps is None:
        return result
    tick("verdict")
    predicted = predict_taps(error, taps)
    return replace(result, predicted=predicted, short=[*wrong, *short_of(predicted)])


def _two_clocks(recorded_s: float, servo_s: float | None) -> list[str]:
    """Why records cannot serve whose rate is almost, but not quite, the servo's: one of two clocks is wrong."""
    if servo_s is None or not CLOCKS_ALIKE < abs(recorded_s / servo_s - 1) < CLOCKS_APART:
        return []
    return [
        f"clock: the files state {1 / recorded_s:.6g} samples per second, the scene's servo has {1 / servo_s:.6g}: "
        f"one of the two is {100 * abs(recorded_s / servo_s - 1):.2g} % off, and with it every spring and mass; "
        "state the servo's own time in the files, or its period in the scene (time.dt_s)"
    ]


def _worth_a_box(chain: ChainFit | None, repeated: Sequence[Measurement]) -> bool:
    """Whether a black box could do better: where a chain leaves something unexplained that is linear."""
    return chain is None or (chain.scatter > EXPLAINED and not named_by_lines(chain, repeated))


def _at_use(
    chosen: Candidate, runs: Sequence[Measurement], recorded_N: Sequence[float]
) -> tuple[ModelError, list[Missed]]:
    """How far the chosen model is off, taps at the amplitude of use included, and what each such record missed."""
    known = [run for run in runs if run.grip_N is not None and _within(run.grip_N, recorded_N)]
    used = [missed(chosen.model, run.grip_N or 0.0, chosen.instrument, run) for run in known]
    return chosen.error.model_copy(update={"at_use": at_use(used, chosen.error)}), used


def _within(grip_N: float, recorded_N: Sequence[float]) -> bool:
    alike = [grip for grip in recorded_N if (grip > 0) == (grip_N > 0)]
    return bool(alike) and min(alike) <= grip_N <= max(alike)


def _distorted(run: Measurement) -> Finding | None:
    """What the detection lines of a periodic record say; None where they are quiet."""
    found = distortion(run)
    if found is None or found.largest < DISTORTED:
        return None
    return Finding(Fault.BESIDE, run.name, found.words(), False)


def _causes(
    chosen: Candidate,
    chain: ChainFit | None,
    grips: Sequence[Grip],
    used: Sequence[Missed],
    error: ModelError,
    repeated: Sequence[Measurement],
) -> tuple[list[str], list[Finding]]:
    """What the records have beside the model, by name, and what to do about it."""
    found: list[tuple[str, Finding]] = []

    def say(cause: str, where: str, text: str) -> None:
        found.append((cause, Finding(Fault.BESIDE, where, text, False)))

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
                    f"{one.value:.4g} times what the encoder says: taken for the accelerometer's gain and taken out; "
                    "check the scales of both"
                )
                say("accelerometer gain", "acceleration", text)
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
    by_lines = [] if chain is None else named_by_lines(chain, repeated)
    for cause, share in by_lines:
        told = "neither friction nor stiffening explains" if cause == "backlash" else "explains"
        text = f"{told} {100 * share:.0f} % of what sounds at lines that were not excited: {REMEDIES[cause]}"
        say(cause, "multisines", text)
    loud = [one for one, tap in zip(used, error.at_use, strict=True) if tap.excess]
    if loud:
        worst = max(tap.excess for tap in error.at_use)
        currents = [current_missed(chosen.instrument, one.run) for one in loud]
        fallen, crossover_A = (max(values) for values in zip(*map(astuple, currents), strict=True))
        if fallen > SHORTFALL:
            text = (
                f"the current falls {100 * fallen:.2g} % short of the largest command: lower limits.current_A, or "
                "raise the supply"
            )
            say("amplifier saturation", "current_A", text)
        elif crossover_A > CROSSOVER:
            text = (
                f"the amplifier follows no command below {1e3 * crossover_A:.2g} mA, so small currents lose most: "
                "identify the amplifier too, and refine the library on the device"
            )
            say("amplifier crossover", "current_A", text)
        listened = any(distortion(run) is not None for run in repeated)  # detection lines know better than taps
        if chain is not None and not listened:
            for cause, share in named(chain, loud):
                text = (
                    f"explains {100 * share:.0f} % of what taps at full current miss ({100 * worst:.2g} %): "
                    f"{REMEDIES[cause]}"
                )
                say(cause, "taps at full current", text)
    return [cause for cause, _ in found], [finding for _, finding in found]


def _on_one_clock(
    runs: Sequence[Measurement], transients: Sequence[Measurement], settings: Settings
) -> tuple[Sequence[Measurement], Sequence[Measurement], list[Finding]]:
    """Runs and transients without a pure delay of the acceleration's channel, and what was done."""
    together = [*runs, *transients]
    instrument = instrument_of(together, settings.amplifier)
    if any(run.grip_N is None for run in together) or check_rates(
        [Trial(run.name, x, x) for run in together if (x := run.acceleration) is not None]
    ):
        return runs, transients, []  # refused by name when they are sorted
    samples = delay_samples(runs, settings.amplifier, settings.nominal.plant, instrument)
    if samples == 0:
        return runs, transients, []
    moved = without_delay(together, samples)
    return moved[: len(runs)], moved[len(runs) :], [finding(samples, instrument.dt_s)]


def _validated(
    kind: Kind,
    model: Model,
    instrument: Instrument,
    without: Callable[[float], Model],
    records: Records,
    error: ModelError,
) -> Candidate:
    """Errors at recorded grips, at inner ones by the model `without` them, and at grips that have transients only."""
    grips = records.grips
    between = {
        grip.grip_N: together([compare(without(grip.grip_N), grip.grip_N, instrument, run) for run in grip.kept])
        for grip in [grip for grip in grips if grip.grip_N > 0][1:-1]
        if grip.kept
    }
    for grip_N, group in by_grip(records.between).items():
        between[grip_N] = together([compare(model, grip_N, instrument, run) for run in group])
    return Candidate(
        kind=kind,
        model=model,
        instrument=instrument,
        transients={
            grip.grip_N: [compare(model, grip.grip_N, instrument, run) for run in grip.kept] for grip in grips
        },
        between=dict(sorted(between.items())),
        error=error,
        off=relative(error, [grip.response for grip in grips]),
    )


def _validated_chain(fit: ChainFit, records: Records, measured: Sequence[GripResponse]) -> Candidate:
    """The drive chain, at inner grips by a fit without them that begins where this one ended."""

    def without(grip_N: float) -> Model:
        return refit(fit, [one for one in measured if one.grip_N != grip_N]).device

    error = model_error(measured, fit.device, fit.instrument, lambda one: response_variance(fit, one))
    return _validated(Kind.DRIVE, fit.device, fit.instrument, without, records, error)


def _validated_box(box: BlackBox, records: Records, measured: Sequence[GripResponse]) -> Candidate:
    """The black box; as many real unknowns as twice its order share the information of all lines evenly."""

    def variance(one: GripResponse) -> tuple[FloatArray, FloatArray]:
        known = 2 * one.deviation**2 * box.order / one.deviation.size
        return known, known

    error = model_error(measured, box, records.instrument, variance)
    return _validated(Kind.STATE_SPACE, box, records.instrument, box.without, records, error)


def lack_of_fit(response: GripResponse, model: Model, instrument: Instrument) -> list[tuple[float, float]]:
    """Bands [Hz] where the model is off by more than the noise explains and by more than half a decibel."""
    e = response.estimate
    modelled = np.zeros(e.frequencies_Hz.size, dtype=complex)
    for plant, weight in model.shares(response.grip_N):
        modelled += weight * sampled_response(plant, instrument, e.frequencies_Hz)[0]
    error, window = modelled - e.response, np.ones(min(SMOOTHED_BINS, e.response.size))
    count = np.convolve(np.ones(error.size), window, "same")
    surprise = np.convolve(np.abs(error / response.deviation) ** 2 / 2, window, "same") / count
    relative = np.abs(np.convolve(error / e.response, window, "same")) / count
    inside = (e.frequencies_Hz >= BAND_HZ[0]) & (e.frequencies_Hz <= BAND_HZ[1])
    return runs_of(e.frequencies_Hz, (surprise > MISFIT) & (relative > MISFIT_RELATIVE) & inside)


def _beyond_a_chain(box: BlackBox) -> Finding:
    """What a black box has that no chain of drive and hand makes: its resonances at the middle grip, for the user."""
    poles = np.linalg.eigvals(box.plants[len(box.plants) // 2].A)
    rings = (poles.imag > 0) & (-poles.real < RINGS * np.abs(poles))
    named_Hz = sorted(np.abs(poles[rings]) / (2 * np.pi))
    at = ", ".join(f"{value:.3g} Hz" for value in named_Hz if BAND_HZ[0] <= value <= MOST_HZ)
    text = (
        f"no chain of drive and hand makes what is recorded; resonances of the state space: {at or 'none'}; "
        "a part that swings by itself, or a hand that goes its own way with the grip: tighten what is loose"
    )
    return Finding(Fault.BESIDE, "further dynamics", text, False)


def _band(low_Hz: float, high_Hz: float) -> str:
    return f"{low_Hz:.3g} Hz" if low_Hz == high_Hz else f"{low_Hz:.3g}-{high_Hz:.3g} Hz"


def _advice(grips: Sequence[Grip], chosen: Candidate, played_N: Sequence[float]) -> list[str]:
    """What to record again, and where."""
    said = []
    for grip in grips:
        for band in low_coherence(grip.response):
            said.append(
                f"coherence low at {_band(*band)} at {called(grip.grip_N)}: sweep longer there, or add trials"
            )
        for band in lack_of_fit(grip.response, chosen.model, chosen.instrument):
            said.append(
                f"lack of fit at {_band(*band)} at {called(grip.grip_N)}: more than noise; record this grip again, "
                "held steadily, or try --kind state_space with a higher --order"
            )
    held = [grip.grip_N for grip in grips if grip.grip_N > 0]
    if held and len(held) == len(grips):
        said.append(
            "no free device: record it too (record sweep --grips 0): it tells the drive's masses from the hand's"
        )
    if len(held) == 1:
        said.append(f"one held grip, {held[0]:.3g} N: the hand is taken to be the same at all; record at least three")
    for wanted in played_N:
        if wanted > 0 and held and not held[0] * 0.9 <= wanted <= held[-1] * 1.1:
            said.append(f"the scene plays {wanted:g} N, recorded are {held[0]:.3g} to {held[-1]:.3g} N: record there")
        if wanted == 0 and len(held) == len(grips):
            said.append("the scene plays the free device, which was not recorded: record at grip 0")
    return said


def _not_the_devices(fit: ChainFit) -> list[str]:
    """Why parameters that predict well may be no masses, springs and dampers of the device all the same."""
    said = []
    if fit.scatter > MISFIT:
        said.append(
            f"residuals of {fit.scatter:.2g} times the noise: the parameters make up for what the chain lacks "
            "(further masses, samples not read together, accelerometer_Hz), so that their intervals do not hold"
        )
    if fit.at_bounds:
        said.append(f"at a bound, so without meaning by themselves: {', '.join(fit.at_bounds)}")
    return said


def _about_chain(fit: ChainFit, own_hands: Sequence[GripFit]) -> list[str]:
    """What the fit itself says against its numbers."""
    said = [f"{name} ended at its bound: these records do not determine it" for name in fit.at_bounds]
    for name, sigma in fit.unidentified.items():
        if name not in fit.at_bounds:
            factor = _factor(sigma)
            known = f"is known to a factor of {factor:.2g} only" if factor < RANGE else "is open"
            said.append(f"{name} {known}: these records do not determine it")
    said += [
        f"the hand at {own.grip_N:.3g} N is not on the lines of all grips (up to {own.difference_dB:.2g} dB off): "
        "record this grip again, or more grips beside it"
        for own in own_hands
        if own.difference_dB > NOT_LINEAR_DB and own.scatter > MISFIT
    ]
    if fit.agreeing == 1 and fit.starts > 1 and fit.scatter > MISFIT:
        said.append(f"only one of {fit.starts} starts led to this device: give a --scene nearer to yours")
    return said


def device_part(result: DeviceResult) -> DriveDevice | StateSpaceDevice:
    """The chosen model as a model file holds it."""
    sources = [
        {"file": run.source, "sha256": run.sha256} for grip in result.grips for run in (*grip.fitted, *grip.kept)
    ]
    nrmse = {f"{grip:.6g}": error for grip, error in result.chosen.recorded.items() if np.isfinite(error)}
    common: dict[str, Any] = {"grips_N": [grip.grip_N for grip in result.grips], "nrmse": nrmse, "sources": sources}
    common["verdict"] = "; ".join([result.verdict, *result.short])
    common["shortfalls"] = list(result.short)
    common["causes"] = list(result.causes)
    common["error"] = result.error.model_dump()
    common["predicted"] = None if result.predicted is None else result.predicted.model_dump()
    if result.chosen.kind is Kind.STATE_SPACE:
        assert result.black_box is not None
        matrices = {
            part: [getattr(plant, part).tolist() for plant in result.black_box.plants]
            for part in ("A", "B", "C", "D")
        }
        return StateSpaceDevice.model_validate(
            {"kind": "state_space", "order": result.black_box.order, **matrices, **common}
        )
    assert result.chain is not None
    device = result.chain.device
    names, values, covariance = result.chain.stated()
    return DriveDevice.model_validate(
        {
            "kind": "drive",
            "force_per_current_N_A": device.force_per_current_N_A,
            **dict(zip(SHARED, device.shared.tolist(), strict=True)),
            "hand": {
                name: {"constant": constant, "per_newton": slope}
                for name, (constant, slope) in zip(HAND, device.hand.tolist(), strict=True)
            },
            "parameters": list(names),
            "covariance": covariance.tolist(),
            "intervals": intervals(names, values, covariance),
            **common,
        }
    )


def _factor(sigma: float) -> float:
    """Half the 95 % interval of a positive number from the deviation of its logarithm; at most the range searched."""
    return float(np.exp(min(SIGMAS * sigma, np.log(RANGE))))


def intervals(names: Sequence[str], values: FloatArray, covariance: FloatArray) -> dict[str, tuple[float, float]]:
    """95 % by name: of what must be positive on a logarithmic scale, of constants and slopes on a plain one."""
    found = {}
    for name, value, sigma in zip(names, values, np.sqrt(np.diag(covariance)), strict=True):
        if name in SHARED:
            factor = _factor(sigma / value)
            found[name] = (float(value / factor), float(value * factor))
        else:
            found[name] = (float(value - SIGMAS * sigma), float(value + SIGMAS * sigma))
    return found
