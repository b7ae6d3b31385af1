"""Detects a second hit while the waveform plays: a stylus that was thrown back and struck again.

Ringing after a hit decays, whereas a hit rises from a quiet signal. Between two hits the stylus flies, and for some
milliseconds only the hand accelerates it.
"""

import numpy as np

from transopt.base.signals import Signal

LOOKED_AT_S = 0.1  # after contact: waveforms end sooner, and later hits are separate taps (`split`)
FIRST_S = 0.02  # after contact: the first hit has its peak within it, even on soft rubber
QUIET, QUIET_S = 0.08, 3e-3  # of the first peak, and for how long: the stylus is in flight
HIT = 0.2  # of the first peak: least height of a second hit
RISE_S = 3e-3  # longest rise of a hit from the quiet; a hand is slower


def second_hit(x: Signal, onset_s: float) -> tuple[float, float] | None:
    """Time after contact [s] of a second hit and its peak over the first; None if there is none.

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
    flown = np.flatnonzero(still[quiet:] - still[:-quiet] == quiet) + quiet  # samples right after such a quiet
    flown = flown[flown > int(np.argmax(begun))]
    for at in flown[:-1]:
        ahead = a[at : at + rise]
        if ahead.size and float(ahead.max()) >= HIT * first:
            begin = at + int(np.argmax(ahead >= HIT * first))
            height = float(a[begin : begin + 2 * rise].max())
            return x.start_s + x.dt_s * (contact + begin) - onset_s, height / first
    return None
