"""Filters that weight the tracking error by what the hand feels."""

from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Literal

import numpy as np

from transopt.base.errors import InputError
from transopt.base.recursions import LinearSystem
from transopt.base.shown import brief
from transopt.base.signals import FloatArray

PACINIAN_Hz = 275.0  # frequency of the highest sensitivity to vibration
PACINIAN_Q = 0.5
RAPID = ("highpass", "pacinian", "none")  # values of a scene's `weights.rapid`
FLOOR = 0.1  # least gain of the Pacinian filter, -20 dB, at which every frequency still counts


@dataclass(frozen=True, eq=False)
class ErrorFilter:
    """Second-order filter of the sampled error, starting at rest. Equal ones are the same object.

    Attributes
    ----------
    b, a : (3,) coefficients as in scipy.signal, a[0] = 1.
    """

    b: FloatArray
    a: FloatArray

    __repr__ = brief

    def apply(self, error: FloatArray) -> FloatArray:
        """(..., N) error filtered along the last axis."""
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
    from_Hz : corner, at -3 dB.

    Raises
    ------
    InputError : a corner at or above half the servo rate.
    """
    if not 0 < 2 * from_Hz * dt_s < 1:
        raise InputError(
            f"weights.rapid_from_Hz = {from_Hz:g} Hz: must be above 0 and below half the servo rate, "
            f"{0.5 / dt_s:g} Hz; lower it or time.dt_s"
        )
    # The low-pass 1 / (1 + sqrt(2) s + s^2) with s replaced by 1 / s; bilinear transform with w the prewarped corner.
    w = np.tan(np.pi * from_Hz * dt_s)
    scale = 1 + np.sqrt(2) * w + w * w
    a = np.array([1.0, 2 * (w * w - 1) / scale, (1 - np.sqrt(2) * w + w * w) / scale])
    return ErrorFilter(np.array([1.0, -2.0, 1.0]) / scale, a)


@lru_cache(maxsize=8)
def bandpass(low_Hz: float, high_Hz: float, dt_s: float, order: Literal[1, 2]) -> tuple[ErrorFilter, ...]:
    """Butterworth band-pass by the bilinear transform, as a cascade of second-order sections.

    The low-pass prototype is mapped to the band by s -> (s^2 + w0^2) / (bw s), with the edges prewarped.

    Parameters
    ----------
    low_Hz, high_Hz : edges, at -3 dB; below half the servo rate.
    order : order of the prototype, which is the number of sections, 1 or 2.
    """
    low, high = (np.tan(np.pi * edge * dt_s) for edge in (low_Hz, high_Hz))
    width, middle = high - low, low * high
    if order == 1:
        pairs = [np.roots([1.0, width, middle])]
    else:
        # Each root belongs to one of the prototype's two conjugate poles; its conjugate belongs to the other.
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


@lru_cache(maxsize=8)  # the verdict of every entry needs it
def pacinian(dt_s: float) -> ErrorFilter:
    """Band-pass at 275 Hz with Q = 0.5, unit peak and a floor of -20 dB.

    The response of the band-pass H lies on the circle whose diameter is [0, 1], so 0.1 + 0.9 H has gains from 0.1 to
    1.

    Raises
    ------
    InputError : a servo rate too low for it.
    """
    if not 2 * PACINIAN_Hz * dt_s < 1:
        raise InputError(
            f"weights.rapid: pacinian lies at {PACINIAN_Hz:g} Hz, above half the servo rate {0.5 / dt_s:g} Hz"
        )
    # Bilinear transform of (s / Q) / (s^2 + s / Q + 1), with the bandwidth of Q kept by prewarping.
    w0 = 2 * np.pi * PACINIAN_Hz * dt_s
    share = 1 / (1 + np.tan(0.5 * w0 / PACINIAN_Q))
    a = np.array([1.0, -2 * share * np.cos(w0), 2 * share - 1])
    b = (1 - share) * np.array([1.0, 0.0, -1.0])
    return ErrorFilter(FLOOR * a + (1 - FLOOR) * b, a)
