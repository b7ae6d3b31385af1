"""What moves slowly beside the current, a hand's tremor or a drift, taken out of the lines that it leaks into.

A record ends in the middle of such a motion. To the Fourier transform that is a jump from the record's end to its
beginning, whose lines fall off with the frequency alone: they are the same from bin to bin, look like an answer to
the input, and by the luck of a few trials they agree. The motion itself is what a first model leaves of the record
below `SLOW_HZ`; its lines above `TAKEN_HZ` are leakage and nothing else, and are subtracted. Lines below stay as they
are.
"""

from dataclasses import replace

import numpy as np
from scipy import fft

from transopt.base.signals import FloatArray
from transopt.identify.device.response import CURRENT, Instrument
from transopt.identify.device.trials import Grip, felt_current, response_of
from transopt.identify.device.validation import Model, predict

SLOW_HZ, TAKEN_HZ = 20.0, 25.0
NOTICED_HZ = 100.0  # up to which leakage is compared with the noise
NOTICED = 0.05  # of the noise's energy there, from which on it is taken out


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
