"""Identification of a device: the chain of maximum likelihood, a black box if no chain fits, and a verdict."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from transopt.base.errors import InputError
from transopt.identify.checks import begun_late, by_grip, within
from transopt.identify.device import chain_fit, cleaned, effects, findings, trials, validation
from transopt.identify.device.black_box import BlackBox, fit_black_box
from transopt.identify.device.chain import DriveChain, GripResponse
from transopt.identify.device.response import Instrument
from transopt.identify.device.result import Candidate, DeviceResult, Kind, device_part
from transopt.identify.findings import COHERENT, Finding
from transopt.identify.measurement import Measurement
from transopt.identify.spectrum import Trial, check_rates
from transopt.plant.amplifier import Amplifier
from transopt.plant.state_space import StateSpace
from transopt.scene.model_error import ModelError
from transopt.scene.model_parts import DriveDevice, StateSpaceDevice

MOST_STEPS = 4  # Gauss-Newton steps of a drift: one of four samples at a record's end takes all
PREFERENCE = 0.9  # largest error over the chain's at which a black box is chosen: a chain's parameters are physical


@dataclass(frozen=True)
class Settings:
    """What is known beforehand, and what the user asks for.

    Attributes
    ----------
    nominal : device to start from, with the known force per ampere.
    scene_plant : plant at a grip, to check units with; None to skip the check.
    amplifier : identified or known amplifier; None if ideal.
    kind, order : kind and order of the model; None chooses an order.
    played_N : grips that the scene plays.
    random_starts : number of random starts of the chain's fit.
    taps : function that designs the taps of the scene with a model; None without a scene.
    servo_s : stated period of the device's servo; None if unknown.
    """

    nominal: DriveChain
    scene_plant: Callable[[float], StateSpace] | None
    amplifier: Amplifier | None
    kind: Kind = Kind.AUTO
    order: int | None = None
    played_N: tuple[float, ...] = ()
    random_starts: int = chain_fit.RANDOM_STARTS
    taps: Callable[[DriveDevice | StateSpaceDevice], validation.Taps | None] | None = None
    servo_s: float | None = None


def identify(
    runs: Sequence[Measurement],
    transients: Sequence[Measurement],
    settings: Settings,
    *,
    tick: Callable[[str], None] = lambda _: None,
) -> DeviceResult:
    """Identify a device: estimate responses, fit both kinds of model, validate them, and advise what to record again.

    Parameters
    ----------
    runs : sweeps.
    transients : for validation only.
    settings : prior knowledge and the user's choices.
    tick : called with the name of each finished step.

    Raises
    ------
    InputError : records that cannot be used, or an order out of range.
    """
    repeated = [run for run in runs if run.period_s is not None]
    records, transients, late = _ready(runs, transients, settings, tick)
    records, chain, box, drift = _fitted(records, repeated, settings, tick)
    if drift is not None:
        transients = cleaned.without_drift(transients, drift.relative)
    chosen, *others = _candidates(records, chain, box, tick)
    grips, found = records.grips, [*late, *records.findings]
    error, used = _at_use(chosen, transients, [grip.grip_N for grip in grips])
    everything = [*(run for grip in grips for run in (*grip.fitted, *grip.kept)), *transients, *repeated]
    error = error.model_copy(update={"recorded_A": [_largest_A(grip.grip_N, everything) for grip in grips]})
    own_hands = [] if chain is None else chain_fit.fit_per_grip(chain, _measured(records), least_coherence=COHERENT)
    advised = findings.advice(grips, chosen.model, chosen.instrument, settings.played_N)
    if chain is not None and chosen.kind is Kind.DRIVE:
        advised += findings.about_chain(chain, own_hands)
    causes, wrong = ["clock"], findings.two_clocks(records.instrument.dt_s, settings.servo_s)
    apart = findings.scales_apart(chain, chosen)
    if not wrong:  # with a wrong clock, an apparent gain or pole would only compensate for it
        longest = max(run.require("acceleration").values.size for grip in grips for run in grip.fitted)
        beside_it = [] if drift is None else [drift.finding(longest)]
        beside_it += findings.causes_of(chosen, chain, grips, used, error, repeated) + findings.noise_findings(grips)
        if chain is not None and box is not None and chosen.kind is Kind.STATE_SPACE:
            beside_it.append(findings.beyond_a_chain(box))
        causes = [one.cause for one in beside_it if one.cause]
        found += beside_it + findings.distorted(repeated)
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
        findings=found,
        advice=advised,
        short=[*wrong, *apart],
    )
    taps = None if settings.taps is None else settings.taps(device_part(result))
    if taps is None:
        return result
    tick("verdict")
    predicted = validation.predict_taps(error, taps)
    uncovered = validation.not_covered(error, taps)
    short = [*result.short, *validation.short_of(predicted)]
    return replace(result, predicted=predicted, short=short, uncovered=uncovered)


def _ready(
    runs: Sequence[Measurement],
    transients: Sequence[Measurement],
    settings: Settings,
    tick: Callable[[str], None],
) -> tuple[trials.Records, Sequence[Measurement], list[Finding]]:
    """Records to fit, transients to validate with, and findings."""
    sweeps = [run for run in runs if run.period_s is None and not run.held_out]
    if not sweeps:
        raise InputError(
            f"device: none of the {len(runs)} files is a sweep to fit to, all are held out or repeat (held_out, "
            "period_s): give the sweeps too"
        )
    transients = [*transients, *(run for run in runs if run.held_out and run.period_s is None)]
    begun = {id(run): begun_late(run) for run in transients}
    kept = [run for run in transients if not begun[id(run)]]
    late = [one for each in begun.values() for one in each]
    moved, judged, delayed = _on_one_clock(sweeps, kept, settings)
    records = trials.sort_trials(
        moved, judged, settings.amplifier, settings.scene_plant, tick=lambda: tick("responses")
    )
    return records, judged, [*late, *delayed]


def _measured(records: trials.Records) -> list[GripResponse]:
    return [grip.response for grip in records.grips]


def _fitted(
    records: trials.Records, repeated: Sequence[Measurement], settings: Settings, tick: Callable[[str], None]
) -> tuple[trials.Records, chain_fit.ChainFit | None, BlackBox | None, cleaned.Drift | None]:
    """The records without drift and leakage, the models (the kind asked for, or both if either may be better), and
    the drift."""
    chain: chain_fit.ChainFit | None = None
    box: BlackBox | None = None
    drift: cleaned.Drift | None = None
    held = any(grip.grip_N > 0 for grip in records.grips)
    if settings.kind is Kind.DRIVE or (settings.kind is Kind.AUTO and held):
        records, chain, drift = _fitted_chain(records, settings, tick)
        calm = [cleaned.without_leakage(grip, chain.device, chain.instrument) for grip in records.grips]
        if any(calm):
            records = replace(records, grips=[new or old for new, old in zip(calm, records.grips, strict=True)])
            chain = chain_fit.refit(chain, _measured(records))
        if drift is not None:
            # One standard deviation of the drift moves all unknowns together.
            moves, maximum = cleaned.drift_of(records.grips, chain).moves, chain.maximum
            covariance = maximum.covariance + np.outer(moves, moves)
            chain = replace(chain, maximum=replace(maximum, covariance=covariance))
    if settings.kind is Kind.STATE_SPACE or (settings.kind is Kind.AUTO and _worth_a_box(chain, repeated)):
        box = fit_black_box(_measured(records), records.instrument, settings.order, tick=lambda: tick("state space"))
    return records, chain, box, drift


def _fitted_chain(
    records: trials.Records, settings: Settings, tick: Callable[[str], None]
) -> tuple[trials.Records, chain_fit.ChainFit, cleaned.Drift | None]:
    """The chain, fitted again to records without drift of the accelerometer's clock if they show one."""

    def fitted(to: trials.Records) -> chain_fit.ChainFit:
        return chain_fit.fit_chain(
            _measured(to),
            to.instrument,
            settings.nominal,
            random_starts=settings.random_starts,
            tick=lambda: tick("drive chain"),
        )

    first = fit = fitted(records)
    steady, whole = records, 0.0
    for _ in range(MOST_STEPS):
        step = cleaned.drift_of(steady.grips, fit)
        if not step.shows:
            break
        whole += step.relative
        moved = [cleaned.grip_without_drift(grip, whole, records.instrument) for grip in records.grips]
        steady = replace(records, grips=moved, between=cleaned.without_drift(records.between, whole))
        fit = fitted(steady)
    # A device that is not a chain is fitted better with any drift: take it only if it explains most of the misfit.
    if whole == 0 or (fit.scatter > chain_fit.WHOLLY and first.scatter < chain_fit.BETTER * fit.scatter):
        return records, first, None
    return steady, fit, replace(step, relative=whole)


