"""The target acceleration of the stylus: in the window, before any command acts, and after the last one."""

from dataclasses import dataclass, field, fields, replace
from functools import cached_property

import numpy as np

from transopt.base.shown import brief
from transopt.base.signals import FloatArray, read_only

ZERO_M_S2 = 1e-3  # a tap with a smaller rms counts as zero
LARGEST_M_S2 = 1e100  # sums of squares of larger samples may overflow in double precision


def _none() -> FloatArray:
    return np.zeros(0)


def along_normal(courses: FloatArray, directions: int) -> FloatArray:
    """(..., p, N) courses (..., N) along the normal, the first of p directions; zero along the others."""
    found = np.zeros((*courses.shape[:-1], directions, courses.shape[-1]))
    found[..., 0, :] = courses
    return found


def normal(course: FloatArray) -> FloatArray:
    """(N,) course along the normal, of (N,) or of (p, N) in all directions."""
    return course[0] if course.ndim > 1 else course


@dataclass(frozen=True)
class Target:
    """The target of y'', the acceleration that the current adds: the recorded tap r minus a_free.

    The whole tap counts. The L samples before tau_0 are lost: no command acts yet, the device does not move, and the
    whole target there is error. The motion after tau_N follows from the state at tau_N.

    For a plant with p directions every array is (p, N) in place of (N,), the normal of the surface first.

    Attributes
    ----------
    window_m_s2 : (N,) r - a_free at the switching instants tau_0 to tau_(N-1).
    after_m_s2 : (M,) r - a_free in the tail, at tau_N to tau_(N+M-1).
    before_m_s2 : (L,) r - a_free at the instants from contact to tau_0.
    free_window_m_s2, free_after_m_s2, free_before_m_s2 : a_free, the stylus' acceleration without current, at the
        same instants; empty where it is zero.
    """

    window_m_s2: FloatArray
    after_m_s2: FloatArray = field(default_factory=_none)
    before_m_s2: FloatArray = field(default_factory=_none)
    free_window_m_s2: FloatArray = field(default_factory=_none)
    free_after_m_s2: FloatArray = field(default_factory=_none)
    free_before_m_s2: FloatArray = field(default_factory=_none)

    __repr__ = brief

    def __post_init__(self) -> None:
        for each in fields(self):
            vars(self)[each.name] = read_only(getattr(self, each.name))

    @classmethod
    def of_whole(cls, whole: FloatArray, free: FloatArray, lost: int, stages: int) -> "Target":
        """The target whose courses are parts of r - a_free and a_free, each (L + N + M,), with L `lost` samples."""
        # A part of what cannot be edited cannot be edited either.
        whole, free = read_only(whole), read_only(free)
        parts = (slice(lost, lost + stages), slice(lost + stages, None), slice(lost))
        found = cls(*(course[..., part] for course in (whole, free) for part in parts))
        vars(found).update(whole_m_s2=whole, free_m_s2=free)
        return found

    @cached_property
    def whole_m_s2(self) -> FloatArray:
        """(L + N + M,) r - a_free from contact or tau_0, whichever is earlier, to the end of the tail."""
        return np.concatenate([self.before_m_s2, self.window_m_s2, self.after_m_s2], axis=-1)

    @cached_property
    def free_m_s2(self) -> FloatArray:
        """(L + N + M,) a_free at the instants of `whole_m_s2`."""
        parts = (
            (self.free_before_m_s2, self.before_m_s2),
            (self.free_window_m_s2, self.window_m_s2),
            (self.free_after_m_s2, self.after_m_s2),
        )
        return np.concatenate([free if free.size else np.zeros_like(asked) for free, asked in parts], axis=-1)

    @property
    def normal(self) -> "Target":
        """The target along the normal alone, for which figures are computed."""
        # Not cached: a target that held itself would stay in memory until Python searches for garbage.
        return self if self.window_m_s2.ndim == 1 else self._of_normal

    @cached_property
    def _of_normal(self) -> "Target":
        return Target.of_whole(self.whole_m_s2[0], self.free_m_s2[0], self.lost, self.window_m_s2.shape[-1])

    def along_normal(self, directions: int) -> "Target":
        """The target for p directions: this one along the normal, the first direction, zero along the others."""
        if directions == 1 or self.window_m_s2.ndim > 1:
            return self
        courses = (self.window_m_s2, self.after_m_s2, self.before_m_s2)
        frees = (self.free_window_m_s2, self.free_after_m_s2, self.free_before_m_s2)
        moved = frees if self.free_window_m_s2.size else ()
        return Target(*(along_normal(each, directions) for each in (*courses, *moved)))

    @property
    def lost(self) -> int:
        """L, the number of samples of the tap before any command acts."""
        return int(self.before_m_s2.shape[-1])

    @cached_property
    def flaw(self) -> str:
        """Why the target is invalid, in words: a NaN, an infinite or a too large number; empty if it is valid."""
        if np.vdot(self.whole_m_s2, self.whole_m_s2) <= LARGEST_M_S2**2:  # false for NaN
            return ""
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
        """Energy of the lost samples over that of the target up to the window's end; 0 for a tap of zero."""
        lost = float(np.vdot(self.before_m_s2, self.before_m_s2))
        return 0.0 if self.is_zero else lost / (lost + float(np.vdot(self.window_m_s2, self.window_m_s2)))

    @cached_property
    def is_zero(self) -> bool:
        """Whether the tap up to the window's end counts as zero."""
        before, window = self.before_m_s2, self.window_m_s2
        return float(np.vdot(before, before) + np.vdot(window, window)) < ZERO_M_S2**2 * (before.size + window.size)

    @cached_property
    def asks_for_nothing(self) -> bool:
        """Whether the target is zero in the window, so that the optimum is the zero waveform."""
        r = self.window_m_s2
        return self.is_zero or float(np.vdot(r, r)) < ZERO_M_S2**2 * r.size

    @cached_property
    def recorded_m_s2(self) -> FloatArray:
        """(L + N + M,) r at the instants of `whole_m_s2`, the whole target acceleration of the stylus."""
        return np.asarray(self.whole_m_s2 + self.free_m_s2)

    def of_window(self, whole: FloatArray) -> FloatArray:
        """(N,) samples of the window among (L + N + M,)."""
        return whole[..., self.lost : self.lost + self.window_m_s2.shape[-1]]

    def lasting(self, whole: FloatArray) -> FloatArray:
        """(N + M,) samples from tau_0 on among (L + N + M,)."""
        return whole[..., self.lost :]

    def moved(self, by_m_s2: FloatArray) -> "Target":
        """The target with (N,) added in the window, to correct for a device that deviates from its model."""
        return replace(self, window_m_s2=self.window_m_s2 + by_m_s2)

    def extended(self) -> "Target":
        """The target in `np.longdouble`, which is extended precision where the machine has it."""

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
        """(N + M,) r - a_free in the window and in the tail."""
        return np.concatenate([self.window_m_s2, self.after_m_s2], axis=-1)
