"""Recordings whose own hand pulls the stylus back while the waveform that is made from them still plays.

A struck object throws the stylus back and then slows down: what it gives back it gives at once, and it pushes no
further than to where its surface was. A stylus that comes out of the object ever faster is pulled by the hand, as is
seen by an encoder. Such a pull belongs to the recording, and a player's hand that does not pull has another tap: the
error above 30 Hz was 14 % where a yielding hand's was 5 %.
"""

import numpy as np

from transopt.base.signals import Signal

LOOKED_AT_S = np.arange(50e-3, 0.111, 10e-3)  # after contact, at each of which the way of the 40 ms before is judged
HALF_S = 20e-3  # longer than a stylus rings on an object in a hand
GROWTH = 1.2  # of the speed outwards, from one half to the next; one that the object gives away decreases
LEAST_SHARE = 0.2  # of the depth, come back in the second half: in a braking hand at most 0.08, in a pulling one 0.3
LEAST_COUNTS = 3.0  # of the encoder, come back in the second half
FINEST_M = 10e-6  # what counts as a count where positions are not counted


def pulled_back_after_s(position: Signal, onset_s: float) -> float | None:
    """How long after contact it is seen that the hand pulls the stylus back [s]; None where it is not.

    Parameters
    ----------
    position : along the surface normal, positive out of the object [m].
    onset_s : contact.
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
