"""The figures by which the haptics trade compares clicks: pulse to ring, rise, brake, duration, peak.

They need the acceleration, and of the target only its end. The trade has no common definition of them: AOSP
(source.android.com, "Analyze the waveform") lists a pulse-to-ring ratio without its formula. Each figure is therefore
defined here, and may differ from that of other tools.
"""

from dataclasses import dataclass

import numpy as np

from transopt.base.signals import FloatArray
from transopt.library.library import Library
from transopt.problem.objective.target import Target

PRESENT = 0.1  # share of the peak below which nothing counts as vibration
SAME = 1e-6  # samples: bound on the rounding error of a target's end
RISEN = 0.9  # share of the peak at which the rise ends


@dataclass(frozen=True)
class TradeFigures:
    """Figures of a click; a is its acceleration in the window and after it.

    The pulse is a up to the target's end, the ring is a after it. A named target states its end. A tap states none
    and ends at the last instant at which |r| is `PRESENT` of its peak. Crossings are interpolated between samples.

    Attributes
    ----------
    peak_m_s2 : max |a|.
    rise_s : from the first instant with |a| = 10 % of the peak to the first with 90 %.
    duration_s : from the first to the last instant with |a| = 10 % of the peak.
    brake_s : from the target's end to the last instant with |a| = 10 % of the peak; 0 if that instant comes before,
        and infinite if |a| is still larger at the last sample.
    pulse_to_ring : (max a - min a) of the pulse over the same of the ring; infinite without a ring, NaN if the target
        lasts to the last sample.
    ring_energy_m2_s3 : integral of a^2 over the ring.
    ring_share : that integral over the integral of all of a^2.
    target_ends_s : time of the target's end after the first sample.

    Rise, duration and ratio are NaN if a is zero throughout.
    """

    peak_m_s2: float
    rise_s: float
    duration_s: float
    brake_s: float
    pulse_to_ring: float
    ring_energy_m2_s3: float
    ring_share: float
    target_ends_s: float


def _first(size: FloatArray, level: float) -> float:
    """Fractional index of the sample at which `size` first reaches a level, which it must reach."""
    at = int(np.argmax(size >= level))
    if at == 0:
        return 0.0
    before, now = size[at - 1 : at + 1]
    return float(at - 1 + (level - before) / (now - before))


def _last_asked(target: Target) -> int:
    """Index of the last sample at `PRESENT` or more of the target's peak; 0 for a zero target."""
    asked = np.abs(target.continued_m_s2)
    return int(np.flatnonzero(asked >= PRESENT * asked.max())[-1]) if asked.any() else 0


def trade_of(acceleration_m_s2: FloatArray, target: Target, dt_s: float, ends_s: float | None = None) -> TradeFigures:
    """The trade's figures of an acceleration.

    Parameters
    ----------
    acceleration_m_s2 : (N + K,) in the window and at K >= 0 instants after it; the larger K, the later the end of a
        ring can be seen.
    target : r, (N,) in the window.
    dt_s : time between two samples.
    ends_s : end of the target after the first sample; None for the last instant at `PRESENT` of its peak.
    """
    a = acceleration_m_s2
    last = min(_last_asked(target) if ends_s is None else max(int(ends_s / dt_s + SAME), 0), a.size - 1)
    pulse, ring = a[: last + 1], a[last + 1 :]
    size = np.abs(a)
    peak, energy, after = float(size.max()), float(a @ a), float(ring @ ring)
    if peak == 0:
        rise = duration = ratio = float("nan")
        brake = 0.0
    else:
        begins, risen = _first(size, PRESENT * peak), _first(size, RISEN * peak)
        # In reversed time the last instant is the first.
        gone = a.size - 1 - _first(size[::-1], PRESENT * peak)
        rise, duration = (risen - begins) * dt_s, (gone - begins) * dt_s
        brake = float("inf") if size[-1] >= PRESENT * peak else max(gone - last, 0.0) * dt_s
        rung = float(np.ptp(ring)) if ring.size else float("nan")
        ratio = float(np.ptp(pulse)) / rung if rung != 0 else float("inf")
    return TradeFigures(
        peak_m_s2=peak,
        rise_s=rise,
        duration_s=duration,
        brake_s=brake,
        pulse_to_ring=ratio,
        ring_energy_m2_s3=after * dt_s,
        ring_share=after / energy if energy else 0.0,
        target_ends_s=last * dt_s,
    )


def entry_trade(library: Library, iv: int, ig: int, acceleration_m_s2: FloatArray) -> TradeFigures:
    """The trade's figures of an entry's acceleration (N + M,) at the switching instants of its library.

    Of several accelerations (p, N + M) they are those of the first.
    """
    wanted = library.wanted_of(iv, ig)
    grid = library.time_grid()
    ends_s = wanted.ends_s - float(grid.switching_times_s[0]) if np.isfinite(wanted.ends_s) else None
    return trade_of(np.atleast_2d(acceleration_m_s2)[0], wanted.target.normal, grid.dt_s, ends_s)


def trade_figures(library: Library, iv: int, ig: int) -> TradeFigures:
    """The trade's figures of an entry as designed, in its window and the `weights.after_s` after it."""
    return entry_trade(library, iv, ig, library.lasting(iv, ig)[0])
