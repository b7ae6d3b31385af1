"""The amplifier's response behind a held command: one pole and a pure delay, sampled once a tick."""

from collections.abc import Callable

import numpy as np
from scipy import special

from transopt.base.recursions import filtered
from transopt.base.signals import ComplexArray, FloatArray
from transopt.plant.discretise import split_delay

Shape = Callable[[FloatArray, float, float, float], tuple[ComplexArray, ComplexArray]]
"""Frequencies (m,), pole [Hz], delay [s], period [s] -> response of gain one (m,), and its derivatives (2, m) by the
logarithm of the pole and by the delay."""


def sampled(
    frequencies_Hz: FloatArray, pole_Hz: float, delay_s: float, dt_s: float
) -> tuple[ComplexArray, ComplexArray]:
    """Exact response from commands issued at t_k and held to the current sampled at t_k, before c_k acts: a `Shape`.

    Modified z-transform (Jury 1964): with m whole ticks in the delay, e the rest, p = exp(-w dt),
    q = exp(-w (dt - e)),  G(z) = z^-(m+1) ((1 - q) + (q - p) z^-1) / (1 - p z^-1).
    """
    whole, now, before, keep = _difference_equation(pole_Hz, delay_s, dt_s)
    late = np.exp(-2j * np.pi * frequencies_Hz * dt_s)
    ahead, below = late ** (whole + 1), 1 - keep * late
    value = ahead * (now + before * late) / below
    q, w = 1 - now, 2 * np.pi * pole_Hz
    # Slopes by the logarithm of the pole, to which the exponents are in proportion; 0 of a pole beyond any tick.
    d_q, d_keep = special.xlogy(q, q), special.xlogy(keep, keep)
    by_pole = (ahead * (d_q * (late - 1) - d_keep * late) + value * d_keep * late) / below
    by_delay = ahead * w * q * (late - 1) / below
    return np.asarray(value), np.array([by_pole, by_delay])


def sampled_response(frequencies_Hz: FloatArray, pole_Hz: float, delay_s: float, dt_s: float) -> ComplexArray:
    """(m,) the value of `sampled`."""
    return sampled(frequencies_Hz, pole_Hz, delay_s, dt_s)[0]


def _difference_equation(pole_Hz: float, delay_s: float, dt_s: float) -> tuple[int, float, float, float]:
    """m and the coefficients of i_(k+1) = keep i_k + now c_(k-m) + before c_(k-m-1)."""
    w = 2 * np.pi * pole_Hz
    whole, rest = split_delay(delay_s, dt_s)
    q = float(np.exp(-w * (dt_s - rest)))
    keep = float(np.exp(-w * dt_s))
    return whole, 1 - q, q - keep, keep


def continuous(
    frequencies_Hz: FloatArray, pole_Hz: float, delay_s: float, _: float
) -> tuple[ComplexArray, ComplexArray]:
    """One pole and a delay without hold or samples: a `Shape`."""
    s = np.asarray(2j * np.pi * frequencies_Hz, dtype=np.complex128)
    turn = s / (2 * np.pi * pole_Hz)
    value = np.exp(-s * delay_s) / (1 + turn)
    return value, np.array([value * turn / (1 + turn), -s * value])


def simulate_current(command_A: FloatArray, pole_Hz: float, delay_s: float, dt_s: float) -> FloatArray:
    """(n,) current sampled at the ticks for commands (n,) held from the ticks, from rest, exactly."""
    whole, now, before, keep = _difference_equation(pole_Hz, delay_s, dt_s)
    numerator = np.concatenate([np.zeros(whole + 1), [now, before]])
    return filtered(numerator, np.array([1.0, -keep]), command_A)


def less_dead_band(command_A: FloatArray, half_width_A: float) -> FloatArray:
    """(n,) what an amplifier with a crossover follows of a command."""
    return np.asarray(command_A - np.clip(command_A, -half_width_A, half_width_A))
