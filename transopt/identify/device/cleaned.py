"""What is no device's answer, taken out of the records: a pure delay of a channel, and what moves slowly by itself.

Current and acceleration often come from two instruments: a DAQ that starts later, a wireless sensor, a filter of
linear phase. No device answers a current that late, and no chain of masses can be fitted to it: a lag of 50 ms leaves
94 % of the answer unexplained. What the nominal device would have answered, shifted along the record until it fits
best, shows the lag.

A record ends in the middle of a hand's tremor or a drift. To the Fourier transform that is a jump from the record's
end to its beginning, whose lines fall off with the frequency alone: they are the same from bin to bin, look like an
answer to the input, and by the luck of a few trials they agree. The motion itself is what a first model leaves of the
record below `SLOW_HZ`; its lines above `TAKEN_HZ` are leakage and nothing else, and are subtracted. Lines below stay
as they are.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from scipy import fft

from transopt.base.signals import FloatArray, Signal
from transopt.identify.device.response import CURRENT, Instrument, sampled_response
from transopt.identify.device.trials import Grip, felt_current, response_of
from transopt.identify.device.validation import Model, predict
from transopt.identify.findings import Check, Finding
from transopt.identify.measurement import Measurement
from transopt.plant.amplifier import Amplifier
from transopt.plant.state_space import StateSpace

LEAST_S = 2e-3  # less could be the device's own, for which the amplifier and the hold are in the model
LONGEST_S = 0.5
CLEARLY = 2.0  # times the likeness that there is without any shift
LEAST_LIKENESS = 0.2  # of 1, which a device equal to the nominal one has
EXCITED = 0.02  # of the largest line of the current
FEWEST_LINES = 50
BAND_HZ = (5.0, 1000.0)
SLOW_HZ, TAKEN_HZ = 20.0, 25.0
NOTICED_HZ = 100.0  # up to which leakage is compared with the noise
NOTICED = 0.05  # of the noise's energy there, from which on it is taken out


def _likeness(run: Measurement, amplifier: Amplifier | None, plant: StateSpace, instrument: Instrument) -> FloatArray:
    """(n,) how well the recorded acceleration fits what the nominal device makes of the current, over lags from 0 on.

    Of the cross-spectrum only the phases are used, as far as the current has anything at a line: its sum over lines
    is then sharp, while the plain correlation of a resonant device has one hump per period of the resonance.
    """
    current, recorded = felt_current(run, amplifier), run.require("acceleration", "acceleration_m_s2")
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
    """Samples by which all runs' acceleration comes later than a device's; 0 if it is not clear."""
    courses = [np.abs(_likeness(run, amplifier, nominal(run.grip_N or 0.0), instrument)) for run in runs]
    together = np.mean([course[: min(map(len, courses))] for course in courses], axis=0)
    best = int(np.argmax(together))
    soon = float(together[: max(round(LEAST_S / instrument.dt_s), 1)].max())
    late = best * instrument.dt_s > LEAST_S and together[best] > max(CLEARLY * soon, LEAST_LIKENESS)
    return best if late else 0


def without_delay(runs: Sequence[Measurement], samples: int) -> list[Measurement]:
    """The runs with accelerations that many samples earlier; the end, whose answer was not recorded, is cut off."""

    def moved(quantity: str, x: Signal) -> Signal:
        values = x.values[samples:] if quantity == "acceleration" else x.values[: x.values.size - samples]
        return replace(x, values=values)

    return [run.changed(moved) for run in runs]


def finding(samples: int, dt_s: float) -> Finding:
    """What was done, for the user."""
    return Check.DELAYED.at("acceleration", late_ms=1e3 * samples * dt_s, samples=samples)


def leakage(residual_m_s2: FloatArray, dt_s: float) -> tuple[FloatArray, float]:
    """(n,) what the slow part of a residual (n,) leaks into faster lines, and its energy there over the rest."""
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
    """The grip with its response from records without leakage; None where there is none worth the while."""
    found, most = [], 0.0
    for run in grip.fitted:
        recorded = run.require("acceleration", "acceleration_m_s2")
        current = felt_current(run, instrument.amplifier).values
        expected = predict(model, grip.grip_N, instrument, current - current[0])
        leaked, share = leakage(recorded.values - expected, recorded.dt_s)
        found.append(replace(run, acceleration=replace(recorded, values=recorded.values - leaked)))
        most = max(most, share)
    if most < NOTICED:
        return None
    follows = CURRENT in grip.response.outputs
    return replace(grip, response=response_of(grip.grip_N, found, instrument, follows=follows))
