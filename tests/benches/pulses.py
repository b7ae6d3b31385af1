"""A recorded tap of a simple shape."""

import numpy as np

from transopt.base.signals import Signal
from transopt.recordings.recording import Recording


def pulse(
    onset_s: float = 0.02,
    *,
    rate_Hz: float = 10e3,
    height: float = 50.0,
    offset: float = 0.0,
    polarity: int = 1,
    speed: float | None = 0.2,
    position: Signal | None = None,
    duration_s: float = 0.08,
    name: str = "tap",
) -> Recording:
    """A linear rise of 1 ms, then an exponential decay."""
    t = np.arange(0, duration_s, 1 / rate_Hz)
    since = t - onset_s
    shape = np.where(since < 1e-3, np.clip(since, 0, None) / 1e-3, np.exp(-(since - 1e-3) / 2e-3))
    return Recording(
        name=name,
        source="test",
        sha256="",
        acceleration=Signal(0.0, 1 / rate_Hz, polarity * height * shape + offset),
        position=position,
        speed_m_s=speed,
    )
