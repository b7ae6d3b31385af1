"""What is off at a device, by how much, and which part it is: from ratios of what was seen to what was expected.

With the factors by which the amplifier (A), its monitor (M), the motor's force (T), the encoder (E) and the
accelerometer (C) differ from what is stated, the check sees

    current of a pulse over what was asked          c = A M
    acceleration of it over the model's             a = A T C
    path by the encoder over the true one           E, by a ruler, and p = A T E of a pulse
    encoder over accelerometer, of a hand's motion  s = E / C

so a single error shows in a pattern of its own. Several errors at once are refused as well, since no two of them
cancel in all four, and what is named then is the likeliest single one.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass

from controller.protocol.capacity import EVIDENCE_LEAST, EVIDENCE_MOST

TOLERANCE = EVIDENCE_MOST - 1  # by which a ratio may differ from 1, up and down; the device's own
GRIP_LEAST, GRIP_MOST = 0.6, 1.7  # of the model's acceleration, which another grip may explain
NOTHING = 0.05  # a ratio below this is no answer at all
UNKNOWN = float("nan")


@dataclass(frozen=True)
class Ratios:
    """Seen over expected, signed; NaN where it was not measured.

    Attributes
    ----------
    current : c, of the pulses. acceleration : a, of the pulses. path : p, of the pulses.
    ruler : E, of a way that a person measured.
    motion : s, encoder over accelerometer.
    gravity : C, of what the accelerometer reads at rest over what was stated.
    grip : of a known weight.
    trial : of the trial tap over its prediction.
    speed : s again, of the trial tap's approach.
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
        """C by the hand's motion: what is left of s when the encoder is known from the ruler.

        NaN where nothing was compared, or the encoder gives nothing to compare with.
        """
        encoder = 1.0 if math.isnan(self.ruler) else self.ruler
        if math.isnan(self.motion) or abs(encoder) < NOTHING or self.motion == 0:
            return UNKNOWN
        return encoder / self.motion


def sound(ratio: float) -> bool:
    """Whether a ratio is 1 within the tolerance; NaN is not."""
    return EVIDENCE_LEAST <= ratio <= EVIDENCE_MOST


def off(ratio: float) -> bool:
    """Whether it was measured and is not sound."""
    return not math.isnan(ratio) and not sound(ratio)


def by_how_much(ratio: float) -> str:
    """`nothing of`, `the opposite of`, `minus 3 times` or `3 times`, to be put before what it is a part of."""
    if abs(ratio) < NOTHING:
        return "nothing of"
    if ratio < 0:
        return "the opposite of" if sound(-ratio) else f"minus {-ratio:.2g} times"
    return f"{ratio:.2g} times"


def diagnosis(found: Ratios) -> list[str]:
    """Sentences, one for each part that is off; empty if nothing is."""
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
    """What the pulses show."""
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
        # The model's answer depends on the grip, by a fourth between 1 and 5 N.
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
    """Whether two ratios are one error: both nothing, or within the tolerance of each other."""
    if abs(one) < NOTHING or abs(other) < NOTHING:
        return abs(one) < 2 * NOTHING and abs(other) < 2 * NOTHING
    return sound(one / other)
