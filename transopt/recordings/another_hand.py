"""What an object does to a stylus in another hand than the one whose tap was recorded.

The surface is met by what holds the stylus too, so that a tap is another one in every hand. Of a linear object the
tap in another hand follows from the recorded one, without a model of the object. With F the force of the contact, g
the stylus acceleration after an impulse of force (`old` in the hand of the recording, `new` in the other one), and v
the incoming speed, the recorded tap is r = g_old * F_old, its penetration speed v - integral(g_old * F_old), and the
object, being linear and at rest before, answers both penetrations with one impulse response. This cancels, and

    F_new + K * F_new = F_old,    K = (g_new - g_old) * F_old / v,    r_new = g_new * F_new,

an equation of Volterra, whose kernel is small where the hands are alike. A contact that stiffens with its depth, or
opens, is taken for the linear one that would answer the recorded penetration as it did.
"""

import numpy as np
from scipy import signal

from transopt.base.recursions import LinearSystem
from transopt.base.signals import FloatArray
from transopt.plant.state_space import StateSpace


def in_another_hand(
    tap_m_s2: FloatArray, speed_m_s: float, old: StateSpace, new: StateSpace, dt_s: float
) -> FloatArray:
    """(K,) the tap in another hand, from the recorded one (K,) less its hand's own motion, at rest before contact.

    Parameters
    ----------
    old, new : from force on the stylus to its acceleration, with a feedthrough: one over the mass that is struck.
    """
    g_old, g_new = (_sampled(plant, dt_s) for plant in (old, new))
    A, B, C, D = g_old
    force = LinearSystem(A - B @ C / D, B / D, -C / D, 1 / D).outputs(tap_m_s2[None])
    kernel = dt_s * (LinearSystem(*g_new).outputs(force) - tap_m_s2)[0] / speed_m_s
    kernel[0] = 1 + kernel[0] / 2  # trapezoidal rule
    other = signal.lfilter([1.0], kernel, force[0])
    return np.asarray(LinearSystem(*g_new).outputs(other[None])[0])


def _sampled(plant: StateSpace, dt_s: float) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """A, B, C, D of forces that are linear between samples."""
    A, B, C, D, _ = signal.cont2discrete((plant.A, plant.B, plant.C, plant.D), dt_s, method="foh")
    return A, B, C, D
