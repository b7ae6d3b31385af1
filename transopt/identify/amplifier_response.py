"""The amplifier's response to a held command: one pole and a pure delay, sampled once a tick."""

import numpy as np
from scipy import special

from transopt.base.recursions import filtered
from transopt.base.signals import ComplexArray, FloatArray
from transopt.plant.discretise import split_delay


def sampled(
    frequencies_Hz: FloatArray, pole_Hz: float, delay_s: float, dt_s: float
) -> tuple[ComplexArray, ComplexArray]:
    """Exact response from commands issued at t_k and held to the current sampled at t_k, before c_k acts.

    Modified z-transform (Jury 1964): with m whole ticks in the delay, e the rest, p = exp(-w dt),
    q = exp(-w (dt - e)),  G(z) = z^-(m+1) ((1 - q) + (q - p) z^-1) / (1 - p z^-1).

    Returns
    -------
    (m,) response of gain one, and (2, m) its derivatives by the logarithm of the pole and by the delay.
    """
    whole, now, before, keep = _difference_equation(pole_Hz, delay_s, dt_s)
    late = np.exp(-2j * np.pi * frequencies_Hz * dt_s)
    ahead, below = late ** (whole + 1), 1 - keep * late
    value = ahead * (now + before * late) / below
    q, w = 1 - now, 2 * np.pi * pole_Hz
    # Derivatives with respect to the logarithm of the pole: d exp(-x) / d log(pole) = -x exp(-x), which `xlogy`
    # evaluates as 0 where the exponential underflows.
    d_q, d_keep = special.xlogy(q, q), special.xlogy(keep, keep)
    by_pole = (ahead * (d_q * (late - 1) - d_keep * late) + value * d_keep * late) / below
    by_delay = ahead * w * q * (late - 1) / below
    return np.asarray(value), np.array([by_pole, by_delay])


def _difference_equation(pole_Hz: float, delay_s: float, dt_s: float) -> tuple[int, float, float, float]:
    """m, now, before, keep of the difference equation i_(k+1) = keep i_k + now c_(k-m) + before c_(k-m-1)."""
    w = 2 * np.pi * pole_Hz
    whole, rest = split_delay(delay_s, dt_s)
    q = float(np.exp(-w * (dt_s - rest)))
    keep = float(np.exp(-w * dt_s))
    return whole, 1 - q, q - keep, keep


def simulate_current(command_A: FloatArray, pole_Hz: float, delay_s: float, dt_s: float) -> FloatArray:
    """(n,) exact current at the ticks, from rest, for commands (n,) that are held from tick to tick."""
    whole, now, before, keep = _difference_equation(pole_Hz, delay_s, dt_s)
    numerator = np.concatenate([np.zeros(whole + 1), [now, before]])
    return filtered(numerator, np.array([1.0, -keep]), command_A)


def less_dead_band(command_A: FloatArray, half_width_A: float) -> FloatArray:
    """(n,) the command less the dead band: the part of it that an amplifier with a crossover follows."""
    return np.asarray(command_A - np.clip(command_A, -half_width_A, half_width_A))
