"""The approach before contact: separates offset from incoming acceleration and completes the slow part of a tap.

The baseline before contact is the sum of the sensor's offset and a0, the hand's acceleration during the approach. An
accelerometer alone cannot separate them, but a recorded position can: the acceleration, integrated twice, must give
the position's course, and the constant that is missing is the offset. The same fit completes what a sensor with a low
cut-off loses. Its reading b of an acceleration a passes a first-order high-pass of angular frequency w, whose inverse
is known up to a start value:

    b = s / (s + w) a,     so     a(t) = b(t) + w (integral of b) + p + q t,

with p and q, start value and offset, fitted to the position

    z(t) = z0 + v0 t + (double integral of b + w (integral of b)) + p t^2 / 2 + q t^3 / 6.

A sensor that reads down to 0 Hz has w = 0 and q = 0. Then only the approach is fitted, where an error of the sensor's
scale has no effect; otherwise the course from the approach to after the tap.

A tap assumes that its hand comes in steadily, and goes on so until it can react. Masses and springs of one that has
just turned round or set off still move against each other, and one that accelerates may stop doing so at contact.
"""

import math
from dataclasses import dataclass

import numpy as np

from transopt.base.signals import REACTION_S, FloatArray, Signal, integral
from transopt.recordings.speed import fitted
from transopt.recordings.split import white_noises

GUARD_S = 1e-3  # left out before contact, because the low-passed rise of the tap reaches that far
INCOMING_S = 10e-3  # the incoming acceleration is the mean over this time before contact
FIT_BEFORE_S, FIT_AFTER_S = 50e-3, 150e-3  # about contact; over longer times integrated noise exceeds a count
LEAST_SAMPLES = 8
LEAST_M_S2 = 0.1  # a smaller incoming acceleration changes the speed by 3 mm/s in 30 ms and counts as 0
REST_S, LEAVING_S = 20e-3, 5e-3  # shortest rest, and its end to leave out, where the hand moves within one count
REST_M = 25e-6  # motion of a finer position that still counts as rest
TRUSTED_Hz = 1.0  # a lower cut-off loses little in 30 ms, at most 6 % of the change of speed
STEADY_S = 20e-3  # time before contact that tells how a hand comes in
# Largest acceleration of a hand, over the rms of its tap. By a simulator all taps that are off by more than 20 %
# because of what the hand did before contact have a larger one.
MOST_OWN = 0.2
SEPARATED, AT_REST, STATED, UNSEPARATED = "position", "rest", "stated offset", "unknown"


@dataclass(frozen=True)
class Approach:
    """An acceleration with its offset and slow part corrected, and its value before contact.

    Attributes
    ----------
    acceleration : z'' of the stylus [m/s^2].
    offset_error_m_s2 : amount by which the offset subtracted before was too large.
    incoming_m_s2 : a0, the acceleration during the approach; 0 if unknown or not distinguishable from 0.
    source : what a0 is known from: `position`, `rest`, `stated offset` or `unknown`.
    slow_part_known : whether the acceleration contains frequencies below those of the tap.
    notes : what a user should know, one sentence each.
    """

    acceleration: Signal
    offset_error_m_s2: float = 0.0
    incoming_m_s2: float = 0.0
    source: str = UNSEPARATED
    slow_part_known: bool = True
    notes: tuple[str, ...] = ()


def find_approach(
    x: Signal, position: Signal | None, onset_s: float, noise_m_s2: float, trusted_from_Hz: float, *, stated: bool
) -> Approach:
    """Separate offset from incoming acceleration, and complete frequencies below the sensor's cut-off.

    Parameters
    ----------
    x : less its baseline, or less the offset that the user `stated`, positive where the tap decelerates the stylus.
    position : along the surface normal, positive out of the object [m]; None if it was not recorded.
    onset_s : time of contact.
    noise_m_s2 : rms of the white noise in `x`.
    trusted_from_Hz : cut-off of the sensor's first-order high-pass; 0 for a sensor that reads a constant.
    """
    if trusted_from_Hz > 0:
        return _completed(x, position, onset_s, trusted_from_Hz)
    coming = x.values[_coming(x, onset_s)]
    if coming.size < LEAST_SAMPLES:
        return Approach(x)
    before = float(coming.mean())
    if stated:
        missing, error, source = 0.0, 2 * noise_m_s2 / np.sqrt(coming.size), STATED
    else:
        found = None if position is None else _at_rest(x, position, onset_s, noise_m_s2)
        if found is None and position is not None:
            found = _by_position(x, position, onset_s, noise_m_s2)
        if found is None:
            said = "offset and incoming acceleration are not told apart without a position: the latter is taken as 0"
            return Approach(x, notes=(said,))
        missing, error, source = found
    incoming, least = before + missing, max(error, LEAST_M_S2)
    if max(abs(incoming), abs(missing)) <= least:
        return Approach(x, source=source)
    return Approach(x.with_values(x.values + missing), missing, incoming if abs(incoming) > least else 0.0, source)


def separated(x: Signal, position: Signal | None, onset_s: float) -> Approach:
    """`find_approach` for a sensor that reads down to 0 Hz, from its acceleration less a baseline."""
    (noise,) = white_noises(x.values[None])
    return find_approach(x, position, onset_s, noise, 0.0, stated=False)


