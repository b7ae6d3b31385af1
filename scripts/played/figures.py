"""The figures of a played tap relative to the real one, implemented independently from their definitions.

This file shares no code with `transopt.problem.objective.figures`.
"""

from dataclasses import dataclass

import numpy as np
from scipy import signal

from transopt.base.signals import FloatArray

RECORDED_Hz = 1000.0  # low-pass of a recording, second order, forwards and backwards
FELT_Hz, BUMP_Hz = (120.0, 620.0), (10.0, 60.0)
GRAVITY_M_S2 = 9.80665
STILL_S = 5e-3  # time at rest inserted before a tap, for its low-pass


@dataclass(frozen=True)
class Told:
    """Figures of one tap.

    Attributes
    ----------
    tap, felt : errors relative to the real tap: nothing filtered over the intention; in the felt band over all.
    felt_dB : energy in that band beside the real tap's. speed : change of speed over the intention, played over real.
    bump_g : largest error from 10 to 60 Hz after the intention.
    heat_A2_ms : integral of the squared current over the window.
    """

    tap: float
    felt: float
    felt_dB: float
    speed: float
    bump_g: float
    heat_A2_ms: float


def as_recorded(real_m_s2: FloatArray, rate_Hz: float) -> FloatArray:
    """A tap (K,) behind the low-pass of a recording; it lies at rest before its first sample."""
    still = np.zeros(round(STILL_S * rate_Hz))
    passed = signal.butter(2, RECORDED_Hz, output="sos", fs=rate_Hz)
    return np.asarray(signal.sosfiltfilt(passed, np.append(still, real_m_s2)))[still.size :]


def told(
    times_s: FloatArray, wanted: FloatArray, played_m_s2: FloatArray, heat_A2_s: float, intention_s: float
) -> Told:
    """Figures of a played tap (K,) beside the wanted one (K,) [m/s^2], sampled evenly with contact at 0."""
    rate_Hz = 1 / (times_s[1] - times_s[0])
    off, first = played_m_s2 - wanted, (times_s >= 0) & (times_s < intention_s)

    def heard(course: FloatArray) -> FloatArray:
        return np.asarray(signal.sosfilt(signal.butter(1, FELT_Hz, "bandpass", output="sos", fs=rate_Hz), course))

    slow = signal.sosfilt(signal.butter(2, BUMP_Hz, "bandpass", output="sos", fs=rate_Hz), off)
    felt_real, felt_played = (float(np.sum(heard(course) ** 2)) for course in (wanted, played_m_s2))
    return Told(
        tap=float(np.sqrt(np.sum(off[first] ** 2) / np.sum(wanted[first] ** 2))),
        felt=float(np.sqrt(np.sum(heard(off) ** 2) / felt_real)),
        felt_dB=float(10 * np.log10(felt_played / felt_real)),
        speed=float(np.sum(played_m_s2[first]) / np.sum(wanted[first])),
        bump_g=float(np.abs(slow[times_s >= intention_s]).max() / GRAVITY_M_S2),
        heat_A2_ms=1e3 * heat_A2_s,
    )
