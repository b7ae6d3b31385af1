"""A second hit within the time that a waveform plays: a stylus that was thrown back and came again.

What rings after a hit dies away; a hit comes out of the quiet. Between the two the stylus flies, and for some
milliseconds nothing accelerates it but the hand.
"""

import numpy as np

from transopt.base.signals import Signal

LOOKED_AT_S = 0.1  # after contact: windows end sooner, and what comes later is a tap of its own (`split`)
FIRST_S = 0.02  # after contact, in which the first hit has its peak, on soft rubber as well
QUIET, QUIET_S = 0.08, 3e-3  # of the first peak, and for how long: the stylus flies
HIT = 0.2  # of the first peak
RISE_S = 3e-3  # in which a hit rises out of the quiet, and a hand does not


def second_hit(x: Signal, onset_s: float) -> tuple[float, float] | None:
    """Time after contact [s] and share of the first peak of a second hit; None where there is none.

    Parameters
    ----------
    x : without offset, positive where the tap decelerates the stylus, low-passed [m/s^2].
    onset_s : contact, in the time of the signal.
    """
    contact = x.before(onset_s)
    a = x.values[contact : x.until(onset_s + LOOKED_AT_S)]
    begun = a[: max(round(FIRST_S / x.dt_s), 1)]
    if a.size == 0 or (first := float(begun.max())) <= 0:
        return None
    quiet, rise = max(round(QUIET_S / x.dt_s), 1), max(round(RISE_S / x.dt_s), 1)
    still = np.concatenate([[0], np.cumsum(np.abs(a) < QUIET * first)])
    flown = np.flatnonzero(still[quiet:] - still[:-quiet] == quiet) + quiet  # samples just behind so long a quiet
    flown = flown[flown > int(np.argmax(begun))]
    for at in flown[:-1]:
        ahead = a[at : at + rise]
        if ahead.size and float(ahead.max()) >= HIT * first:
            begin = at + int(np.argmax(ahead >= HIT * first))
            height = float(a[begin : begin + 2 * rise].max())
            return x.start_s + x.dt_s * (contact + begin) - onset_s, height / first
    return None
