"""A pure delay of the acceleration's channel, found by search and taken out of the records.

Current and acceleration often come from two instruments: a DAQ that starts later, a wireless sensor, a filter of
linear phase. No device answers a current that late, and no chain of masses can be fitted to it: a lag of 50 ms leaves
94 % of the answer unexplained. What the nominal device would have answered, shifted along the record until it fits
best, shows the lag.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from scipy import fft

from transopt.base.signals import FloatArray, Signal
from transopt.identify.device.response import Instrument, sampled_response
from transopt.identify.device.trials import felt_current
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
