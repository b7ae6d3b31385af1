"""A tap without its slow part: a short target that begins and ends at rest, for tests of limits, walls and methods.

A motor that holds a hand back for 80 ms reaches no steady state, and how it ends hides what a test is about. Above
8 Hz a tap is over after 30 ms.
"""

from dataclasses import replace

import numpy as np
import scipy  # its modules load where they are used, not with every test

from transopt.plant.time_grid import TimeGrid
from transopt.references.reference import Reference

FROM_Hz = 8.0


def without_slow_part(reference: Reference, grid: TimeGrid) -> Reference:
    """The reference whose slow part, below 8 Hz, the hand makes by itself: a_free, with the nominal motion of it."""
    b, a = scipy.signal.butter(2, FROM_Hz, "highpass", fs=1 / grid.dt_s)
    N, L = grid.stages, reference.recorded_before_m_s2.size
    whole = np.concatenate([reference.recorded_before_m_s2, reference.recorded_m_s2, reference.recorded_after_m_s2])
    slow = whole - scipy.signal.lfilter(b, a, whole)
    tau = np.append(grid.switching_times_s, grid.after_times_s)
    before = slow[L:] * (tau >= 0)
    velocity = -reference.speed_m_s + scipy.integrate.cumulative_trapezoid(before, dx=grid.dt_s, initial=0)
    position = scipy.integrate.cumulative_trapezoid(velocity, dx=grid.dt_s, initial=0) - reference.speed_m_s * tau[0]
    return replace(
        reference,
        free_before_m_s2=slow[:L],
        free_m_s2=slow[L : L + N],
        free_after_m_s2=slow[L + N :],
        nominal_velocity_m_s=velocity[:N],
        nominal_position_m=position[:N],
        nominal_position_at_ticks_m=np.interp(grid.all_issue_times_s, tau, position),
    )
