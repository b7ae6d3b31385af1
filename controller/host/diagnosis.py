"""Diagnosis of a device: which part is off and by how much, from ratios of seen to expected values.

With the factors by which the amplifier (A), its monitor (M), the motor's force (T), the encoder (E) and the
accelerometer (C) differ from what is stated, the check sees

    current of a pulse over its command             c = A M
    acceleration of it over the model's             a = A T C
    path by the encoder over the true one           E, by a ruler, and p = A T E of a pulse
    encoder over accelerometer, of a hand's motion  s = E / C

so each single error has its own pattern. Several errors at once are refused too, since no two of them cancel in all
four ratios; the part named is then that of the most likely single error.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass

from controller.protocol.capacity import EVIDENCE_LEAST, EVIDENCE_MOST

TOLERANCE = EVIDENCE_MOST - 1  # largest deviation of a ratio from 1; the device applies the same
GRIP_LEAST, GRIP_MOST = 0.6, 1.7  # ratios of acceleration to the model's that another grip may explain
NOTHING = 0.05  # a smaller ratio counts as no response
UNKNOWN = float("nan")


@dataclass(frozen=True)
class Ratios:
    """Ratios of seen to expected values, signed; NaN if not measured.

    Attributes
    ----------
    current : c, of the pulses. acceleration : a, of the pulses. path : p, of the pulses.
    ruler : E, from a distance that a person measured.
    motion : s, encoder over accelerometer.
    gravity : C, reading of the accelerometer at rest over the stated one.
    grip : reading of a known weight over that weight.
    trial : size of the trial tap over its prediction.
    speed : s again, from the approach of the trial tap.
    """

    current: float = UNKNOWN
    acceleration: float = UNKNOWN
    path: float = UNKNOWN
    ruler: float = UNKNOWN
    motion: float = UNKNOWN
    gravity: float = UNKNOWN
    grip: float = UNKNOWN
    trial: float = UNKNOWN
    speed: float = UNKNOWN

    @property
    def accelerometer(self) -> float:
        """C from the hand's motion: E / s, with E from the ruler, or 1 if that was not measured.

        NaN if there was no comparison, or the encoder does not respond.
        """
        encoder = 1.0 if math.isnan(self.ruler) else self.ruler
        if math.isnan(self.motion) or abs(encoder) < NOTHING or self.motion == 0:
            return UNKNOWN
        return encoder / self.motion


def sound(ratio: float) -> bool:
    """Whether a ratio is 1 within the tolerance; false for NaN."""
    return EVIDENCE_LEAST <= ratio <= EVIDENCE_MOST


def off(ratio: float) -> bool:
    """Whether a ratio was measured and is not sound."""
    return not math.isnan(ratio) and not sound(ratio)


def by_how_much(ratio: float) -> str:
    """A ratio in words: `nothing of`, `the opposite of`, `minus 3 times` or `3 times`, to be put before a noun."""
    if abs(ratio) < NOTHING:
        return "nothing of"
    if ratio < 0:
        return "the opposite of" if sound(-ratio) else f"minus {-ratio:.2g} times"
    return f"{ratio:.2g} times"


def diagnosis(found: Ratios) -> list[str]:
    """One sentence for each part that is off; empty if none is."""
    return list(_sentences(found))


def _sentences(r: Ratios) -> Iterator[str]:
    if off(r.ruler):
        yield f"the encoder reads {by_how_much(r.ruler)} the way that the stylus goes"
    accelerometer = r.gravity if off(r.gravity) else r.accelerometer
    if off(accelerometer):
        yield f"the accelerometer reads {by_how_much(accelerometer)} the acceleration that there is"
    yield from _driven(r)
    if off(r.grip):
        yield f"the grip sensor reads {by_how_much(r.grip)} the force that there is"
    if off(r.speed) and not off(r.ruler) and not off(accelerometer):
        yield f"the encoder reads {by_how_much(r.speed)} the motion that the accelerometer says"
    if off(r.trial):
        yield f"the trial tap was {by_how_much(r.trial)} the one that the library's model says"


def _driven(r: Ratios) -> Iterator[str]:
    """Sentences on parts that the pulses show to be off."""
    current, force = r.current, _first(r.acceleration, r.path)
    if off(current) and off(force) and _alike(current, force):
        if abs(current) < NOTHING:
            yield "the amplifier gives nothing: is it enabled, and is the motor's cable plugged in?"
        else:
            yield f"the amplifier gives {by_how_much(current)} the current that is asked for"
        return
    if off(current):
        yield f"the current monitor reads {by_how_much(current)} the current that flows"
    if off(force):
        # The model's response depends on the grip: by a fourth between 1 and 5 N.
        doubt = math.isnan(r.grip) and GRIP_LEAST <= force <= GRIP_MOST
        yield (
            f"the motor pushes with {by_how_much(force)} the force that the library's model says"
            + (" (or the grip is not what was taken for it: hold as always, check --grip-weight-g)" if doubt else "")
        )
    elif off(r.path):
        yield f"the encoder reads {by_how_much(r.path)} the way that the library's model says"


def _first(*ratios: float) -> float:
    return next((ratio for ratio in ratios if not math.isnan(ratio)), UNKNOWN)


def _alike(one: float, other: float) -> bool:
    """Whether two ratios show the same error: both no response, or equal within the tolerance."""
    if abs(one) < NOTHING or abs(other) < NOTHING:
        return abs(one) < 2 * NOTHING and abs(other) < 2 * NOTHING
    return sound(one / other)
