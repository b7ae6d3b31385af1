"""Taps of a library that a device with other firmware played, read from files.

Such a file states neither the tick at which the waveform began nor the instant of contact. Both are found by
correlation with the predicted tap. The accelerometer's reading at rest is taken from just before the waveform.
"""

from dataclasses import dataclass

import numpy as np
import scipy

from controller.record.metrics import MOST_SHIFT_S
from controller.record.played import REST_S
from controller.refine.heard import Heard, Node, fade_of, heard, node_near, smooth
from controller.waveforms.prediction import Prediction, predict
from transopt.base.signals import FloatArray, Signal
from transopt.library.library import Library
from transopt.plant.intention import INTENTION_S
from transopt.recordings.approach import separated, unsteady
from transopt.recordings.recording import Recording
from transopt.recordings.speed import seen_speed

LEAST_REST_S = 2e-3  # least rest recorded before the tap
LEAST_LIKENESS = 0.5  # least correlation with the predicted tap; noise has some hundredths, another device 0.9
LEAST_SCALE, LARGEST_SCALE = 1 / 3, 3.0  # of the measured tap over the predicted one; beyond them a unit is wrong


@dataclass(frozen=True)
class RecordedTap:
    """One tap of a file. node : node it counts for. heard : its difference, or the reason why it does not count."""

    name: str
    node: Node | None
    heard: Heard | str


def recorded_tap(recording: Recording, library: Library, bandwidth_Hz: float) -> RecordedTap:
    """The difference that a recorded tap shows at the node that it is near.

    Parameters
    ----------
    recording : with its speed; the grip may be missing if the library has one grip only.
    bandwidth_Hz : bandwidth of the accelerometer, one pole, which is compensated.
    """
    speed, grip, name = recording.speed_m_s, recording.grip_N, recording.name
    if grip is None and library.grips_N.size == 1:
        grip = float(library.grips_N[0])
    if speed is None or grip is None:
        lacks = "# speed_m_s: 0.2" if speed is None else "# grip_N: 3"
        return RecordedTap(
            name, None, f"states no {'speed' if speed is None else 'grip'}: write a line {lacks} into it"
        )
    node = node_near(library, speed, grip)
    if node is None:
        speeds, grips = (", ".join(f"{value:g}" for value in axis) for axis in (library.speeds_m_s, library.grips_N))
        near = f"{speed:g} m/s at {grip:g} N is near to no node of the library ({speeds} m/s; {grips} N)"
        return RecordedTap(name, None, near)
    return RecordedTap(name, node, _hear(recording, predict(library, speed, grip), library, node, bandwidth_Hz))


def _hear(
    recording: Recording, prediction: Prediction, library: Library, node: Node, bandwidth_Hz: float
) -> Heard | str:
    if prediction.silent:
        return "the library is silent there"
    x, times = recording.acceleration, prediction.times_s
    begin = _where(x, prediction)
    if isinstance(begin, str):
        return begin
    # The prediction's time 0 in the file's time is `begin`; the waveform starts at `times[0]` after it.
    resting = (x.times_s < begin + times[0] - MOST_SHIFT_S) & (x.times_s >= begin + times[0] - REST_S)
    if np.count_nonzero(resting) * x.dt_s < LEAST_REST_S:
        return (
            f"begins {1e3 * (begin + times[0] - x.start_s):.1f} ms before the waveform: "
            f"{1e3 * (LEAST_REST_S + MOST_SHIFT_S):g} ms are needed, to know what the accelerometer reads at rest"
        )
    missing_s = begin + times[fade_of(times) > 0][-1] + MOST_SHIFT_S - x.end_s
    if missing_s > 0:
        return f"ends {1e3 * missing_s:.1f} ms too early: record until 40 ms after contact"
    x = x.with_values(x.values - x.values[resting].mean())
    seen = seen_speed(recording, begin)
    # A position of the other sign, or of something else, does not fall before contact.
    position = recording.position if seen is not None and seen[0] > 0 else None
    onset_s = begin + float(times[0])
    if why := unsteady(separated(x, position, onset_s), onset_s, prediction.recorded_rms_m_s2):
        return why
    measured = Signal(x.start_s - begin, x.dt_s, x.values)
    current = recording.current
    peak_A = float("nan") if current is None else float(np.abs(current.values).max())
    return heard(measured, prediction, float(library.speeds_m_s[node[0]]), bandwidth_Hz, peak_A)


def _where(x: Signal, prediction: Prediction) -> float | str:
    """Time in the record of the prediction's time 0 [s], by the largest correlation; or why there is none."""
    times, dt = prediction.times_s, float(prediction.times_s[1] - prediction.times_s[0])
    known = times <= INTENTION_S
    p = Signal(float(times[0]), dt, smooth(prediction.whole_m_s2, dt)[known])
    steps = int(np.floor((p.end_s - p.start_s) / x.dt_s)) + 1
    wanted = p.at(np.asarray(p.start_s + x.dt_s * np.arange(steps), dtype=float))
    if steps >= x.values.size or steps < 2:
        return f"is {1e3 * (x.end_s - x.start_s):.1f} ms long: record from 20 ms before contact to 40 ms after it"
    measured = x.values - np.median(x.values)
    products = scipy.signal.correlate(measured, wanted, mode="valid")
    squares = np.maximum(scipy.signal.correlate(measured**2, np.ones(steps), mode="valid"), np.finfo(float).tiny)
    likeness: FloatArray = products / np.sqrt(squares * (wanted @ wanted))
    # Quiet stretches may correlate by chance: only stretches with enough energy count.
    likeness[squares < 0.25 * squares.max()] = 0.0
    at = int(np.argmax(np.abs(likeness)))
    if abs(likeness[at]) < LEAST_LIKENESS:
        found = f"correlation {abs(likeness[at]):.2f}, at least {LEAST_LIKENESS:g} is needed"
        return f"nothing in it is like the predicted tap ({found}): is it a tap of this library?"
    if likeness[at] < 0:
        return "its acceleration points the other way: it must be positive where the tap slows the stylus down"
    scale = float(products[at] / (wanted @ wanted))
    if not LEAST_SCALE <= scale <= LARGEST_SCALE:
        return f"its acceleration is {scale:.3g} times the predicted one: check its unit (--units), and the device"
    return float(x.start_s + at * x.dt_s - p.start_s)
