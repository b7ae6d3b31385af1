"""Plausibility of a recording as a tap, to detect wrong units.

A column read in a wrong unit is off by a factor of 9.81, 60 or 1000 and looks like any other. Two figures reveal it,
neither of which depends on the object that was struck:

- the length of the pulse. Taps on metal last some tenths of a millisecond, on foam some tens of milliseconds. It
  depends on the unit of the time only.
- the change of the stylus' speed over its incoming speed. To stop, the stylus has to lose all of its speed, and an
  object that throws it back gives it at most as much again:

      q = max over t of (integral of a from contact to t) / v,   about 1 to 2 for every object.

  The taps of the built-in scenes have 0.78 (soft rubber, assisted by the hand) to 1.38 (metal), the shock-table
  impacts that these limits were tried on 1.1. g read as m/s^2 divides q by 9.81, m/s^2 read as g multiplies it.

If the speed is unknown, or q is that of a stylus thrown back faster than it came, the height of the low-passed peak
is checked as well. Wrong units of speed and acceleration that cancel in q show in the speed itself, because the speed
of a hand is bounded.
"""

import math
from collections.abc import Mapping

import numpy as np

from transopt.base.signals import STANDARD_GRAVITY_M_S2, Signal
from transopt.recordings.settings import Recordings

PULSE_S = (30e-6, 0.1)  # length of the pulse at half its height
SPEED_CHANGE = (0.25, 5.0)  # change of speed over the incoming speed
THROWN_BACK = (
    2.0  # largest change of speed over the incoming speed on an object; above it no speed vouches for the height
)
USUAL_SPEED_CHANGE = 1.2
CHANGE_WITHIN_S = 0.05  # after contact; later the hand lifts the stylus
PEAK_G = (0.3, 60.0)  # peaks of taps by hand; the built-in ones reach 19
HAND_M_S = (0.01, 3.0)  # speeds that a hand taps with
HAND_N = (0.05, 60.0)  # forces that a hand grips with
FINE = 100_000  # number of samples to which a recording is reduced for this check
GROWTH = 1.2  # ratio of the successive lengths tried for the pulse


