"""The time axis of a transient: servo ticks, switching instants, lost samples before them and the tail after them."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from transopt.base.errors import InputError
from transopt.base.signals import FloatArray

DELAY_ROUNDING = 1e-6  # tolerance in servo periods within which a delay counts as a whole number of them


def samples_after(after_s: float, dt_s: float) -> int:
    """M, the duration of the tail after the window in servo periods, rounded."""
    return round(after_s / dt_s)


@dataclass(frozen=True)
class TimeGrid:
    """Servo ticks t_k = -lead + k dt and switching instants tau_k = t_k + delay, k = 0..N-1, contact at t = 0.

    From tau_N on the command is zero, or a wall's feedback. The motion at M further instants, the tail, counts too.

    Attributes
    ----------
    dt_s : servo period, > 0.
    stages : N, number of commands, >= 1.
    lead_s : time by which the first command precedes contact, >= 0.
    delay_s : delay of the amplifier, >= 0.
    after_stages : M, number of instants in the tail, >= 0.

    Raises
    ------
    InputError : one of them is out of its range.
    """

    dt_s: float
    stages: int
    lead_s: float
    delay_s: float
    after_stages: int = 0

    def __post_init__(self) -> None:
        if not 0 < self.dt_s < np.inf:
            raise InputError(f"time.dt_s = {self.dt_s:g}: must be > 0 and finite")
        if self.stages < 1:
            raise InputError(f"time.stages = {self.stages}: must be at least 1")
        if self.after_stages < 0:
            raise InputError(f"weights.after_s: {self.after_stages} samples after the window: must be at least 0")
        for name in ("lead_s", "delay_s"):
            if not 0 <= getattr(self, name) < np.inf:
                raise InputError(f"time.{name} = {getattr(self, name):g}: must be >= 0 and finite")

    @cached_property
    def issue_times_s(self) -> FloatArray:
        """(N,) ticks t_k at which command c_k is issued."""
        return _constant(-self.lead_s + self.dt_s * np.arange(self.stages))

    @cached_property
    def switching_times_s(self) -> FloatArray:
        """(N,) switching instants tau_k, from which c_k acts; predictions and reference are sampled there."""
        return _constant(self.issue_times_s + self.delay_s)

    @property
    def end_s(self) -> float:
        """tau_N, the end of the last command [s]."""
        return -self.lead_s + self.dt_s * self.stages + self.delay_s

    @cached_property
    def before_times_s(self) -> FloatArray:
        """(L,) instants tau_0 - j dt >= 0 of the lost samples, increasing: after contact, before any command acts.

        L = floor((delay - lead) / dt), zero if the lead covers the delay; contact itself is included.
        """
        lost = max(int(np.floor((self.delay_s - self.lead_s) / self.dt_s + DELAY_ROUNDING)), 0)
        return _constant(self.delay_s - self.lead_s - self.dt_s * np.arange(lost, 0, -1))

    @cached_property
    def after_times_s(self) -> FloatArray:
        """(M,) instants tau_N to tau_(N+M-1) of the tail."""
        return _constant(self.end_s + self.dt_s * np.arange(self.after_stages))

    @cached_property
    def all_issue_times_s(self) -> FloatArray:
        """(N + M,) ticks t_0 to t_(N+M-1): a wall reads the encoder after the waveform too."""
        ticks = np.arange(self.stages + self.after_stages)
        return _constant(-self.lead_s + self.dt_s * ticks)


def _constant(times_s: NDArray[np.floating]) -> FloatArray:
    """Read-only times, as they are cached and shared."""
    times = np.asarray(times_s, dtype=float)
    times.flags.writeable = False
    return times
