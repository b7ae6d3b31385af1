"""Detects recordings in which the hand pulls the stylus back while the waveform made from them still plays.

A struck object throws the stylus back and the stylus then slows down: the object returns its energy at once and
pushes no further than its undeformed surface. A stylus that leaves the object with increasing speed is pulled by the
hand; the encoder shows it. Such a pull belongs to the recording, but with a player's hand that does not pull the tap
is a different one: the error above 30 Hz was 14 %, against 5 % with a yielding hand.
"""

import numpy as np

from transopt.base.signals import Signal

LOOKED_AT_S = np.arange(50e-3, 0.111, 10e-3)  # after contact: ends of the 40 ms stretches that are judged
HALF_S = 20e-3  # longer than the ringing of a stylus on an object in the hand
GROWTH = 1.2  # of the outward speed from one half to the next; a speed given by the object decreases
LEAST_SHARE = 0.2  # of the depth, returned in the second half: a braking hand has up to 0.08, a pulling one 0.3
LEAST_COUNTS = 3.0  # encoder counts returned in the second half
FINEST_M = 10e-6  # resolution assumed for positions without counts


def pulled_back_after_s(position: Signal, onset_s: float) -> float | None:
    """Time after contact at which the hand is seen to pull the stylus back [s]; None if it does not.

    Parameters
    ----------
    position : along the surface normal, positive out of the object [m].
    onset_s : time of contact.
    """
    t, z = position.times_s - onset_s, position.values
    counts_m = LEAST_COUNTS * max(position.count, FINEST_M)
    if position.dt_s > HALF_S / 4 or t[0] > LOOKED_AT_S[0] - 2 * HALF_S:
        return None
    ends_s = LOOKED_AT_S[t[-1] >= LOOKED_AT_S]
    came = np.diff(np.interp(ends_s[:, None] - [2 * HALF_S, HALF_S, 0.0], t, z))
    contact = position.until(onset_s)
    deepest = np.minimum.accumulate(np.append(0.0, z[contact:]))
    depth = -deepest[np.searchsorted(t, ends_s, side="right") - contact]
    for end_s, (before, after), share in zip(ends_s, came, LEAST_SHARE * depth, strict=True):
        if before >= 0 and after >= max(GROWTH * before, share, counts_m):
            return float(end_s)
    return None
