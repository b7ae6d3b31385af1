"""Checks that find bad records, so that none is fitted silently; each finding names the file and the remedy.

A finding that makes a fit worthless is fatal and refuses the records. A finding that only limits what the fit can
tell is passed on to the user beside the result.
"""

from collections.abc import Iterable, Mapping, Sequence

import numpy as np
from scipy.optimize import nnls

from transopt.base.signals import STANDARD_GRAVITY_M_S2, BoolArray, FloatArray, Signal, flat_extreme
from transopt.identify.findings import (
    COHERENT,
    END_PART,
    END_SAMPLES,
    JITTER_LIMIT,
    JITTER_NOTED,
    LEAST_CYCLES,
    LEAST_TRIALS,
    Check,
    Finding,
)
from transopt.identify.measurement import Measurement
from transopt.identify.spectrum import TransferEstimate, Trial

LEAST_WORTH = 0.05  # cycles per octave; below it no practical length of sweep would be enough, so none is proposed
REST_PART = 0.1  # least part of a signal's span between its rest, where values repeat, and an end of the range
REST_SAMPLES, END_NOISES = 20, 5.0  # number of first samples; largest end of a signal over their scatter
GRAVITY_TOLERANCE = 0.25  # relative error of a nominal model's gain; no other cause changes a gain tenfold
AGAINST = 0.5  # polarity is wrong if the reversed record has less than this share of the misfit of a passive device
PASSIVE_BAND_HZ = (2.0, 150.0)  # where motor and stylus of such a device move as one
INPUTS = ("command", "current", "voltage")  # signals that may be given as steps
UNITS = {"command": "A", "current": "A", "voltage": "V", "acceleration": "m/s^2", "force": "N"}  # of checked signals
SWITCHED_LEVELS, RANGE_PARTS = 8, 100  # most parts of its range that a switched input occupies, of all parts
LEAST_STRETCH = 3  # bins in a stretch of low coherence that is reported
GRIP_STEP_N = 0.25  # trials whose grips are closer than this count as one grip


def check_measurement(run: Measurement, quantities: Sequence[str]) -> list[Finding]:
    """Check one file by itself: its time stamps, and the extremes and the end of each signal.

    Parameters
    ----------
    quantities : names of the signals in use, such as command, current, acceleration; those not recorded are skipped.
    """
    found = []
    if run.off_grid > JITTER_NOTED:
        dt_s = next(x.dt_s for q in quantities if (x := getattr(run, q)) is not None)
        late_us = 1e6 * run.off_grid * dt_s
        check = Check.JITTERED if run.off_grid > JITTER_LIMIT else Check.JITTER_NOTED
        found.append(check.at(run.name, steps=run.off_grid, phase_deg=360e-3 * late_us, late_us=late_us))
    if run.missing:
        found.append(Check.MISSING.at(run.name, missing=run.missing))
    for quantity in quantities:
        x = getattr(run, quantity)
        if x is not None:
            found += _signal(run.name, quantity, x, limited=run.held_out and quantity != "acceleration")
    return found


def _signal(name: str, quantity: str, x: Signal, *, limited: bool) -> list[Finding]:
    """Find a signal that never moves, is clipped or saturated, or ends before it has settled.

    `limited` is set for a tap of a library, whose current may stay at its limit.
    """
    unit = UNITS[quantity]
    values = x.values
    if np.ptp(values) == 0:
        what = "the cable and the channel" if quantity != "command" else "what the device was told"
        return [Check.STILL.at(name, quantity=quantity, value=values[0], unit=unit, what=what)]
    limited = limited or (quantity in INPUTS and _switched(values))
    centred = values - np.median(values[:END_SAMPLES])
    found = []
    for side, at in ((1.0, "highest"), (-1.0, "lowest")):
        flat = flat_extreme(side * centred)
        if flat.size and abs(centred[flat[0]]) > REST_PART * np.ptp(values) and not limited:
            check, first_s = Check.SATURATED if quantity == "command" else Check.CLIPPED, x.start_s + flat[0] * x.dt_s
            extreme = {"count": flat.size, "side": at, "value": values[flat[0]], "unit": unit, "first_s": first_s}
            found.append(check.at(name, quantity=quantity, **extreme))
    last, peak = float(np.abs(centred[-END_SAMPLES:]).max()), float(np.abs(centred).max())
    # The end of a record that has settled holds noise as large as at its beginning.
    least = max(END_PART * peak, END_NOISES * float(values[:REST_SAMPLES].std()))
    if quantity != "command" and last > least:
        found.append(Check.CUT_SHORT.at(name, quantity=quantity, last=last, unit=unit, part=last / peak))
    return found


