"""Amplifier: one pole and a pure delay, and the prefilter that inverts the pole (seed Sec. 4.1)."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from transopt.base.errors import InputError
from transopt.base.signals import FloatArray


@dataclass(frozen=True)
class Amplifier:
    """du/dt = w (c(t - delay) - u) with w = 2 pi pole, from the command c to the plant's input u.

    Attributes
    ----------
    pole_Hz : > 0.
    delay_s : >= 0, in addition to the hold of the command over a servo period.
    command_limit : largest |c| [A or V], > 0.

    Raises
    ------
    InputError : one of them is out of its range.
    """

    pole_Hz: float
    delay_s: float
    command_limit: float

    def __post_init__(self) -> None:
        if not 0 < self.pole_Hz < np.inf:
            raise InputError(f"amplifier.pole_Hz = {self.pole_Hz:g}: must be > 0 and finite; leave it out if ideal")
        if not 0 <= self.delay_s < np.inf:
            raise InputError(f"amplifier.delay_s = {self.delay_s:g}: must be >= 0 and finite")
        if not 0 < self.command_limit < np.inf:
            raise InputError(f"amplifier: command limit {self.command_limit:g}: must be > 0 and finite")

    @classmethod
    def of(cls, table: Mapping[str, float], unit: str = "A") -> "Amplifier":
        """Read an amplifier from a library's `meta`; the key of the command's limit ends in its unit."""
        return cls(table["pole_Hz"], table["delay_s"], table[f"command_limit_{unit}"])

    def table(self, unit: str) -> dict[str, float]:
        """The amplifier as a table for a library's `meta`."""
        return {"pole_Hz": self.pole_Hz, "delay_s": self.delay_s, f"command_limit_{unit}": self.command_limit}

    @property
    def rate_rad_s(self) -> float:
        """w [rad/s]."""
        return 2 * np.pi * self.pole_Hz


def prefilter_coefficients(amplifier: Amplifier, dt_s: float) -> tuple[float, float]:
    """1 / (1 - p) and -p / (1 - p), p = exp(-w dt): weights of the wanted current at a tick and one tick earlier."""
    p = float(np.exp(-amplifier.rate_rad_s * dt_s))
    return 1 / (1 - p), -p / (1 - p)


def prefilter(current_A: FloatArray, amplifier: Amplifier, dt_s: float) -> FloatArray:
    """Commands that make the current reach `current_A` one servo period later.

    c_k = (i_k - p i_(k-1)) / (1 - p), p = exp(-w dt), i_(-1) = 0: the exact inverse of the pole between two
    switching instants (seed Sec. 4.1).

    Parameters
    ----------
    current_A : (..., N) wanted current i_k [A].

    Returns
    -------
    (..., N) commands c_k [A].
    """
    now, earlier = prefilter_coefficients(amplifier, dt_s)
    command = now * current_A
    command[..., 1:] += earlier * current_A[..., :-1]
    return np.asarray(command)
