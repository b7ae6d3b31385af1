"""Difference between one played tap and the library's prediction, at the node that the tap counts for.

The difference w = a - p is measured by the device's own accelerometer until the hand can react, in the same way as in
`controller.record.played`. Each tap is aligned in time first: the instant of contact is known to some microseconds
only, and the error would appear as a difference proportional to the slope of the tap.
"""

from dataclasses import dataclass, replace

import numpy as np

from controller.device.device_file import Accelerometer
from controller.record.metrics import align
from controller.record.played import CUTOFF_HZ, before_pole, since_contact
from controller.record.recorder import Contact
from controller.servo.settings import Settings
from controller.waveforms.prediction import Prediction, predict
from transopt.base.filters import lowpass
from transopt.base.signals import FloatArray, Signal
from transopt.library.library import Library
from transopt.plant.intention import INTENTION_S

FADE_S = 5e-3  # the measured difference is faded out over this time after `INTENTION_S`
SPEED_PART = 0.15  # relative distance from a node's speed within which a tap counts for the node, scaled
GRIP_PART, GRIP_N = 0.15, 0.5  # relative and absolute distance from a node's grip; the larger one applies

Node = tuple[int, int]  # (speed, grip) by index


@dataclass(frozen=True)
class Heard:
    """One tap at a node, measured by the device's own sensors.

    Attributes
    ----------
    difference_m_s2 : (N,) w = a - p at the switching instants, scaled to the node's speed, low-passed, faded out.
    latency_s : shift by which the tap was aligned.
    peak_current_A : as measured; NaN if no current was measured.
    """

    difference_m_s2: FloatArray
    latency_s: float
    peak_current_A: float


def nodes_of(library: Library) -> list[Node]:
    """All (speed, grip) of a library, by index."""
    return [(iv, ig) for iv in range(library.speeds_m_s.size) for ig in range(library.grips_N.size)]


def node_near(library: Library, speed_m_s: float, grip_N: float) -> Node | None:
    """The node that a tap counts for; None if it is near no node."""
    iv = int(np.argmin(np.abs(np.log(library.speeds_m_s / max(speed_m_s, 1e-9)))))
    ig = int(np.argmin(np.abs(library.grips_N - grip_N)))
    grip = float(library.grips_N[ig])
    near = abs(speed_m_s / float(library.speeds_m_s[iv]) - 1) <= SPEED_PART
    return (iv, ig) if near and abs(grip_N - grip) <= max(GRIP_N, GRIP_PART * grip) else None


def fade_of(times_s: FloatArray) -> FloatArray:
    """(N,) 1 until a hand can react, then down to 0 within `FADE_S`."""
    after = np.clip((times_s - INTENTION_S) / FADE_S, 0.0, 1.0)
    return np.asarray(0.5 * (1 + np.cos(np.pi * after)))


def smooth(values: FloatArray, dt_s: float) -> FloatArray:
    """(N,) values through the low-pass that measured accelerations pass."""
    return lowpass(Signal(0.0, dt_s, values), CUTOFF_HZ).values


def hear(
    contact: Contact, library: Library, settings: Settings, node: Node, accelerometer: Accelerometer
) -> Heard | str:
    """The difference that a tap near a node shows; or the reason why it does not count.

    Parameters
    ----------
    accelerometer : as the device file describes it; its pole is compensated.
    """
    if contact.scale < 1 or contact.cooled > 0:
        return "the coil was too hot for all of the transient"
    prediction = predict(library, contact.speed_m_s, contact.grip_N)
    if prediction.silent:
        return "the library is silent there"
    times = prediction.times_s
    last_s = float(times[fade_of(times) > 0][-1])
    found = since_contact(contact, library, settings, accelerometer, prediction, last_s)
    if isinstance(found, str):
        return found
    peak_A = float(np.abs(contact.current_A).max())
    return heard(found, prediction, float(library.speeds_m_s[node[0]]), accelerometer.bandwidth_Hz, peak_A)


def heard(
    measured: Signal, prediction: Prediction, speed_m_s: float, bandwidth_Hz: float, peak_current_A: float
) -> Heard:
    """The difference between a measured tap and the prediction for its own speed and grip, scaled to a node's speed.

    Parameters
    ----------
    measured : acceleration over time from contact, zero before the tap [m/s^2].
    speed_m_s : speed of the node, to which the difference is scaled.
    """
    times = prediction.times_s
    fade, compared = fade_of(times), times <= INTENTION_S
    whole = lowpass(replace(measured, values=before_pole(measured.values, measured.dt_s, bandwidth_Hz)), CUTOFF_HZ)
    predicted = smooth(prediction.whole_m_s2, float(times[1] - times[0]))
    latency = align(whole.times_s, whole.values, times[compared], predicted[compared]).latency_s
    difference = whole.at(times + latency) - predicted
    return Heard(fade * speed_m_s / prediction.speed_m_s * difference, latency, peak_current_A)
