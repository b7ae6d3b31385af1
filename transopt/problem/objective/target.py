"""What the stylus shall do: within the window, before any command can act, and after the last one."""

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from transopt.base.shown import brief
from transopt.base.signals import FloatArray

ZERO_M_S2 = 1e-3  # a tap with a smaller rms is zero
LARGEST_M_S2 = 1e100  # whose square and all that is made of it double precision can hold


def _none() -> FloatArray:
    return np.zeros(0)


@dataclass(frozen=True)
class Target:
    """What is asked of y'', the acceleration that the current adds: the recorded tap r less a_free.

    Nothing of a tap is dropped. What happens before tau_0 no command can reach: the device does not move, and all of
    it is error. What happens after tau_N follows from the state there.

    Of a plant with several directions every array is (p, N) in place of (N,), the normal of the surface first.

    Attributes
    ----------
    window_m_s2 : (N,) r - a_free at the switching instants tau_0 to tau_(N-1).
    after_m_s2 : (M,) at tau_N to tau_(N+M-1).
    before_m_s2 : (L,) at the instants from contact on that come before tau_0.
    free_window_m_s2, free_after_m_s2, free_before_m_s2 : a_free at the same instants, how the stylus accelerates
        without current; of no element where it does not.
    """

    window_m_s2: FloatArray
    after_m_s2: FloatArray = field(default_factory=_none)
    before_m_s2: FloatArray = field(default_factory=_none)
    free_window_m_s2: FloatArray = field(default_factory=_none)
    free_after_m_s2: FloatArray = field(default_factory=_none)
    free_before_m_s2: FloatArray = field(default_factory=_none)

    __repr__ = brief

    @cached_property
    def whole_m_s2(self) -> FloatArray:
        """(L + N + M,) r - a_free from contact, or from tau_0 where that comes first, to the end of the tail."""
        return np.concatenate([self.before_m_s2, self.window_m_s2, self.after_m_s2], axis=-1)

    @cached_property
    def free_m_s2(self) -> FloatArray:
        """(L + N + M,) a_free there."""
        parts = (
            (self.free_before_m_s2, self.before_m_s2),
            (self.free_window_m_s2, self.window_m_s2),
            (self.free_after_m_s2, self.after_m_s2),
        )
        return np.concatenate([free if free.size else np.zeros_like(asked) for free, asked in parts], axis=-1)

    @cached_property
    def normal(self) -> "Target":
        """The first direction alone, by which figures are told."""
        if self.window_m_s2.ndim == 1:
            return self
        free = self.lost, self.lost + self.window_m_s2.shape[-1]
        return Target(
            *(each[0] for each in (self.window_m_s2, self.after_m_s2, self.before_m_s2)),
            *(np.split(self.free_m_s2[0], free)[part] for part in (1, 2, 0)),
        )

    def along_normal(self, directions: int) -> "Target":
        """One course as the target along the normal, the first of p directions; along the others it is zero."""

        def first(course: FloatArray) -> FloatArray:
            others = np.zeros((directions - 1, course.size))
            return np.concatenate([course[None], others]) if course.ndim == 1 else course

        courses = (self.window_m_s2, self.after_m_s2, self.before_m_s2)
        frees = (self.free_window_m_s2, self.free_after_m_s2, self.free_before_m_s2)
        return Target(*map(first, courses), *(map(first, frees) if self.free_window_m_s2.size else frees))

    @property
    def lost(self) -> int:
        """L, samples of the tap that no command can reach."""
        return int(self.before_m_s2.shape[-1])

    @cached_property
    def flaw(self) -> str:
        """What makes it no target, in words: a number that is not finite, or one whose square overflows; or empty."""
        named = {"window": self.window_m_s2, "after": self.after_m_s2, "before": self.before_m_s2}
        for name, array in named.items():
            said = "reference_m_s2" if name == "window" else f"reference_{name}_m_s2"
            if not np.isfinite(array).all():
                return f"{said} holds a number that is not finite"
            largest = float(np.abs(array).max(initial=0.0))
            if largest > LARGEST_M_S2:
                return (
                    f"{said} reaches {largest:g} m/s^2: must stay below {LARGEST_M_S2:g}, where squares overflow; "
                    "check its unit"
                )
        return ""

    @property
    def lost_share(self) -> float:
        """Share of the energy of the target up to the window's end that no command can reach; 0 of a tap of zero."""
        lost = float(np.vdot(self.before_m_s2, self.before_m_s2))
        return 0.0 if self.is_zero else lost / (lost + float(np.vdot(self.window_m_s2, self.window_m_s2)))

    @cached_property
    def is_zero(self) -> bool:
        """Whether there is no tap at all."""
        asked = np.append(self.before_m_s2, self.window_m_s2)
        return float(asked @ asked) < ZERO_M_S2**2 * asked.size

    @cached_property
    def asks_for_nothing(self) -> bool:
        """Whether there is nothing left of the tap in the window: the answer is the zero waveform."""
        r = self.window_m_s2
        return self.is_zero or float(np.vdot(r, r)) < ZERO_M_S2**2 * r.size

    @cached_property
    def recorded_m_s2(self) -> FloatArray:
        """(L + N + M,) r there, the whole acceleration that the stylus shall have."""
        return np.asarray(self.whole_m_s2 + self.free_m_s2)

    def of_window(self, whole: FloatArray) -> FloatArray:
        """(N,) the samples of the window among (L + N + M,)."""
        return whole[..., self.lost : self.lost + self.window_m_s2.shape[-1]]

    def lasting(self, whole: FloatArray) -> FloatArray:
        """(N + M,) the samples from tau_0 on among (L + N + M,)."""
        return whole[..., self.lost :]

    def moved(self, by_m_s2: FloatArray) -> "Target":
        """Add (N,) to the window: what a device has to be asked for so that it makes r."""
        return replace(self, window_m_s2=self.window_m_s2 + by_m_s2)

    def extended(self) -> "Target":
        """Target in extended precision, where the machine has one."""

        def wide(values: FloatArray) -> FloatArray:
            return values.astype(np.longdouble)

        return replace(
            self,
            window_m_s2=wide(self.window_m_s2),
            after_m_s2=wide(self.after_m_s2),
            before_m_s2=wide(self.before_m_s2),
        )

    @cached_property
    def continued_m_s2(self) -> FloatArray:
        """(N + M,) r - a_free in the window and after it."""
        return np.concatenate([self.window_m_s2, self.after_m_s2], axis=-1)
