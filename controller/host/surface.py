"""Find the surface in counts of the encoder: measure it once by touching, and follow its drift.

An incremental encoder starts at an arbitrary count, slips at its coupling and drifts with temperature. An error of
one count of 24.5 um shifts the contact by 0.1 ms at 0.25 m/s.

Rule for the drift: after a tap the stylus often comes to rest on the surface. So the first rest after each contact is
evaluated: 0.2 s within a band of 2 counts (50 um for a fine encoder) and within 0.5 mm of the surface. Three such
rests in a row on the same side of the surface, each farther off than the band, are not by chance: the surface is
moved by their median. A rest within the band or on the other side restarts the row, and so does a move. A hand's
tremor exceeds the band, so a stylus held in the air does not count as at rest. A hand that leans on a virtual wall
rests where the wall balances its force, at F / K_p below the surface: no reading with a feedback current counts, and
the surface is not moved while one flows.
"""

from collections import deque
from statistics import median

from controller.protocol.events import Happened, News, Samples
from controller.servo.interface import Notice

REST_S, REST_COUNTS, REST_M, NEAR_M = 0.2, 2, 50e-6, 0.5e-3
IN_A_ROW = 3
TOUCH_LOOK_S = 5e-3  # period of the records in which touches are sought: a line of 115 200 baud carries them
AWAY_M = 1e-3  # least distance from the surface between two touches


def band_counts(count_m: float) -> float:
    """Band in counts: readings within it are a rest, and a rest within it of the surface is no drift."""
    return max(REST_COUNTS, REST_M / count_m)


class Rest:
    """Detects a rest: all readings of the last `REST_S` within the band, and no feedback current in any of them.

    Attributes
    ----------
    leans : whether a feedback current flowed in the newest reading.
    """

    def __init__(self, dt_s: float, count_m: float) -> None:
        self._every, self._counts = 1, deque[int](maxlen=max(round(REST_S / dt_s), 1))
        self.leans = False
        self._dt_s, self.band = dt_s, band_counts(count_m)

    def take(self, samples: Samples) -> None:
        if samples.every != self._every or samples.missed:
            self._every = samples.every
            self._counts = deque(maxlen=max(round(REST_S / (samples.every * self._dt_s)), 1))
        for record in samples.records:
            self.leans = record.feedback_A != 0
            if self.leans:
                self._counts.clear()
            else:
                self._counts.append(record.encoder_counts)

    def forget(self) -> None:
        self._counts.clear()

    @property
    def counts(self) -> float | None:
        """Median counts of the rest; None while the stylus moves."""
        full = len(self._counts) == self._counts.maxlen
        if not full or max(self._counts) - min(self._counts) > self.band:
            return None
        return float(median(self._counts))


class Drift:
    """A listener of `driver.Device` that evaluates the rests between taps.

    Attributes
    ----------
    surface_counts : the surface in use.
    moved : counts by which the surface must be moved; 0 if it need not, or as long as a feedback current flows. The
        caller moves it and then calls `done`.
    """

    def __init__(self, dt_s: float, count_m: float, surface_counts: float) -> None:
        self._rest, self._near, self._band = Rest(dt_s, count_m), NEAR_M / count_m, band_counts(count_m)
        self.surface_counts, self._moved = surface_counts, 0.0
        self._offsets: list[float] = []
        self._looks = False  # whether the first rest after a contact is awaited

    def take(self, news: News) -> None:
        if isinstance(news, Happened) and news.what is Notice.CONTACT:
            self._looks = True
            self._rest.forget()
        elif isinstance(news, Samples):
            self._rest.take(news)
            if self._looks:
                self._look()

    @property
    def moved(self) -> float:
        return 0.0 if self._rest.leans else self._moved

    def _look(self) -> None:
        counts = self._rest.counts
        if counts is None or abs(counts - self.surface_counts) > self._near:
            return
        self._looks = False
        offset = counts - self.surface_counts
        if abs(offset) <= self._band or (self._offsets and offset * self._offsets[-1] < 0):
            self._offsets = []
        if abs(offset) > self._band:
            self._offsets.append(offset)
        if len(self._offsets) == IN_A_ROW:
            self._moved = float(median(self._offsets))

    def done(self, moved: float) -> None:
        """Confirm that the surface has been moved by so many counts."""
        self.surface_counts += moved
        self._moved, self._offsets = 0.0, []


class Touches:
    """A listener of `driver.Device` that collects the rests of a stylus that touches the surface repeatedly.

    The surface is the deepest place where the stylus rests: whoever pauses in the air between two touches rests too.

    Parameters
    ----------
    direction : the encoder's, where the device tells raw counts; 1 where it knows its encoder.

    Attributes
    ----------
    counts : counts of each rest, along the encoder's direction; between two rests the stylus left the place.
    """

    def __init__(self, dt_s: float, count_m: float, direction: int = 1) -> None:
        self._rest, self._away, self._direction = Rest(dt_s, count_m), AWAY_M / count_m, direction
        self.counts: list[float] = []
        self._left = True

    def take(self, news: News) -> None:
        if not isinstance(news, Samples):
            return
        self._rest.take(news)
        newest = self._direction * news.records[-1].encoder_counts
        if self.counts and not self._left:
            self._left = abs(newest - self.counts[-1]) >= self._away
        found = self._rest.counts if self._left else None
        if found is not None:
            self.counts.append(self._direction * found)
            self._left = False
            self._rest.forget()

    @property
    def _deepest(self) -> list[float]:
        """The newest `IN_A_ROW` of the last rests that none of them lies below; twice as many rests are looked at."""
        newest = self.counts[-2 * IN_A_ROW :]
        return [counts for counts in newest if counts < min(newest) + self._away][-IN_A_ROW:]

    @property
    def agree(self) -> bool:
        """Whether the newest `IN_A_ROW` touches agree within twice the band."""
        touches = self._deepest
        return len(touches) == IN_A_ROW and max(touches) - min(touches) <= 2 * self._rest.band

    @property
    def surface(self) -> float:
        """Median counts of the newest `IN_A_ROW` touches."""
        return float(median(self._deepest))
