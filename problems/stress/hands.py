"""The hand's motion in a stress case: acceleration without current, and nominal motion."""

import numpy as np
from scipy.integrate import cumulative_trapezoid

from transopt.base.signals import FloatArray
from transopt.plant.intention import FreeMotion, Intention
from transopt.plant.time_grid import TimeGrid

FINER = 4  # samples of the motion in a servo period


class HandMotion:
    """Free acceleration and nominal motion of one tap, from contact on; straight before it.

    Parameters
    ----------
    intention : intended motion of the hand.
    speed_m_s : incoming speed.
    """

    def __init__(self, intention: Intention, speed_m_s: float, grid: TimeGrid) -> None:
        self._speed_m_s = speed_m_s
        last_s = grid.end_s + (grid.after_stages + 1) * grid.dt_s
        self._times_s = np.arange(max(int(np.ceil(FINER * last_s / grid.dt_s)), 1) + 2) * grid.dt_s / FINER
        free = FreeMotion(intention, None)
        self._free_m_s2 = free.acceleration_m_s2(speed_m_s, 0.0, self._times_s)
        self._gained_m_s = cumulative_trapezoid(self._free_m_s2, self._times_s, initial=0)
        self._way_m = cumulative_trapezoid(self._gained_m_s, self._times_s, initial=0)

    def _at(self, times_s: FloatArray, course: FloatArray) -> FloatArray:
        return np.interp(times_s, self._times_s, course, left=0.0)

    def free_m_s2(self, times_s: FloatArray) -> FloatArray:
        """(K,) a_free [m/s^2]."""
        return self._at(times_s, self._free_m_s2)

    def velocity_m_s(self, times_s: FloatArray) -> FloatArray:
        """(K,) dz_nom/dt [m/s]."""
        return self._at(times_s, self._gained_m_s) - self._speed_m_s

    def position_m(self, times_s: FloatArray) -> FloatArray:
        """(K,) z_nom [m]."""
        return self._at(times_s, self._way_m) - self._speed_m_s * times_s