def _switched(values: FloatArray) -> bool:
    """Whether a signal jumps between a few levels, as steps and random binary sequences do, which are not clipped.

    What clips has values on its way to the limit, all over its range.
    """
    parts = np.rint(RANGE_PARTS * (values - values.min()) / np.ptp(values))
    return np.unique(parts).size <= SWITCHED_LEVELS


def begun_late(run: Measurement) -> list[Finding]:
    """Find a burst whose record begins within it: the missing beginning would look like an error of the model."""
    for quantity in ("command", "current", "acceleration"):
        x = getattr(run, quantity)
        if x is None:
            continue
        centred = x.values - np.median(x.values[-max(END_SAMPLES, x.values.size // 10) :])
        first, peak = float(np.abs(np.median(centred[:END_SAMPLES]))), float(np.abs(centred).max())
        if first > END_PART * peak:
            return [
                Check.BEGUN_LATE.at(run.name, quantity=quantity, first=first, unit=UNITS[quantity], part=first / peak)
            ]
    return []


def cycles_per_octave(trials: Sequence[Trial], frequencies_Hz: FloatArray) -> FloatArray:
    """(m,) cycles of the input, summed over trials, in the octave above or below each frequency, the larger of both.

    A swept sine of amplitude A that dwells dt/df at a frequency has |U|^2 = A^2/4 dt/df there (stationary phase), so
    the number of cycles in an octave is the integral of f 4 |U|^2 / A^2 df. A is the largest deviation of the input
    from its median.
    """
    above, below = np.zeros(frequencies_Hz.size), np.zeros(frequencies_Hz.size)
    for trial in trials:
        values, dt_s = trial.input.values, trial.input.dt_s
        lines = np.fft.rfftfreq(values.size, dt_s)
        dwell_s_Hz = (
            4 * np.abs(np.fft.rfft(values) * dt_s) ** 2 / float(np.abs(values - np.median(values)).max()) ** 2
        )
        cycles = np.cumsum(lines * dwell_s_Hz) * (lines[1] - lines[0])
        at, half, twice = (np.interp(factor * frequencies_Hz, lines, cycles) for factor in (1.0, 0.5, 2.0))
        above += twice - at
        below += at - half
    return np.maximum(above, below)


def swept_from(trials: Sequence[Trial], estimate: TransferEstimate) -> float:
    """Lowest frequency [Hz] from which on the input has enough cycles over an octave; the first bin's if none has.

    Below it no trial was meant to sweep; what the input holds there comes from jumps to an offset.
    """
    f = estimate.frequencies_Hz
    few = np.append(f[cycles_per_octave(trials, f) < LEAST_CYCLES], np.inf)
    # Whether the next bin with too few cycles lies above the octave that begins at this bin.
    whole = few[np.searchsorted(few, f)] > 2 * f
    return float(f[np.argmax(whole)])


def check_cycles(where: str, trials: Sequence[Trial], estimate: TransferEstimate, low_Hz: float) -> list[Finding]:
    """Find where in the band from `low_Hz` on the input has too few cycles for a response to be known."""
    cycles = cycles_per_octave(trials, estimate.frequencies_Hz)
    inside = estimate.frequencies_Hz >= low_Hz
    few = inside & (cycles < LEAST_CYCLES)
    if not np.any(few):
        return []
    worst, up_to = float(cycles[few].min()), float(estimate.frequencies_Hz[few].max())
    longer = f"sweep {np.ceil(10 * LEAST_CYCLES / worst) / 10:.1f} times as long, or " if worst > LEAST_WORTH else ""
    check = Check.HARDLY_ANY_CYCLES if np.mean(few[inside]) > 0.5 else Check.FEW_CYCLES
    trial = {"trials": len(trials), "longer": longer, "low_Hz": low_Hz}
    return [check.at(where, cycles=worst, up_to_Hz=up_to, **trial)]


def check_sign(where: str, estimate: TransferEstimate) -> list[Finding]:
    """Check the sign of the gain from command to current: fatal if it is negative at low frequencies."""
    low = estimate.frequencies_Hz <= 4 * estimate.frequencies_Hz[0]
    mean = complex(np.mean(estimate.response[low]))
    if mean.real >= 0:
        return []
    phase_deg = float(np.degrees(np.angle(mean)))
    return [Check.COMMAND_TURNED.at(where, phase_deg=phase_deg, at_Hz=estimate.frequencies_Hz[0])]


def check_bins(where: str, estimate: TransferEstimate, least: int) -> list[Finding]:
    """Find a response with too few bins for any fit."""
    bins = estimate.frequencies_Hz.size
    return [Check.FEW_BINS.at(where, bins=bins, least=least)] if bins < least else []


def runs_of(frequencies_Hz: FloatArray, bad: BoolArray) -> list[tuple[float, float]]:
    """First and last frequency of each run of `bad` bins; a single good bin between bad ones does not end a run."""
    at = np.flatnonzero(bad)
    runs = np.split(at, np.flatnonzero(np.diff(at) > 2) + 1) if at.size else []
    return [(float(frequencies_Hz[run[0]]), float(frequencies_Hz[run[-1]])) for run in runs]


def low_coherence(where: str, estimate: TransferEstimate) -> list[Finding]:
    """Find each stretch of the band with low coherence: most of the output there is not caused by the input."""
    f, low, found = estimate.frequencies_Hz, estimate.coherence < COHERENT, []
    for first, last in runs_of(f, low):
        inside = low & (f >= first) & (f <= last)
        if np.count_nonzero(inside) < LEAST_STRETCH:
            continue  # one or two bins may be low by chance
        lowest = estimate.coherence[inside].min()
        found.append(Check.INCOHERENT.at(where, coherence=lowest, first_Hz=first, last_Hz=last))
    return found


def passive_misfit(estimate: TransferEstimate, sign: float) -> float:
    """Relative misfit (0 to 1) of one passive mass on a spring and damper to `sign` times the response; may be NaN.

    current / acceleration = m + b / (jw) - k / w^2, per newton per ampere: linear in m, b, k >= 0, so non-negative
    least squares finds the best passive device.
    """
    f = estimate.frequencies_Hz
    good = (f >= PASSIVE_BAND_HZ[0]) & (f <= PASSIVE_BAND_HZ[1]) & (estimate.coherence >= COHERENT)
    if np.count_nonzero(good) < 3:
        return float("nan")  # too few coherent bins to judge
    w, response = 2 * np.pi * f[good], sign * estimate.response[good]
    inverse = response**-1
    columns = np.stack([np.ones(w.size), -1j / w, -1 / w**2], axis=1)
    weight = np.abs(response)  # relative errors
    wide = np.vstack([(columns * weight[:, None]).real, (columns * weight[:, None]).imag])
    wanted = np.concatenate([(inverse * weight).real, (inverse * weight).imag])
    scale = np.linalg.norm(wide, axis=0)
    return float(nnls(wide / scale, wanted)[1] / np.linalg.norm(wanted))


def check_passive(where: str, estimate: TransferEstimate) -> list[Finding]:
    """Check the polarity from current to acceleration: a passive device fits the reversed record worse."""
    as_recorded, reversed_ = passive_misfit(estimate, 1.0), passive_misfit(estimate, -1.0)
    low_Hz, high_Hz = PASSIVE_BAND_HZ
    return [Check.NOT_PASSIVE.at(where, low_Hz=low_Hz, high_Hz=high_Hz)] if reversed_ < AGAINST * as_recorded else []


def check_unit(where: str, ratio: float, against: str) -> list[Finding]:
    """Find a wrong unit: the ratio of the acceleration to that of `against` is near 9.81 or its inverse."""
    for factor, which, unit, column in (
        (STANDARD_GRAVITY_M_S2, "9.81", "m/s^2", "acceleration_g"),
        (1 / STANDARD_GRAVITY_M_S2, "9.81 inverted", "g", "acceleration_m_s2"),
    ):
        if abs(np.log(ratio / factor)) < np.log1p(GRAVITY_TOLERANCE):
            return [Check.UNIT.at(where, ratio=ratio, against=against, which=which, unit=unit, column=column)]
    return []


def check_gravity(where: str, estimate: TransferEstimate, expected: FloatArray, against: str) -> list[Finding]:
    """Check the unit of an acceleration over current by its coherent bins.

    Parameters
    ----------
    expected : (m,) magnitudes of a nominal model or of other files.
    against : what `expected` belongs to, for the message.
    """
    good = (estimate.coherence >= COHERENT) & (expected > 0)
    if not np.any(good):
        return []
    ratio = np.exp(np.median(np.log(np.abs(estimate.response[good]) / expected[good])))
    return check_unit(where, float(ratio), against)


def by_grip(runs: Sequence[Measurement]) -> Mapping[float, list[Measurement]]:
    """Runs grouped by grip, in order of the grips: mean grip [N] -> runs; runs without a grip are left out."""
    groups: list[list[tuple[float, Measurement]]] = []
    stated = [(run.grip_N, run) for run in runs if run.grip_N is not None]
    for grip, run in sorted(stated, key=lambda one: one[0]):
        last = groups[-1][-1][0] if groups else -np.inf
        # A free device (grip 0) is never grouped with a held one.
        if grip - last >= GRIP_STEP_N or last == 0 < grip:
            groups.append([])
        groups[-1].append((grip, run))
    return {float(np.mean([grip for grip, _ in group])): [run for _, run in group] for group in groups}


def within(grip_N: float, recorded_N: Iterable[float]) -> bool:
    """Whether a grip lies between recorded ones; a free device (grip 0) and a held one do not bracket each other."""
    alike = [grip for grip in recorded_N if (grip > 0) == (grip_N > 0)]
    return bool(alike) and min(alike) <= grip_N <= max(alike)


def check_grips(runs: Sequence[Measurement]) -> list[Finding]:
    """Check that every file states its grip and every grip has enough trials, of both polarities."""
    found = [Check.NO_GRIP.at(run.name) for run in runs if run.grip_N is None]
    for grip, group in by_grip(runs).items():
        where = f"grip {grip:.3g} N"
        if len(group) < LEAST_TRIALS:
            found.append(Check.FEW_TRIALS.at(where, trials=len(group)))
        elif len({polarity(run) for run in group} - {0}) == 1:
            found.append(Check.ONE_POLARITY.at(where))
    return found


def polarity(run: Measurement) -> int:
    """Sign of the first half-wave of the excitation: +1 or -1; 0 if there is no excitation."""
    x = run.command if run.command is not None else run.current
    if x is None:
        return 0
    centred = x.values - np.median(x.values)
    large = np.flatnonzero(np.abs(centred) > 0.3 * np.abs(centred).max())
    return int(np.sign(centred[large[0]])) if large.size else 0
