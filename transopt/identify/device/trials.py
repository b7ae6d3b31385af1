"""Prepare the records of a device for identification: sort them by grip, check them, hold some out for validation."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import fft

from transopt.base.errors import InputError
from transopt.base.signals import Signal
from transopt.identify.amplifier import fit_amplifier, fit_pole
from transopt.identify.amplifier_response import simulate_current
from transopt.identify.checks import (
    GRIP_STEP_N,
    PASSIVE_BAND_HZ,
    by_grip,
    check_bins,
    check_cycles,
    check_gravity,
    check_grips,
    check_measurement,
    check_passive,
    check_unit,
    runs_of,
    within,
)
from transopt.identify.condensed import Condensed, condense
from transopt.identify.device.chain import GripResponse
from transopt.identify.device.response import (
    ACCELERATION,
    CURRENT,
    POSITION,
    Instrument,
    current_response,
    sampled_response,
)
from transopt.identify.findings import COHERENT, LEAST_RATE_HZ, Check, Finding, refuse
from transopt.identify.measurement import Measurement
from transopt.identify.spectrum import TransferEstimate, Trial, check_rates, transfer
from transopt.plant.amplifier import Amplifier
from transopt.plant.state_space import StateSpace

QUANTITIES = ("command", "current", "acceleration")
LEAST_TO_HOLD_OUT = 3  # trials of a grip from which on one is held out for validation
LEAST_BINS = 30  # the first stage of a fit takes a fourth of the bins, which must outnumber a grip's unknowns
ALIKE = 0.5  # correlation of measured and expected signal above which sign and ratio are judged
MOST_GAIN = 2.0  # largest factor between current and command, and between position and acceleration, either way
LEAST_COUNTS = 2.0  # motion in counts of the encoder below which it shows its quantisation only
ONE_POLE = 3.0  # largest mean square of the current's residual over the noise for one pole and a delay to fit
CERTAIN = 6.0  # standard deviations by which rates from jittered time stamps may differ and still count as equal
MOST_LAG = 20  # ticks searched for a shift between command and current
BAND_HZ = (2.0, 800.0)  # band in which a design needs the model
FREE_BAND_HZ = (20.0, 800.0)  # below it a free device only drifts, beyond its stroke


@dataclass(frozen=True)
class Grip:
    """All runs at one grip.

    Attributes
    ----------
    grip_N : mean grip, 0 for the free device.
    response : response estimated from the fitted runs.
    fitted : runs that the model is fitted to.
    kept : runs held out for validation; may be empty.
    """

    grip_N: float
    response: GripResponse
    fitted: tuple[Measurement, ...]
    kept: tuple[Measurement, ...]


@dataclass(frozen=True)
class Records:
    """All records, sorted by grip.

    Attributes
    ----------
    grips : in increasing order.
    instrument : amplifier and accelerometer of the records.
    between : transients at grips without sweeps that lie between grips with sweeps.
    findings : findings that are not fatal.
    """

    grips: list[Grip]
    instrument: Instrument
    between: list[Measurement]
    findings: list[Finding]


def felt_current(run: Measurement, amplifier: Amplifier | None) -> Signal:
    """The measured current, or the known amplifier's response to the command.

    Raises
    ------
    InputError : neither was recorded.
    """
    if run.current is not None:
        return run.current
    if run.command is None:
        raise InputError(f"{run.name}: neither current_A nor command_A; record the measured current")
    command, dt = run.command.values, run.command.dt_s
    if amplifier is None:
        return Signal(run.command.start_s, dt, np.append(0.0, command[:-1]))
    return Signal(run.command.start_s, dt, simulate_current(command, amplifier.pole_Hz, amplifier.delay_s, dt))


def instrument_of(runs: Sequence[Measurement], amplifier: Amplifier | None) -> Instrument:
    """The amplifier and accelerometer of these records.

    Raises
    ------
    InputError : the files state different accelerometers, or the first has no acceleration.
    """
    poles = {run.name: run.accelerometer_Hz for run in runs}
    first = next(iter(poles))
    for name, pole in poles.items():
        if pole != poles[first]:
            raise InputError(
                f"{name}: accelerometer_Hz {pole}, {first} {poles[first]}: must be one sensor; state the same or none"
            )
    return Instrument(runs[0].require("acceleration").dt_s, amplifier, poles[first])


def _rate(run: Measurement) -> list[Finding]:
    rate_Hz = 1 / run.require("acceleration").dt_s
    return [] if rate_Hz >= LEAST_RATE_HZ else [Check.SLOW.at(run.name, rate_Hz=rate_Hz)]


def _current_against_command(run: Measurement, amplifier: Amplifier | None) -> list[Finding]:
    """Check a recorded current against the command for a wrong unit, a wrong sign, or a shift in time.

    A shift of whole ticks between current and acceleration looks like a device with other masses. A held-out record
    with the same shift does not reveal it; only the command does.
    """
    if run.command is None or run.current is None:
        return []
    modelled = felt_current(replace(run, current=None), amplifier).values
    modelled = modelled - modelled.mean()
    measured = run.current.values - run.current.values.mean()
    size, power = fft.next_fast_len(2 * measured.size, real=True), float(modelled @ modelled)
    if power == 0:
        return []
    along = fft.irfft(fft.rfft(measured, size) * fft.rfft(modelled, size).conj(), size)
    lags = np.concatenate([along[-MOST_LAG:], along[: MOST_LAG + 1]])
    best = int(np.argmax(np.abs(lags)))
    gain, lag = float(lags[best]) / power, best - MOST_LAG
    if not abs(gain) * np.sqrt(power) > ALIKE * float(np.linalg.norm(measured)):
        return [Check.CURRENT_UNLIKE.at(run.name)]
    if gain < 0:
        return [Check.CURRENT_TURNED.at(run.name)]
    if abs(np.log(gain)) > np.log(MOST_GAIN):
        return [Check.CURRENT_SCALE.at(run.name, gain=gain)]
    if lag == 0:
        return []
    return [Check.CURRENT_SHIFTED.at(run.name, samples=abs(lag), way="later" if lag > 0 else "earlier")]


def _odd_one_out(where: str, names: Sequence[str], estimate: TransferEstimate) -> list[Finding]:
    """Find a trial whose response has the opposite sign of the others or another unit; their mean would hide it."""
    if estimate.trials < 2:
        return []
    clear = estimate.coherence >= np.median(estimate.coherence) / 2
    each = estimate.trial_responses[:, clear]
    middle = np.median(np.abs(each), axis=0)
    reference = each[int(np.argmin([np.median(np.abs(np.abs(one) / middle - 1)) for one in each]))]
    found: list[Finding] = []
    signs = np.array([np.sum((one * reference.conj()).real / np.abs(reference) ** 2) for one in each])
    minority = 1.0 if np.sum(signs > 0) < np.sum(signs < 0) else -1.0
    for name, one, sign in zip(names, each, signs, strict=True):
        ratio = float(np.median(np.abs(one) / middle))
        found += _unlike(name, sign * minority > 0, ratio, f"the other trials of {where}")
    return found


def _unlike(name: str, turned: bool, ratio: float, others: str) -> list[Finding]:
    """Findings for a file whose response has the opposite sign (`turned`) of `others` or `ratio` times their size."""
    found = [Check.ANSWERS_TURNED.at(name, others=others)] if turned else []
    return found + check_unit(name, ratio, others)


def _against_response(run: Measurement, trial: Trial, estimate: TransferEstimate, where: str) -> list[Finding]:
    """Find a held-out run whose sign or unit contradicts the response of its grip.

    Such a run would look like an error of the model.
    """
    given, answer = fft.rfft(trial.input.values), fft.rfft(trial.output.values)
    lines = np.fft.rfftfreq(trial.input.values.size, trial.input.dt_s)
    f = estimate.frequencies_Hz
    inside = (lines >= f[0]) & (lines <= f[-1])
    expected = np.interp(lines[inside], f, estimate.response) * given[inside]
    found, along = answer[inside], float(np.vdot(expected, answer[inside]).real)
    size = float(np.linalg.norm(expected) * np.linalg.norm(found))
    if not abs(along) > ALIKE * size:
        return []  # too little correlation to judge
    ratio = abs(along) / float(np.linalg.norm(expected)) ** 2
    return _unlike(run.name, along < 0, ratio, f"the sweeps of {where}")


def _position_against_acceleration(where: str, response: GripResponse) -> list[Finding]:
    """Check sign and unit of the position where motor and stylus move as one: there y'' is the acceleration."""
    data = response.data
    if POSITION not in response.outputs:
        return []
    position, acceleration = (data.values()[response.outputs.index(row)] for row in (POSITION, ACCELERATION))
    low_Hz, high_Hz = PASSIVE_BAND_HZ
    inside = data.known[-1] & (data.middles_Hz >= low_Hz) & (data.middles_Hz <= high_Hz)
    lines = data.used & inside[:, None]
    path = -acceleration[lines] / (2 * np.pi * data.frequencies_Hz[lines]) ** 2
    along = float(np.median((position[lines] / path).real)) if path.size else 1.0
    if along < 0:
        return [Check.POSITION_TURNED.at(where)]
    return [] if 1 / MOST_GAIN <= along <= MOST_GAIN else [Check.POSITION_SCALE.at(where, ratio=along)]


def _one_rate(runs: Sequence[Measurement], first: Measurement) -> list[Measurement]:
    """The runs with the rate of `first` where theirs differs only by the jitter of their time stamps."""
    wanted = first.require("acceleration").dt_s

    def alike(run: Measurement) -> bool:
        x = run.require("acceleration")
        return abs(x.dt_s / wanted - 1) < CERTAIN * max(run.off_grid, first.off_grid) / x.values.size

    return [run.changed(lambda _, x: replace(x, dt_s=wanted)) if alike(run) else run for run in runs]


def sort_trials(
    runs: Sequence[Measurement],
    transients: Sequence[Measurement],
    amplifier: Amplifier | None,
    nominal: Callable[[float], StateSpace] | None,
    *,
    tick: Callable[[], None] = lambda: None,
) -> Records:
    """Sort and check the records: grips with their responses, held-out runs, and findings that are not fatal.

    Without `transients` the last trial of each grip with three or more is held out for validation.

    Parameters
    ----------
    runs : sweeps.
    transients : separate records for validation only.
    nominal : plant at a grip, to check the unit of the acceleration with; None to skip the check.
    tick : called after each grip.

    Raises
    ------
    InputError : a fatal finding, with what to record again.
    """
    runs, transients = _one_rate(runs, runs[0]), _one_rate(transients, runs[0])
    together = [*runs, *transients]
    found = refuse(finding for run in together for finding in _rate(run) + check_measurement(run, QUANTITIES))
    trials_of = {
        id(run): Trial(run.name, felt_current(run, amplifier), run.require("acceleration")) for run in together
    }
    found += refuse(check_rates(list(trials_of.values())) + check_grips(runs))
    found += refuse(f for f in check_grips(transients) if f.fatal)
    instrument = instrument_of(together, amplifier)
    if instrument.accelerometer_Hz is None:
        found.append(Check.BANDWIDTH.at("accelerometer_Hz"))
    groups, grips = by_grip(runs), list[Grip]()
    at = {id(run): recorded_at(run, list(groups)) for run in transients}
    outside = {id(run): _outside(run, list(groups)) for run in transients if at[id(run)] is None}
    found += [finding for each in outside.values() for finding in each]
    parts = dict[float, tuple[list[Measurement], list[Measurement]]]()
    for grip_N, group in groups.items():
        in_order = sorted(group, key=runs.index)
        if not transients and len(group) >= LEAST_TO_HOLD_OUT:
            parts[grip_N] = in_order[:-1], in_order[-1:]
        else:
            parts[grip_N] = in_order, [run for run in transients if at[id(run)] == grip_N]
    all_fitted = [fitted for fitted, _ in parts.values()]
    follows = current_follows(all_fitted, instrument)
    if not follows:
        instrument = replace(instrument, amplifier=_own_amplifier(all_fitted, amplifier))
    for grip_N, (fitted, kept) in parts.items():
        where = "the free device" if grip_N == 0 else f"{grip_N:.3g} N"
        response = response_of(grip_N, fitted, instrument, follows=follows)
        estimate = response.estimate
        # A record that is too short fails the other checks by chance, so its length is checked first.
        again = check_bins(where, estimate, LEAST_BINS)
        again += check_cycles(where, [trials_of[id(run)] for run in fitted], estimate, _band_Hz(grip_N)[0])
        for run in (*fitted, *kept):
            again += _current_against_command(run, amplifier)
        again += _odd_one_out(where, [run.name for run in fitted], estimate)
        again += check_passive(where, estimate) + _position_against_acceleration(where, response)
        if nominal is not None:
            expected = sampled_response(nominal(grip_N), instrument, estimate.frequencies_Hz)[0]
            again += check_gravity(where, estimate, np.abs(expected), "the scene's device")
        for run in kept:
            again += _against_response(run, trials_of[id(run)], estimate, where)
        found += refuse(again)
        grips.append(Grip(grip_N, response, tuple(fitted), tuple(kept)))
        tick()
    between = [run for run in transients if outside.get(id(run)) == []]
    for run in between:
        beside = min(
            (grip for grip in grips if grip.grip_N > 0), key=lambda grip: abs(grip.grip_N - (run.grip_N or 0.0))
        )
        where = f"{beside.grip_N:.3g} N"
        again = _current_against_command(run, amplifier)
        found += refuse(again + _against_response(run, trials_of[id(run)], beside.response.estimate, where))
    return Records(grips, instrument, between, found)


def current_follows(groups: Sequence[Sequence[Measurement]], instrument: Instrument) -> bool:
    """Whether the measured current follows the command by one pole and a delay, in the runs of every grip.

    One amplifier drives the device at all grips. If it is not one pole at one grip, it may look like a different pole
    at another, and the grips would contradict each other; so it has to be one pole at all of them.
    """
    amplifier = instrument.amplifier
    if amplifier is None or any(run.current is None or run.command is None for group in groups for run in group):
        return False
    return all(_one_pole(_condensed(group, "command", ["current"], instrument), amplifier) for group in groups)


def _own_amplifier(groups: Sequence[Sequence[Measurement]], stated: Amplifier | None) -> Amplifier | None:
    """The amplifier fitted, dead band included, to commands and currents; the stated one if that fit has shortfalls.

    Pole and delay determine the current between samples even if the measured current is the input: an error of 10 %
    in the pole moves the transmission's parameters by three standard deviations.
    """
    runs = [run for group in groups for run in group]
    if stated is None or any(run.current is None or run.command is None for run in runs):
        return stated
    try:
        found = fit_amplifier([Trial.of(run, "command", "current") for run in runs])
    except InputError:
        return stated
    return stated if found.shortfalls() else replace(stated, pole_Hz=found.pole_Hz, delay_s=found.delay_s)


def response_of(grip_N: float, runs: Sequence[Measurement], instrument: Instrument, *, follows: bool) -> GripResponse:
    """The responses of a grip from its runs.

    The input is the command if the current follows it by a pole and a delay (`follows`) or was not recorded; else it
    is the measured current, with its noise.
    """
    measured = all(run.current is not None for run in runs)
    names = ["acceleration"]
    if grip_N > 0 and all(run.position is not None for run in runs):
        names.append("position")
    rows = {"current": CURRENT, "acceleration": ACCELERATION, "position": POSITION}
    if follows:
        wide = ["current", *names]
        data = _condensed(runs, "command", wide, instrument)
        return GripResponse(grip_N, transfer(data, 1, over=0), data, tuple(rows[name] for name in wide), True)
    data = _condensed(runs, "current" if measured else "command", names, instrument)
    estimate = transfer(data)
    if not measured:
        estimate = estimate.over(current_response(instrument, estimate.frequencies_Hz))
    return GripResponse(grip_N, estimate, data, tuple(rows[name] for name in names), not measured)


def _condensed(runs: Sequence[Measurement], given: str, names: Sequence[str], instrument: Instrument) -> Condensed:
    """Condense runs from the signal `given` to those of `names`; an encoder counts only where it moves enough."""
    inputs = [run.require(given).values for run in runs]
    outputs = [np.stack([run.require(name).values for name in names]) for run in runs]
    data = condense(inputs, outputs, instrument.dt_s)
    if "position" in names:
        steps = np.abs(np.diff(np.concatenate([np.unique(run.require("position").values) for run in runs])))
        count = float(steps[steps > 1e-9].min(initial=np.inf))
        size = max(float(np.ptp(given)) / 2 for given in inputs)
        moved = np.abs(data.values()[-1]).max(axis=1) * size
        known, noise = data.known.copy(), data.noise.copy()
        known[-1] = np.logical_and.accumulate(moved > LEAST_COUNTS * count)
        # Trials of the same sweep meet the same steps, so their error of count / sqrt(12) does not average out.
        noise[-1] += len(runs) * (count**2 / 12 if np.isfinite(count) else 0.0)
        data = replace(data, known=known, noise=noise)
    return data


def _one_pole(data: Condensed, amplifier: Amplifier) -> bool:
    """Whether one pole and a delay explain the response from the command to the current, the only output."""
    if data.middles_Hz.size < LEAST_BINS:
        return False
    return fit_pole([data], start=(amplifier.pole_Hz, amplifier.delay_s)).scatter < ONE_POLE


def recorded_at(run: Measurement, recorded_N: Sequence[float]) -> float | None:
    """The recorded grip that a transient belongs to; None if there is none."""
    assert run.grip_N is not None
    wanted = run.grip_N
    near = [grip for grip in recorded_N if abs(grip - wanted) < GRIP_STEP_N and (grip > 0) == (wanted > 0)]
    return min(near, key=lambda grip: abs(grip - wanted)) if near else None


def _outside(run: Measurement, recorded_N: Sequence[float]) -> list[Finding]:
    """The finding for a transient at a grip outside the recorded ones; empty if the grip lies between them."""
    assert run.grip_N is not None
    if run.grip_N > 0 and within(run.grip_N, recorded_N):
        return []
    listed = ", ".join(f"{grip:.3g}" for grip in recorded_N)
    return [Check.GRIP_OUTSIDE.at(run.name, grip_N=run.grip_N, recorded=listed)]


def _band_Hz(grip_N: float) -> tuple[float, float]:
    return BAND_HZ if grip_N > 0 else FREE_BAND_HZ


def incoherent_bands(response: GripResponse) -> list[tuple[float, float]]:
    """Bands [Hz] within 2 (free device: 20) to 800 Hz with low coherence or without excitation."""
    e, (low, high) = response.estimate, _band_Hz(response.grip_N)
    inside = (e.frequencies_Hz >= low) & (e.frequencies_Hz <= high)
    bands = runs_of(e.frequencies_Hz[inside], e.coherence[inside] < COHERENT)
    if e.frequencies_Hz[0] > 1.5 * low:
        bands.insert(0, (low, float(e.frequencies_Hz[0])))
    if e.frequencies_Hz[-1] < high / 1.5:
        bands.append((float(e.frequencies_Hz[-1]), high))
    return bands
