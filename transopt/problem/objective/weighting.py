"""Weighting of the tracking error by what the hand feels."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import scipy

from transopt.base.errors import InputError
from transopt.base.shown import brief
from transopt.base.signals import FloatArray

PACINIAN_Hz = 275.0  # where vibration is felt best
PACINIAN_Q = 0.5
FLOOR = 0.1  # -20 dB: what is hardly felt still counts, so that the problem stays strictly convex


@dataclass(frozen=True)
class ErrorFilter:
    """Second-order filter of the sampled error, from rest. b, a : (3,) as in scipy.signal, a[0] = 1."""

    b: FloatArray
    a: FloatArray

    __repr__ = brief

    def apply(self, error: FloatArray) -> FloatArray:
        """(..., N) filtered along the last axis."""
        return np.asarray(scipy.signal.lfilter(self.b, self.a, error, axis=-1))

    def transpose(self, by_filtered: FloatArray) -> FloatArray:
        """(..., N) gradient by the error for a gradient by the filtered error."""
        return np.asarray(scipy.signal.lfilter(self.b, self.a, by_filtered[..., ::-1], axis=-1)[..., ::-1])

    def state_space(self) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """A (2, 2), B (2, 1), C (1, 2), D (1, 1) of the same filter."""
        A, B, C, D = scipy.signal.tf2ss(self.b, self.a)
        return A, B, C, D


def error_filter(name: str, dt_s: float) -> ErrorFilter | None:
    """The filter of a scene or a library by its name.

    Raises
    ------
    InputError : unknown name.
    """
    if name not in ("none", "pacinian"):
        raise InputError(f"weights.error_filter = {name!r}: unknown; choose none or pacinian")
    return pacinian(dt_s) if name == "pacinian" else None


@lru_cache(maxsize=8)  # every entry's verdict asks for it
def pacinian(dt_s: float) -> ErrorFilter:
    """Band-pass at 275 Hz, Q 0.5, unit peak, over a floor of -20 dB.

    With H the band-pass, whose response lies on the circle over [0, 1], the filter 0.1 + 0.9 H has gains from 0.1
    to 1 and is nowhere smaller than its floor.

    Raises
    ------
    InputError : a servo rate that cannot carry it.
    """
    if not 2 * PACINIAN_Hz * dt_s < 1:
        raise InputError(
            f"weights.error_filter: pacinian lies at {PACINIAN_Hz:g} Hz, above half the servo rate {0.5 / dt_s:g} Hz"
        )
    b, a = scipy.signal.iirpeak(PACINIAN_Hz, PACINIAN_Q, fs=1 / dt_s)
    return ErrorFilter(FLOOR * a + (1 - FLOOR) * b, a)
