"""What one tap says of the node that it was played at: how the device differed from the library's prediction.

The difference w = a - p is measured by the device's own accelerometer until the hand can react, as
`controller.record.played` measures it. One shift in time is taken out of every tap: when exactly the stylus met the
surface is known to some microseconds only, and those would look like a difference that follows the slope of the tap.
"""

from dataclasses import dataclass, replace

import numpy as np

from controller.record.metrics import align
from controller.record.played import CUTOFF_HZ, before_pole, since_contact
from controller.record.recorder import Contact
from controller.servo.settings import Settings
from controller.waveforms.prediction import Prediction, predict
from transopt.base.filters import lowpass
from transopt.base.signals import FloatArray, Signal
from transopt.library.library import Library
from transopt.plant.intention import INTENTION_S

FADE_S = 5e-3  # in which what is measured fades out after `INTENTION_S`
SPEED_PART = 0.15  # a tap this near to a node's speed counts for it, scaled
GRIP_PART, GRIP_N = 0.15, 0.5  # the same of the grip, whichever is more

Node = tuple[int, int]  # (speed, grip) by index


@dataclass(frozen=True)
class Heard:
    """One tap at a node, by the device's own sensors.

    Attributes
    ----------
    difference_m_s2 : (N,) w = a - p at the switching instants, at the node's speed, low-passed, faded out.
    latency_s : the one shift that was taken out.
    peak_current_A : as measured; NaN where no current was.
    """

    difference_m_s2: FloatArray
    latency_s: float
    peak_current_A: float


def nodes_of(library: Library) -> list[Node]:
    """All (speed, grip) of a library, by index."""
    return [(iv, ig) for iv in range(library.speeds_m_s.size) for ig in range(library.grips_N.size)]


def node_near(library: Library, speed_m_s: float, grip_N: float) -> Node | None:
    """The node that a tap counts for; None if it is near to none."""
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
    """(N,) low-passed as what is measured."""
    return lowpass(Signal(0.0, dt_s, values), CUTOFF_HZ).values


def hear(contact: Contact, library: Library, settings: Settings, node: Node, bandwidth_Hz: float) -> Heard | str:
    """What a tap at or near a node says of it; or why it says nothing.

    Parameters
    ----------
    bandwidth_Hz : of the accelerometer, one pole, which is taken out.
    """
    if contact.scale < 1 or contact.cooled > 0:
        return "the coil was too hot for all of the transient"
    prediction = predict(library, contact.speed_m_s, contact.grip_N)
    if prediction.silent:
        return "the library is silent there"
    times = prediction.times_s
    found = since_contact(contact, settings, float(times[0]), float(times[fade_of(times) > 0][-1]))
    if isinstance(found, str):
        return found
    peak_A = float(np.abs(contact.current_A).max())
    return heard(found, prediction, float(library.speeds_m_s[node[0]]), bandwidth_Hz, peak_A)


def heard(
    measured: Signal, prediction: Prediction, speed_m_s: float, bandwidth_Hz: float, peak_current_A: float
) -> Heard:
    """The difference between a measured tap and the prediction of its own speed and grip, at a node's speed.

    Parameters
    ----------
    measured : acceleration over the time from contact, at rest before it [m/s^2].
    speed_m_s : of the node, to which the difference is scaled.
    """
    times = prediction.times_s
    fade, compared = fade_of(times), times <= INTENTION_S
    whole = lowpass(replace(measured, values=before_pole(measured.values, measured.dt_s, bandwidth_Hz)), CUTOFF_HZ)
    predicted = smooth(prediction.whole_m_s2, float(times[1] - times[0]))
    latency = align(whole.times_s, whole.values, times[compared], predicted[compared]).latency_s
    difference = whole.at(times + latency) - predicted
    return Heard(fade * speed_m_s / prediction.speed_m_s * difference, latency, peak_current_A)