def pulse_length_s(x: Signal) -> float:
    """Duration of a pulse at about half its height [s].

    It is the longest stretch whose mean is half of the peak; noise and ringing on the pulse do not shorten it. The
    median of the recording counts as rest, so that an unknown offset does not lengthen it, and the larger deviation
    from rest counts as up.
    """
    # In a long recording, means of a few samples suffice, accurate to a hundred thousandth of its length.
    few = max(x.values.size // FINE, 1)
    values = x.values[: x.values.size // few * few].reshape(-1, few).mean(axis=1)
    values -= np.median(values)
    values *= np.sign(values[np.argmax(np.abs(values))])
    total = np.concatenate([[0.0], np.cumsum(values)])
    half, longest, length = 0.5 * float(values.max()), 1, 1
    # A stretch has no larger mean than the better of its halves, so nothing beyond twice the longest can qualify.
    while length < min(values.size, 2 * GROWTH * longest + 1):
        if float((total[length:] - total[:-length]).max()) >= half * length:
            longest = length
        length = max(length + 1, round(GROWTH * length))
    return longest * few * x.dt_s


def implausible_time(x: Signal) -> str:
    """Why the times of a recording cannot be those of a tap; empty if they can be.

    Parameters
    ----------
    x : as recorded, of one tap or several, in the recording's own time.
    """
    length_s = pulse_length_s(x)
    if PULSE_S[0] <= length_s <= PULSE_S[1]:
        return ""
    guess = (
        "s called ms?)" if length_s < PULSE_S[0] else "ms called s?), and that the acceleration is no other column"
    )
    return (
        f"the pulse lasts {1e3 * length_s:.3g} ms, a tap's {1e3 * PULSE_S[0]:g} to {1e3 * PULSE_S[1]:g} ms: "
        f"check the unit of the time ({guess}"
    )


def speed_changes_m_s(x: Signal, onset_s: float) -> tuple[float, float]:
    """Largest increase and largest decrease of the speed soon after contact, by integrating the acceleration."""
    during = slice(x.before(onset_s), x.until(onset_s + CHANGE_WITHIN_S))
    change = np.cumsum(x.values[during]) * x.dt_s
    return float(change.max(initial=0.0)), float(-change.min(initial=0.0))


def implausible_motion(
    x: Signal, peak_m_s2: float, onset_s: float, speed_m_s: float, settings: Recordings, *, fitted: bool
) -> str:
    """Why acceleration and speed cannot belong to one tap, and which unit to check; empty if they can.

    Parameters
    ----------
    x : without offset, positive where the tap decelerates the stylus [m/s^2], in the recording's own time.
    peak_m_s2 : of the low-passed acceleration.
    onset_s : time of contact.
    speed_m_s : incoming speed before any scaling; NaN if unknown.
    settings : the scene's settings, which may be the wrong part.
    fitted : whether the speed is fitted to a position, so that the position's unit is the one to check.
    """
    by_hand = (settings.time_scale, settings.amplitude_scale) == (1.0, 1.0)
    height = _height(peak_m_s2 / STANDARD_GRAVITY_M_S2) if by_hand else ""
    if np.isnan(speed_m_s):
        return height
    up, down = speed_changes_m_s(x, onset_s)
    ratio = up / speed_m_s
    column = "of the position that the speed is fitted to" if fitted else "of the speed"
    if SPEED_CHANGE[0] <= ratio <= SPEED_CHANGE[1]:
        if by_hand and speed_m_s > HAND_M_S[1]:
            return (
                f"the incoming speed is {speed_m_s:.3g} m/s, a hand's {HAND_M_S[0]:g} to {HAND_M_S[1]:g} m/s: check "
                f"the unit {column}, and that of the acceleration, which agrees with it"
            )
        return height if ratio > THROWN_BACK else ""
    times = f"{ratio:.0f}" if ratio >= 10 else f"{ratio:.2g}"
    found = (
        f"the pulse changes the speed by {up:.3g} m/s, {times} times the incoming {speed_m_s:.3g} m/s (limits "
        f"{SPEED_CHANGE[0]:g} and {SPEED_CHANGE[1]:g})"
    )
    if down > up and settings.polarity != "auto":
        return f'{found}: check recordings.polarity = "{settings.polarity}", the pulse has the other sign'
    if not HAND_M_S[0] <= speed_m_s <= HAND_M_S[1]:
        return f"{found}: check the unit {column} (a hand taps with {HAND_M_S[0]:g} to {HAND_M_S[1]:g} m/s)"
    guess = "g called m/s^2?" if ratio < 1 else "m/s^2 called g?"
    places = {"onset_s": settings.onset_s != "auto", "offset_m_s2": settings.offset_m_s2 != "baseline"}
    stated = "".join(f", or recordings.{key}" for key, is_stated in places.items() if is_stated)
    return f"{found}: check the unit of the acceleration ({guess}), or {column}{stated}"


def implausible_grip(grip_N: float) -> str:
    """Why a recorded grip cannot be a hand's, and which unit was probably meant; empty if it can be.

    A grip below the range may be a load cell's noise at a stylus that nobody holds.
    """
    if grip_N <= HAND_N[1]:
        return ""
    likely = likely_slip(grip_N, HAND_N, {"N and gf": 1e3 / STANDARD_GRAVITY_M_S2, "N and mN": 1e3})
    hand = f"a hand's {HAND_N[0]:g} to {HAND_N[1]:g} N"
    return f"the grip is {grip_N:.4g} N, {hand}: check the unit of the grip{likely}"


def _height(peak_g: float) -> str:
    if PEAK_G[0] <= peak_g <= PEAK_G[1]:
        return ""
    likely = likely_slip(peak_g, PEAK_G, {"g and m/s^2": STANDARD_GRAVITY_M_S2, "mg or mm/s^2": 1e3})
    return (
        f"peak {peak_g:.3g} g, a tap's by hand {PEAK_G[0]:g} to {PEAK_G[1]:g} g: check the unit of the "
        f"acceleration{likely}"
    )


def likely_slip(value: float, bounds: tuple[float, float], factors: Mapping[str, float]) -> str:
    """The most likely slip that moved a value out of its bounds, as a question; empty if none explains it."""
    by = {name: value * (1 / factor if value > bounds[1] else factor) for name, factor in factors.items()}
    middle = math.log(bounds[0] * bounds[1]) / 2
    inside = {name: abs(math.log(each) - middle) for name, each in by.items() if bounds[0] <= each <= bounds[1]}
    return slip(min(inside, key=lambda name: inside[name]), factors) if inside else ""


def slip(name: str, factors: Mapping[str, float]) -> str:
    """A mistaken unit with its factor, as a question at the end of a message."""
    return f" (a factor of {factors[name]:.4g}: {name}?)"
