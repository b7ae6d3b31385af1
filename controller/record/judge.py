"""How well a device played a tap, from its own sensors (DESIGN 7): latency and NRMSE after it.

The simulator's truth is not to be had here, so both sides are brought to what can be measured. Contact is where the
approach, a parabola through the encoder's counts, would have met the surface. The prediction is passed through the
accelerometer's own pole. Both are low-passed as recordings are, and compared until the hand can react, since what it
does of its own accord afterwards nobody predicts.
"""

from dataclasses import dataclass

import numpy as np
from scipy import signal

from controller.record.metrics import MOST_SHIFT_S, align
from controller.record.recorder import Contact
from controller.servo.settings import Settings
from controller.waveforms.prediction import REACTION_S, predict
from transopt.base.signals import FloatArray, Signal, lowpass
from transopt.library.library import Library

FIT_S = 0.03  # of straight approach that the parabola is laid through
REST_S = 0.02  # before the waveform: what the accelerometer reads there is gravity and offset
CUTOFF_HZ = 1000.0  # as recordings are prepared


@dataclass(frozen=True)
class Judged:
    """One tap; figures are NaN where `why` says why there are none.

    Attributes
    ----------
    latency_s : positive if played late. nrmse : after it, against the prediction. peak_m_s2, predicted_peak_m_s2 :
        largest |acceleration|, low-passed alike.
    """

    contact: Contact
    latency_s: float
    nrmse: float
    peak_m_s2: float
    predicted_peak_m_s2: float
    why: str = ""


def contact_s(contact: Contact, settings: Settings) -> float:
    """When the stylus would have met the surface undriven, after the tick at which the waveform began [s].

    The tangent at `lead` after that tick of a parabola through the counts up to it; nothing has moved before. NaN if
    the stylus was not coming in.
    """
    times = (contact.ticks - contact.tick) * contact.dt_s
    seen = (times <= 0) & (times > -FIT_S)
    z = (contact.counts[seen] - settings.surface_counts) * settings.count_m
    a, b, c = np.polynomial.polynomial.polyfit(times[seen], z, 2)
    lead = settings.lead_s
    slope = b + 2 * c * lead
    return float(lead - (a + b * lead + c * lead**2) / slope) if slope < 0 else float("nan")


def through_pole(values: FloatArray, dt_s: float, bandwidth_Hz: float) -> FloatArray:
    """(N,) samples of a signal from rest behind one pole, the signal joined by straight lines between them."""
    pole = 2 * np.pi * bandwidth_Hz * dt_s
    kept = np.exp(-pole)
    # x' = p (u - x) over one step with u going straight from u_0 to u_1.
    mean = (1 - kept) / pole
    return np.asarray(signal.lfilter([1 - mean, mean - kept], [1.0, -kept], values))


def before_pole(values: FloatArray, dt_s: float, bandwidth_Hz: float) -> FloatArray:
    """(N,) what `through_pole` was given; noise beyond the bandwidth grows."""
    pole = 2 * np.pi * bandwidth_Hz * dt_s
    kept = np.exp(-pole)
    mean = (1 - kept) / pole
    # Minimum phase: (mean - kept) / (1 - mean) < 1 for every pole.
    return np.asarray(signal.lfilter([1.0, -kept], [1 - mean, mean - kept], values))


def since_contact(contact: Contact, settings: Settings, first_s: float, last_s: float) -> Signal | str:
    """What the accelerometer read, less what it read at rest, over the time from contact; or why there is nothing.

    Parameters
    ----------
    first_s, last_s : what has to be in it, with the shift that an alignment needs on both sides.
    """
    if contact.missed:
        return f"{contact.missed} records were lost"
    times = (contact.ticks - contact.tick) * contact.dt_s
    step = float(times[1] - times[0]) if times.size > 1 else float("nan")
    if not step <= 1.5 * contact.dt_s:
        return "telemetry of every tick is needed"
    begin = contact_s(contact, settings)
    if not (times[0] - begin <= first_s - MOST_SHIFT_S and last_s + MOST_SHIFT_S <= times[-1] - begin):
        return "not all of it was recorded"
    resting = (times < 0) & (times >= -REST_S)
    values = contact.acceleration_m_s2 - contact.acceleration_m_s2[resting].mean()
    return Signal(float(times[0] - begin), step, values)


def judge(
    contact: Contact,
    library: Library,
    settings: Settings,
    gain: float,
    bandwidth_Hz: float,
) -> Judged:
    """Compare a recorded contact with what the library says of it.

    Parameters
    ----------
    gain : of the device. bandwidth_Hz : of the accelerometer, one pole.
    """
    nan = float("nan")

    def none(why: str) -> Judged:
        return Judged(contact, nan, nan, nan, nan, why)

    if gain == 0:
        return none("nothing is played at gain 0")
    prediction = predict(library, contact.speed_m_s, contact.grip_N, gain)
    if prediction.silent or not np.any(prediction.acceleration_m_s2):
        return none("the library is silent there")
    until = prediction.times_s <= REACTION_S
    at = prediction.times_s[until]
    measured = since_contact(contact, settings, float(at[0]), float(at[-1]))
    if isinstance(measured, str):
        return none(measured)
    played = lowpass(measured, CUTOFF_HZ)
    sensed = through_pole(prediction.acceleration_m_s2, contact.dt_s, bandwidth_Hz)
    expected = lowpass(Signal(float(at[0]), contact.dt_s, sensed), CUTOFF_HZ).values[until]
    aligned = align(played.times_s, played.values, at, expected)
    peak = float(np.abs(aligned.played_m_s2).max())
    return Judged(contact, aligned.latency_s, aligned.nrmse, peak, float(np.abs(expected).max()))