def _candidates(
    records: trials.Records, chain: chain_fit.ChainFit | None, box: BlackBox | None, tick: Callable[[str], None]
) -> list[Candidate]:
    """The validated models, the better one first."""
    measured, found = _measured(records), []
    if chain is not None:
        error = validation.model_error(
            measured, chain.device, chain.instrument, lambda one: chain_fit.response_variance(chain, one)
        )

        def refitted(grip_N: float) -> validation.Model:
            return chain_fit.refit(chain, [one for one in measured if one.grip_N != grip_N]).device

        found.append(_validated(Kind.DRIVE, chain.device, chain.instrument, refitted, records, error))
        tick("validation")
    if box is not None:
        error = validation.model_error(measured, box, records.instrument, lambda one: (box.variance(one),) * 2)
        found.append(_validated(Kind.STATE_SPACE, box, records.instrument, box.without, records, error))
        tick("validation")
    return found[::-1] if len(found) > 1 and found[1].off < PREFERENCE * found[0].off else found


def _worth_a_box(chain: chain_fit.ChainFit | None, repeated: Sequence[Measurement]) -> bool:
    """Whether a black box may fit better: there is no chain, or no nonlinear effect explains the chain's residual."""
    return chain is None or (chain.scatter > chain_fit.EXPLAINED and not effects.named_by_lines(chain, repeated))