def unsteady(came: Approach, onset_s: float, tap_m_s2: float) -> str:
    """Reason why the hand did not come in steadily; empty if it did, or nothing tells.

    Its own acceleration is judged by the mean over the last 20 ms, and by the straight line through them, continued
    until it can react: by as much as these the tap is off if the hand goes on differently.

    Parameters
    ----------
    onset_s : time of contact. tap_m_s2 : rms of the tap until the hand can react.
    """
    x = came.acceleration
    first, end = (x.before(onset_s - GUARD_S - before_s) for before_s in (STEADY_S, 0.0))
    if not came.slow_part_known or end - first < LEAST_SAMPLES:
        return ""
    last, since_s = x.values[first:end], x.start_s + x.dt_s * first - onset_s
    (ahead, _), (error, _) = fitted(since_s - REACTION_S, x.dt_s, last, 0.0, 2)
    mean, most = float(last.mean()), MOST_OWN * tap_m_s2
    if max(abs(mean), abs(ahead) - error) <= most:
        return ""
    return (
        f"no steady approach: in the last {1e3 * STEADY_S:g} ms the hand itself accelerates by {mean:.2g} m/s^2, "
        f"which goes on to {ahead:.2g} m/s^2 {1e3 * REACTION_S:g} ms after contact (at most {most:.2g} m/s^2, "
        f"{100 * MOST_OWN:g} % of the tap): a rebound, or begun too near: begin higher, and move evenly"
    )


def _coming(x: Signal, onset_s: float) -> slice:
    """Samples whose mean is the incoming acceleration."""
    return slice(x.until(onset_s - GUARD_S - INCOMING_S), x.before(onset_s - GUARD_S))


def _at_rest(x: Signal, position: Signal, onset_s: float, noise_m_s2: float) -> tuple[float, float, str] | None:
    """Correction to zero at rest, with its 95 % interval and source; None if the record does not begin at rest."""
    z = position.values[: max(position.before(onset_s), 1)]
    left = np.abs(z - z[0]) > 1.5 * max(position.count, REST_M)
    leaves_s = position.start_s + position.dt_s * int(np.argmax(left)) if left.any() else position.end_s
    still = x.values[x.before(position.start_s) : x.before(min(leaves_s, onset_s) - LEAVING_S)]
    if still.size < LEAST_SAMPLES or still.size * x.dt_s < REST_S:
        return None
    return -float(still.mean()), 2 * noise_m_s2 / np.sqrt(still.size), AT_REST


def _by_position(x: Signal, position: Signal, onset_s: float, noise_m_s2: float) -> tuple[float, float, str] | None:
    """Correction that fits the position over the approach, with 95 % interval and source; None if too few samples."""
    inside = slice(position.until(max(onset_s - FIT_BEFORE_S, x.start_s)), position.before(onset_s - GUARD_S))
    samples = inside.stop - inside.start
    if samples < LEAST_SAMPLES:
        return None
    solution, interval = _fitted(x, position, inside, onset_s, 3)
    # Doubly integrated noise bends the fitted parabola instead of scattering about it, like a biased mean
    # acceleration.
    bent = 3 * noise_m_s2 * math.sqrt(x.dt_s / (position.dt_s * (samples - 1)))
    return 2 * float(solution[2]), math.hypot(2 * interval[2], bent), SEPARATED


def _completed(x: Signal, position: Signal | None, onset_s: float, trusted_from_Hz: float) -> Approach:
    """Acceleration with its slow part completed from the position; unchanged if there is no position."""
    said = f"the sensor reads from {trusted_from_Hz:g} Hz on"
    inside = slice(0, 0)
    if position is not None:
        low, high = max(onset_s - FIT_BEFORE_S, x.start_s), min(onset_s + FIT_AFTER_S, x.end_s)
        inside = slice(position.before(low), position.until(high))
    short = inside.stop - inside.start < LEAST_SAMPLES
    if position is None or short or inside.stop <= position.until(onset_s):
        known = trusted_from_Hz <= TRUSTED_Hz
        lost = (
            "what is slower is missing"
            if known
            else "what is slower is unknown without a position_m, so only the rapid error is minimised"
        )
        return Approach(x, slow_part_known=known, notes=(f"{said}: {lost}",))
    w = 2 * np.pi * trusted_from_Hz
    inverse = x.with_values(x.values + w * integral(x.values, x.dt_s))
    solution, interval = _fitted(inverse, position, inside, onset_s, 4)
    slope = 6 * float(solution[3])
    whole = x.with_values(inverse.values + 2 * float(solution[2]) + slope * (x.times_s - onset_s))
    coming = whole.values[_coming(x, onset_s)]
    incoming = float(coming.mean()) if coming.size else 0.0
    if abs(incoming) <= max(2 * interval[2], LEAST_M_S2):
        incoming = 0.0
    notes = (f"{said}: what is slower is completed from the position",)
    return Approach(whole, slope / w, incoming, SEPARATED, notes=notes)


def _fitted(x: Signal, position: Signal, inside: slice, onset_s: float, terms: int) -> tuple[FloatArray, FloatArray]:
    """Fit (`fitted`, over the time from contact) of the position minus the doubly integrated acceleration x."""
    t = position.start_s + position.dt_s * np.arange(inside.start, inside.stop)
    end = x.before(float(t[-1])) + 1  # of the first sample after the position's last one
    moved = integral(integral(x.values[:end], x.dt_s), x.dt_s)
    rest = position.values[inside] - np.interp((t - x.start_s) / x.dt_s, np.arange(end), moved)
    return fitted(float(t[0]) - onset_s, position.dt_s, rest, position.count, terms)
