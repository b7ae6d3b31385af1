"""Predicts the tap of an object in another hand than the one that held the stylus when it was recorded.

The surface is struck by the stylus and the hand together, so a tap differs from hand to hand. For a linear object the
tap in another hand follows from the recorded one, without a model of the object. Let F be the contact force, g the
stylus acceleration after an impulse of force (`old` in the hand of the recording, `new` in the other one), and v the
incoming speed. The recorded tap is r = g_old * F_old and its penetration speed v - integral(g_old * F_old). A linear
object initially at rest answers both penetrations with the same impulse response. Eliminating it gives

    F_new + K * F_new = F_old,    K = (g_new - g_old) * F_old / v,    r_new = g_new * F_new,

a Volterra equation, whose kernel is small where the hands are similar. A contact that stiffens with depth, or opens,
is treated as the linear contact that would give the recorded force at the recorded penetration.
"""

import numpy as np
from scipy import signal

from transopt.base.recursions import LinearSystem
from transopt.base.signals import FloatArray
from transopt.plant.state_space import StateSpace


def in_another_hand(
    tap_m_s2: FloatArray, speed_m_s: float, old: StateSpace, new: StateSpace, dt_s: float
) -> FloatArray:
    """(K,) tap in another hand, from the recorded tap (K,) less the own motion of its hand; at rest before contact.

    Parameters
    ----------
    old, new : plants from force on the stylus to its acceleration, with feedthrough 1 / (mass that is struck).
    """
    g_old, g_new = (_sampled(plant, dt_s) for plant in (old, new))
    A, B, C, D = g_old
    force = LinearSystem(A - B @ C / D, B / D, -C / D, 1 / D).outputs(tap_m_s2[None])
    kernel = dt_s * (LinearSystem(*g_new).outputs(force) - tap_m_s2)[0] / speed_m_s
    kernel[0] = 1 + kernel[0] / 2  # trapezoidal rule
    other = signal.lfilter([1.0], kernel, force[0])
    return np.asarray(LinearSystem(*g_new).outputs(other[None])[0])


def _sampled(plant: StateSpace, dt_s: float) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Discrete A, B, C, D for forces that are linear between samples (first-order hold)."""
    A, B, C, D, _ = signal.cont2discrete((plant.A, plant.B, plant.C, plant.D), dt_s, method="foh")
    return A, B, C, D
