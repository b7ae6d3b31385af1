"""Weighting of the tracking error by what the hand feels."""

from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Literal

import numpy as np

from transopt.base.errors import InputError
from transopt.base.recursions import LinearSystem
from transopt.base.shown import brief
from transopt.base.signals import FloatArray

PACINIAN_Hz = 275.0  # where vibration is felt best
PACINIAN_Q = 0.5
RAPID = ("highpass", "pacinian", "none")  # what a scene's `weights.rapid` may be
FLOOR = 0.1  # -20 dB: what is hardly felt still counts, so that the problem stays strictly convex


@dataclass(frozen=True)
class ErrorFilter:
    """Second-order filter of the sampled error, from rest. b, a : (3,) as in scipy.signal, a[0] = 1."""

    b: FloatArray
    a: FloatArray

    __repr__ = brief

    def apply(self, error: FloatArray) -> FloatArray:
        """(..., N) filtered along the last axis."""
        return self._system.outputs(error[..., None, :])[..., 0, :]

    def transpose(self, by_filtered: FloatArray) -> FloatArray:
        """(..., N) gradient by the error for a gradient by the filtered error."""
        return self._system.transposed(by_filtered[..., None, :])[..., 0, :]

    @cached_property
    def _system(self) -> LinearSystem:
        return LinearSystem(*self.state_space())

    def state_space(self) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """A (2, 2), B (2, 1), C (1, 2), D (1, 1) of the same filter, in the controllable canonical form."""
        (_, a1, a2), (b0, b1, b2) = self.a, self.b
        A, B = np.array([[-a1, -a2], [1.0, 0.0]]), np.array([[1.0], [0.0]])
        return A, B, np.array([[b1 - b0 * a1, b2 - b0 * a2]]), np.array([[b0]])


@lru_cache(maxsize=8)
def highpass(from_Hz: float, dt_s: float) -> ErrorFilter:
    """Second-order Butterworth high-pass by the bilinear transform.

    Parameters
    ----------
    from_Hz : where it has lost 3 dB.

    Raises
    ------
    InputError : a corner at or above half the servo rate.
    """
    if not 0 < 2 * from_Hz * dt_s < 1:
        raise InputError(
            f"weights.rapid_from_Hz = {from_Hz:g} Hz: must be above 0 and below half the servo rate, "
            f"{0.5 / dt_s:g} Hz; lower it or time.dt_s"
        )
    # 1 / (1 + sqrt(2) s + s^2) mirrored, with s = (1/w)(1 - z)/(1 + z) and w the prewarped corner.
    w = np.tan(np.pi * from_Hz * dt_s)
    scale = 1 + np.sqrt(2) * w + w * w
    a = np.array([1.0, 2 * (w * w - 1) / scale, (1 - np.sqrt(2) * w + w * w) / scale])
    return ErrorFilter(np.array([1.0, -2.0, 1.0]) / scale, a)


@lru_cache(maxsize=8)
def bandpass(low_Hz: float, high_Hz: float, dt_s: float, order: Literal[1, 2]) -> tuple[ErrorFilter, ...]:
    """Butterworth band-pass by the bilinear transform, as second-order sections one behind the other.

    The prototype's poles go to those of the band by s -> (s^2 + w0^2) / (bw s), with the edges prewarped.

    Parameters
    ----------
    low_Hz, high_Hz : edges, where it has lost 3 dB; below half the servo rate.
    order : of the prototype and number of sections, 1 or 2.
    """
    low, high = (np.tan(np.pi * edge * dt_s) for edge in (low_Hz, high_Hz))
    width, middle = high - low, low * high
    if order == 1:
        pairs = [np.roots([1.0, width, middle])]
    else:
        # Each root of one of the prototype's two conjugate poles stands for a pair.
        pairs = [np.array([root, root.conj()]) for root in np.roots([1.0, -width * np.exp(0.75j * np.pi), middle])]
    sections = []
    centre = np.exp(2j * np.arctan(np.sqrt(middle)))
    for pair in pairs:
        z = (1 + pair) / (1 - pair)
        a = np.array([1.0, -float(np.real(z.sum())), float(np.real(z.prod()))])
        b = np.array([1.0, 0.0, -1.0])
        gain = abs(np.polyval(b, centre) / np.polyval(a, centre))
        sections.append(ErrorFilter(b / gain, a))
    return tuple(sections)


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
            f"weights.rapid: pacinian lies at {PACINIAN_Hz:g} Hz, above half the servo rate {0.5 / dt_s:g} Hz"
        )
    # The bilinear transform of (s / Q) / (s^2 + s / Q + 1) with the band edges where Q puts them.
    w0 = 2 * np.pi * PACINIAN_Hz * dt_s
    share = 1 / (1 + np.tan(0.5 * w0 / PACINIAN_Q))
    a = np.array([1.0, -2 * share * np.cos(w0), 2 * share - 1])
    b = (1 - share) * np.array([1.0, 0.0, -1.0])
    return ErrorFilter(FLOOR * a + (1 - FLOOR) * b, a)
