"""The virtual wall of a device, implemented independently from its statement (seed Eq. 9).

Below the surface a spring and a damper push, by the encoder's position of some ticks ago, and never pull. Their force
is converted to a current, and the command is the one with which the amplifier reaches that current within a tick.
This file shares no code with `transopt.plant.wall`.
"""

import numpy as np

from transopt.base.signals import FloatArray
from transopt.scene.sections import Feedback


class Pushing:
    """The wall under V taps, tick by tick.

    Parameters
    ----------
    said : stiffness, damping, latency and filter, as the scene states them.
    force_N_A : force per ampere. pole_rad_s : of the amplifier, infinite for an ideal one.
    limit_A : of the command, feedback and transient together. dt_s : servo period.
    """

    def __init__(self, said: Feedback, force_N_A: float, pole_rad_s: float, limit_A: float, dt_s: float) -> None:
        self._said, self._force_N_A, self._limit_A, self._dt_s = said, force_N_A, limit_A, dt_s
        # What the current makes of a command's step in a tick, and the low-passed position of a step of the encoder.
        self._reached = -np.expm1(-pole_rad_s * dt_s)
        self._fresh = -np.expm1(-2 * np.pi * said.derivative_filter_Hz * dt_s)
        self._readings: list[tuple[FloatArray, FloatArray]] = []

    def start(self, position_m: FloatArray, speed_m_s: FloatArray) -> None:
        """Begin at the first tick of taps (V,) that have come straight until then, and long enough for the filter."""
        step = speed_m_s * self._dt_s
        late = self._said.latency_ticks
        self._smooth_m = position_m - step - step * (1 - self._fresh) / self._fresh
        self._readings = [(position_m - j * step, speed_m_s) for j in range(late, 0, -1)]
        self._flowing_A = np.zeros_like(position_m)

    def command(self, position_m: FloatArray, transient_A: FloatArray) -> FloatArray:
        """(V,) command of this tick for the encoder's positions at it and the waveform's commands."""
        smooth = self._smooth_m + self._fresh * (position_m - self._smooth_m)
        self._readings.append((position_m.copy(), (smooth - self._smooth_m) / self._dt_s))
        self._smooth_m = smooth
        z, v = self._readings.pop(0)
        push_N = -self._said.stiffness_N_m * z - self._said.damping_N_s_m * v
        asked_A = np.where((z < 0) & (push_N > 0), push_N / self._force_N_A, 0.0)
        wanted_A = self._flowing_A + (asked_A - self._flowing_A) / self._reached
        total = np.clip(transient_A + wanted_A, -self._limit_A, self._limit_A)
        # What flows at the next tick is what the command, cut or not, makes of the feedback's current.
        self._flowing_A = self._flowing_A + self._reached * (total - transient_A - self._flowing_A)
        return np.asarray(total)