def _at_use(
    chosen: Candidate, runs: Sequence[Measurement], recorded_N: Sequence[float]
) -> tuple[ModelError, list[effects.Missed]]:
    """Error of the chosen model, taps at the amplitude of use included, and the residual of each such record."""
    known = [run for run in runs if run.grip_N is not None and within(run.grip_N, recorded_N)]
    used = [effects.missed(chosen.model, run.grip_N or 0.0, chosen.instrument, run) for run in known]
    return chosen.error.model_copy(update={"at_use": effects.at_use(used, chosen.error)}), used


def _largest_A(grip_N: float, runs: Sequence[Measurement]) -> float:
    """Largest current of the runs at a grip; the largest command where no current was measured."""
    signals = [run.current or run.command for run in runs if trials.recorded_at(run, [grip_N]) is not None]
    return max((float(np.abs(each.values).max(initial=0.0)) for each in signals if each is not None), default=0.0)


def _on_one_clock(
    runs: Sequence[Measurement], transients: Sequence[Measurement], settings: Settings
) -> tuple[Sequence[Measurement], Sequence[Measurement], list[Finding]]:
    """Runs and transients with a pure delay of the acceleration's channel removed, and a finding if there was one."""
    both = [*runs, *transients]
    instrument = trials.instrument_of(both, settings.amplifier)
    if any(run.grip_N is None for run in both) or check_rates(
        [Trial(run.name, x, x) for run in both if (x := run.acceleration) is not None]
    ):
        return runs, transients, []  # `sort_trials` refuses them and names the file
    samples = cleaned.delay_samples(runs, settings.amplifier, settings.nominal.plant, instrument)
    if samples == 0:
        return runs, transients, []
    moved = cleaned.without_delay(both, samples)
    return moved[: len(runs)], moved[len(runs) :], [cleaned.finding(samples, instrument.dt_s)]


def _validated(
    kind: Kind,
    model: validation.Model,
    instrument: Instrument,
    without: Callable[[float], validation.Model],
    records: trials.Records,
    error: ModelError,
) -> Candidate:
    """Errors at recorded grips, at inner grips with the model `without` them, and at grips with transients only."""
    grips = records.grips
    between = {
        grip.grip_N: validation.together(
            [validation.compare(without(grip.grip_N), grip.grip_N, instrument, run) for run in grip.kept]
        )
        for grip in [grip for grip in grips if grip.grip_N > 0][1:-1]
        if grip.kept
    }
    for grip_N, group in by_grip(records.between).items():
        between[grip_N] = validation.together([validation.compare(model, grip_N, instrument, run) for run in group])
    return Candidate(
        kind=kind,
        model=model,
        instrument=instrument,
        transients={
            grip.grip_N: [validation.compare(model, grip.grip_N, instrument, run) for run in grip.kept]
            for grip in grips
        },
        between=dict(sorted(between.items())),
        error=error,
        off=validation.relative(error, [grip.response for grip in grips]),
    )
