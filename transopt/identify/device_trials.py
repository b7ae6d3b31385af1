"""Records of a device sorted for identification: by grip, checked, split into what is fitted and what is kept out."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import signal

from transopt.amplifier import Amplifier
from transopt.discretise import split_delay
from transopt.errors import InputError
from transopt.identify.chain_fit import GripResponse
from transopt.identify.checks import (
    COHERENT,
    GRAVITY_TOLERANCE,
    GRIP_STEP_N,
    Fault,
    Finding,
    by_grip,
    check_cycles,
    check_gravity,
    check_grips,
    check_measurement,
    check_passive,
    check_rates,
    refuse,
)
from transopt.identify.device_response import Instrument, sampled_response
from transopt.identify.measurement import Measurement
from transopt.identify.spectrum import TransferEstimate, Trial, estimate_transfer
from transopt.models import StateSpace
from transopt.signals import STANDARD_GRAVITY_M_S2, FloatArray, Signal

QUANTITIES = ("command", "current", "acceleration")
LEAST_TO_HOLD_OUT = 3  # trials of a grip, of which one is then kept for validation
BAND_HZ = (2.0, 800.0)  # where a design needs the model
FREE_BAND_HZ = (20.0, 800.0)  # below, a free device only drifts, further than its stroke


@dataclass(frozen=True)
class Grip:
    """All runs at one grip.

    Attributes
    ----------
    grip_N : their mean, 0 for the free device. response : from the fitted ones.
    fitted, kept : what the model is fitted to, and what it is judged by; the latter may be empty.
    """

    grip_N: float
    response: GripResponse
    fitted: tuple[Measurement, ...]
    kept: tuple[Measurement, ...]


@dataclass(frozen=True)
class Records:
    """Everything that was recorded, in order.

    Attributes
    ----------
    grips : increasing. between : transients at grips without sweeps, between those with. findings : not fatal.
    """

    grips: list[Grip]
    instrument: Instrument
    between: list[Measurement]
    findings: list[Finding]


def felt_current(run: Measurement, amplifier: Amplifier | None) -> Signal:
    """The measured current, or what the known amplifier makes of the command.

    Raises
    ------
    InputError : neither was recorded.
    """
    if run.current is not None:
        return run.current
    if run.command is None:
        raise InputError(f"{run.name}: neither current_A nor command_A; record the measured current")
    command, dt = run.command.values, run.command.dt_s
    whole, late = split_delay(0.0 if amplifier is None else amplifier.delay_s, dt)
    late_command = np.concatenate([np.zeros(whole + 1), command])[: command.size]
    if amplifier is None:
        return Signal(run.command.start_s, dt, late_command)
    kept, rest = np.exp(-amplifier.rate_rad_s * dt), np.exp(-amplifier.rate_rad_s * (dt - late))
    values = signal.lfilter([1 - rest, rest - kept], [1.0, -kept], late_command)
    return Signal(run.command.start_s, dt, np.asarray(values))


def instrument_of(runs: Sequence[Measurement], amplifier: Amplifier | None) -> Instrument:
    """What stands between the device and these records.

    Raises
    ------
    InputError : files that state different accelerometers, or none that holds an acceleration.
    """
    poles = {run.name: run.accelerometer_Hz for run in runs}
    first = next(iter(poles))
    for name, pole in poles.items():
        if pole != poles[first]:
            raise InputError(
                f"{name}: accelerometer_Hz {pole}, {first} {poles[first]}: must be one sensor; state the same or none"
            )
    return Instrument(runs[0].require("acceleration", "acceleration_m_s2").dt_s, amplifier, poles[first])


def _odd_one_out(where: str, names: Sequence[str], estimate: TransferEstimate) -> list[Finding]:
    """A trial that answers against the others, or in another unit: the mean of all would hide it."""
    if estimate.trials < 2:
        return []
    clear = estimate.coherence >= np.median(estimate.coherence) / 2
    each = estimate.trial_responses[:, clear]
    middle = np.median(np.abs(each), axis=0)
    reference = each[int(np.argmin([np.median(np.abs(np.abs(one) / middle - 1)) for one in each]))]
    found = []
    signs = np.array([np.sum((one * reference.conj()).real / np.abs(reference) ** 2) for one in each])
    minority = 1.0 if np.sum(signs > 0) < np.sum(signs < 0) else -1.0
    for name, one, sign in zip(names, each, signs, strict=True):
        if sign * minority > 0:
            text = f"acceleration answers the current the other way than in the other trials of {where}"
            remedy = "turn the accelerometer or the current's sign in this file, or record it again"
            found.append(Finding(Fault.POLARITY, name, f"{text}; {remedy}", True))
        ratio = float(np.median(np.abs(one) / middle))
        for factor in (STANDARD_GRAVITY_M_S2, 1 / STANDARD_GRAVITY_M_S2):
            if abs(np.log(ratio / factor)) < np.log1p(GRAVITY_TOLERANCE):
                text = f"acceleration is {ratio:.3g} times that of the other trials of {where}"
                found.append(Finding(Fault.UNITS, name, f"{text}; is its column in g or in m/s^2?", True))
    return found


def sort_trials(
    runs: Sequence[Measurement],
    transients: Sequence[Measurement],
    amplifier: Amplifier | None,
    nominal: Callable[[float], StateSpace] | None,
    *,
    tick: Callable[[], None] = lambda: None,
) -> Records:
    """Grips with their responses, what the model is judged by, and what is wrong but not fatal.

    Without `transients` the last trial of a grip that has three or more is kept for validation.

    Parameters
    ----------
    runs : sweeps. transients : recorded apart, for validation only.
    nominal : plant at a grip to compare the unit of acceleration with; None without any. tick : after each grip.

    Raises
    ------
    InputError : a fatal finding, with what to record again.
    """
    together = [*runs, *transients]
    found = refuse(finding for run in together for finding in check_measurement(run, QUANTITIES))
    trials_of = {
        id(run): Trial(run.name, felt_current(run, amplifier), run.require("acceleration", "acceleration_m_s2"))
        for run in together
    }
    found += refuse(check_rates(list(trials_of.values())) + check_grips(runs))
    found += refuse(f for f in check_grips(transients) if f.fatal)
    instrument = instrument_of(together, amplifier)
    groups, grips = by_grip(runs), []
    apart = [run for run in transients if _recorded_at(run, list(groups)) is None]
    found += [finding for run in apart for finding in _outside(run, list(groups))]
    for grip_N, group in groups.items():
        where = "the free device" if grip_N == 0 else f"{grip_N:.3g} N"
        in_order = sorted(group, key=runs.index)
        hold_out = not transients and len(group) >= LEAST_TO_HOLD_OUT
        fitted = in_order[:-1] if hold_out else in_order
        kept = in_order[-1:] if hold_out else [run for run in transients if _recorded_at(run, list(groups)) == grip_N]
        trials = [trials_of[id(run)] for run in fitted]
        estimate = estimate_transfer(trials)
        again = _odd_one_out(where, [run.name for run in fitted], estimate)
        again += check_passive(where, estimate)
        again += check_cycles(where, trials, estimate, _band_Hz(grip_N)[0])
        if nominal is not None:
            expected = sampled_response(nominal(grip_N), instrument, estimate.frequencies_Hz)[0]
            again += check_gravity(where, estimate, np.abs(expected), "the scene's device")
        found += refuse(again)
        grips.append(Grip(grip_N, GripResponse(grip_N, estimate), tuple(fitted), tuple(kept)))
        tick()
    between = [run for run in apart if not _outside(run, list(groups))]
    return Records(grips, instrument, between, found)


def _recorded_at(run: Measurement, recorded_N: Sequence[float]) -> float | None:
    """The recorded grip that a transient is of; None for one that was not recorded."""
    assert run.grip_N is not None
    wanted = run.grip_N
    near = [grip for grip in recorded_N if abs(grip - wanted) < GRIP_STEP_N and (grip > 0) == (wanted > 0)]
    return min(near, key=lambda grip: abs(grip - wanted)) if near else None


def _outside(run: Measurement, recorded_N: Sequence[float]) -> list[Finding]:
    """A transient at a grip that no model will know."""
    assert run.grip_N is not None
    held = [grip for grip in recorded_N if grip > 0]
    if run.grip_N > 0 and held and held[0] <= run.grip_N <= held[-1]:
        return []
    listed = ", ".join(f"{grip:.3g}" for grip in recorded_N)
    text = f"grip {run.grip_N:.3g} N, sweeps at {listed} N: not judged; record sweeps there"
    return [Finding(Fault.MISSING_GRIP, run.name, text, False)]


def _band_Hz(grip_N: float) -> tuple[float, float]:
    return BAND_HZ if grip_N > 0 else FREE_BAND_HZ


def low_coherence(response: GripResponse) -> list[tuple[float, float]]:
    """Bands [Hz] within 2 (free: 20) to 800 Hz whose coherence is low, or that were not excited at all."""
    e, (low, high) = response.estimate, _band_Hz(response.grip_N)
    inside = (e.frequencies_Hz >= low) & (e.frequencies_Hz <= high)
    bands = runs_of(e.frequencies_Hz[inside], e.coherence[inside] < COHERENT)
    if e.frequencies_Hz[0] > 1.5 * low:
        bands.insert(0, (low, float(e.frequencies_Hz[0])))
    if e.frequencies_Hz[-1] < high / 1.5:
        bands.append((float(e.frequencies_Hz[-1]), high))
    return bands


def runs_of(frequencies_Hz: FloatArray, bad: NDArray[np.bool_]) -> list[tuple[float, float]]:
    """First and last frequency of each run of `bad` bins; single good bins between do not end one."""
    bands: list[list[int]] = []
    for j in np.flatnonzero(bad):
        if bands and j - bands[-1][1] <= 2:
            bands[-1][1] = int(j)
        else:
            bands.append([int(j), int(j)])
    return [(float(frequencies_Hz[a]), float(frequencies_Hz[b])) for a, b in bands]
