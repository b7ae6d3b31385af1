"""One recorded contact, as it came from the file."""

from dataclasses import dataclass

from transopt.base.errors import InputError
from transopt.base.shown import brief
from transopt.base.signals import Signal


@dataclass(frozen=True)
class Recording:
    """Acceleration of one tap over time, and what else was recorded with it.

    Signs and units as recorded, converted to SI; offset, polarity and onset are found in `reference`.

    Attributes
    ----------
    name : what messages and reports call it, usually the file name.
    source : where it comes from: a path, or a sentence for a simulated one.
    sha256 : of the file's bytes, empty for a simulated one.
    acceleration : [m/s^2].
    position : along the surface normal, positive out of the object [m].
    force : surface force [N].
    current : motor current [A].
    speed_m_s : incoming speed if the recording states it, > 0.
    grip_N : grip force if the recording states it, >= 0.
    """

    name: str
    source: str
    sha256: str
    acceleration: Signal
    position: Signal | None = None
    force: Signal | None = None
    current: Signal | None = None
    speed_m_s: float | None = None
    grip_N: float | None = None

    __repr__ = brief

    def __post_init__(self) -> None:
        if self.speed_m_s is not None and not 1e-4 <= self.speed_m_s <= 100:
            raise InputError(f"{self.name}: speed_m_s = {self.speed_m_s:g} m/s: must be between 1e-4 and 100 m/s")
        if self.grip_N is not None and not 0 <= self.grip_N < float("inf"):
            raise InputError(f"{self.name}: grip_N = {self.grip_N:g} N: must be >= 0 and finite")
