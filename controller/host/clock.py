"""Regression of the device's tick on the host's clock, from round trips of the heartbeat.

The device stamps a LEASE at some time between its departure at host time a and the arrival of the answer at b: at the
middle, with an error of at most half the round trip. Queueing only ever lengthens a trip, so the quicker half of the
last trips is used (as in NTP), and a line is fitted with Huber weights against outliers.
"""

from collections import deque
from dataclasses import dataclass

import numpy as np

WINDOW = 64  # trips: 6 s at rest, 3 s armed
LEAST_TRIPS = 8  # to estimate a drift; with fewer trips the drift is taken as 0
LEAST_SPAN_S = 0.5
HUBER = 1.5
PASSES = 5


@dataclass(frozen=True, slots=True)
class ClockFit:
    """device time = tick * dt = (1 + drift) * (host time - origin) + offset.

    Attributes
    ----------
    error_s : bound on the error at the newest trip: half the quickest round trip, plus half a tick, plus two standard
        errors of the line there.
    """

    dt_s: float
    origin_s: float
    offset_s: float
    drift: float
    error_s: float

    def host_s(self, tick: float) -> float:
        """Host time of a tick."""
        return self.origin_s + (tick * self.dt_s - self.offset_s) / (1.0 + self.drift)

    def tick(self, host_s: float) -> float:
        """Tick, with its fraction, at a host time."""
        return ((1.0 + self.drift) * (host_s - self.origin_s) + self.offset_s) / self.dt_s


class ClockRegression:
    """Collects round trips; `fit` gives the line through the last `WINDOW` of them, None before the first."""

    def __init__(self, dt_s: float) -> None:
        self._dt_s = dt_s
        self._trips: deque[tuple[float, float, int]] = deque(maxlen=WINDOW)

    def add(self, sent_s: float, received_s: float, tick: int) -> None:
        """One heartbeat: when it left, when its answer came, and the tick that the device stamped it with."""
        self._trips.append((sent_s, received_s, tick))

    def fit(self) -> ClockFit | None:
        if not self._trips:
            return None
        sent, received, ticks = (np.array(column, dtype=float) for column in zip(*self._trips, strict=True))
        trip = received - sent
        quick = trip <= np.median(trip)
        # A stamp counts whole ticks, so on average half a tick has passed since.
        host, device = ((sent + received) / 2)[quick], (ticks[quick] + 0.5) * self._dt_s
        origin = float(host[-1])
        x, y = host - origin, device - (host - origin)
        resolution = self._dt_s / 2 + float(trip.min()) / 2
        if host.size < LEAST_TRIPS or np.ptp(x) < LEAST_SPAN_S:
            offset = float(np.median(y))
            return ClockFit(self._dt_s, origin, offset, 0.0, resolution + float(np.max(np.abs(y - offset))))
        weight = np.ones_like(x)
        columns = np.stack([np.ones_like(x), x], axis=1)
        for _ in range(PASSES):
            normal = columns.T @ (weight[:, None] * columns)
            line = np.linalg.solve(normal, columns.T @ (weight * y))
            off = np.abs(y - columns @ line)
            scale = max(1.4826 * float(np.median(off)), self._dt_s / 4)
            weight = np.minimum(1.0, HUBER * scale / np.maximum(off, 1e-12))
        spread = scale * float(np.sqrt(np.linalg.inv(normal)[0, 0]))
        return ClockFit(self._dt_s, origin, float(line[0]), float(line[1]), resolution + 2 * spread)
