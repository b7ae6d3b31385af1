"""Detects what a hand does soon after contact, while the waveform made from a recording still plays.

A struck object throws the stylus back and the stylus then slows down: the object returns its energy at once and
pushes no further than its undeformed surface. A stylus that leaves the object with increasing speed is pulled by the
hand; the encoder shows it. Such a pull belongs to the recording, but with a player's hand that does not pull the tap
is a different one: the error above 30 Hz was 14 %, against 5 % with a yielding hand.

A stylus that was thrown back may also strike again. Ringing after a hit decays, whereas a hit rises from a quiet
signal: between two hits the stylus flies, and for some milliseconds only the hand accelerates it.
"""

import numpy as np

from transopt.base.signals import Signal

# Pulling back.
PULLED_AT_S = np.arange(50e-3, 0.111, 10e-3)  # after contact: ends of the 40 ms stretches that are judged
HALF_S = 20e-3  # longer than the ringing of a stylus on an object in the hand
HALVES_S = HALF_S * np.array([[2.0], [1.0], [0.0]])  # before its end: start, middle and end of a stretch
GROWTH = 1.2  # of the outward speed from one half to the next; a speed given by the object decreases
LEAST_SHARE = 0.2  # of the depth, returned in the second half: a braking hand has up to 0.08, a pulling one 0.3
LEAST_COUNTS = 3.0  # encoder counts returned in the second half
FINEST_M = 10e-6  # resolution assumed for positions without counts
# A second hit.
HIT_WITHIN_S = 0.1  # after contact: waveforms end sooner, and later hits are separate taps (`split`)
FIRST_S = 0.02  # after contact: the first hit has its peak within it, even on soft rubber
QUIET, QUIET_S = 0.08, 3e-3  # of the first peak, and for how long: the stylus is in flight
HIT = 0.2  # of the first peak: least height of a second hit
RISE_S = 3e-3  # longest rise of a hit from the quiet; a hand is slower


def pulled_back_after_s(position: Signal, onset_s: float) -> float | None:
    """Time after contact at which the hand is seen to pull the stylus back [s]; None if it does not.

    Parameters
    ----------
    position : along the surface normal, positive out of the object [m].
    onset_s : time of contact.
    """
    z, start_s = position.values, position.start_s - onset_s
    counts_m = LEAST_COUNTS * max(position.count, FINEST_M)
    if position.dt_s > HALF_S / 4 or start_s > PULLED_AT_S[0] - 2 * HALF_S:
        return None
    ends_s = PULLED_AT_S[position.end_s - onset_s >= PULLED_AT_S]
    first, half, last = np.interp((ends_s - HALVES_S - start_s) / position.dt_s, np.arange(z.size), z)
    before, after = half - first, last - half
    contact = position.until(onset_s)
    for i in np.flatnonzero((before >= 0) & (after >= np.maximum(GROWTH * before, counts_m))):
        depth = -z[contact : position.until(onset_s + ends_s[i])].min(initial=0.0)
        if after[i] >= LEAST_SHARE * depth:
            return float(ends_s[i])
    return None


def second_hit(x: Signal, onset_s: float) -> tuple[float, float] | None:
    """Time after contact [s] of a second hit and its peak over the first; None if there is none.

    Parameters
    ----------
    x : without offset, positive where the tap decelerates the stylus, low-passed [m/s^2].
    onset_s : contact, in the time of the signal.
    """
    contact = x.before(onset_s)
    a = x.values[contact : x.until(onset_s + HIT_WITHIN_S)]
    begun = a[: max(round(FIRST_S / x.dt_s), 1)]
    if a.size == 0 or (first := float(begun.max())) <= 0:
        return None
    quiet, rise = max(round(QUIET_S / x.dt_s), 1), max(round(RISE_S / x.dt_s), 1)
    still = np.concatenate([[0], np.cumsum(np.abs(a) < QUIET * first)])
    flown = np.flatnonzero(still[quiet:] - still[:-quiet] == quiet) + quiet  # samples right after such a quiet
    flown = flown[flown > int(np.argmax(begun))]
    for at in flown[:-1]:
        ahead = a[at : at + rise]
        if ahead.size and float(ahead.max()) >= HIT * first:
            begin = at + int(np.argmax(ahead >= HIT * first))
            height = float(a[begin : begin + 2 * rise].max())
            return x.start_s + x.dt_s * (contact + begin) - onset_s, height / first
    return None
