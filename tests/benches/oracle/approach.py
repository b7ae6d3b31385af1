"""How fast the stylus comes in and when it will touch, from encoder counts: oracle of td_approach.c.

A parabola is fitted by least squares to the last readings, or to their newer half where the motion bends; what was
measured stands in td_approach.h. The sums are of integers, so a sliding update is exact.
"""

import math
from enum import IntEnum

NEVER = -1e9  # phase of a stylus that does not come in
LEAST_READINGS = 4  # that a parabola is fitted to
BEND_COUNTS = 0.6  # of a cubic in the readings: twice what rounding makes of it (1 / sqrt(12) each reading)
STEADY_BEND_COUNTS = 2.0  # the same at a steady speed, where that may be a slow sawtooth


class Approach:
    """Sliding parabola through encoder counts, over the whole window or, where the motion bends, over half of it.

    Attributes
    ----------
    speed_m_s : -dz/dt `lead` after the newest reading, positive coming in.
    phase : ticks by which the newest reading lies after the instant at which c_0 is due; NEVER if it never is.
    """

    def __init__(
        self,
        dt_s: float,
        lead_s: float,
        *,
        count_m: float,
        surface_counts: float,
        window_ticks: int,
        least_speed_m_s: float,
    ) -> None:
        ahead = lead_s / dt_s
        self._window, self._half = window_ticks, window_ticks // 2
        # Rows that fit the whole window, and its newer half if that holds readings enough.
        self._whole_rows = fit_rows(window_ticks, ahead)
        self._half_rows = fit_rows(self._half, ahead) if self._half >= LEAST_READINGS else self._whole_rows
        self._bend = bend_row(window_ticks) if self._half >= LEAST_READINGS else [0.0] * 4
        self._m_s = count_m / dt_s
        self._surface_counts, self._least_speed_m_s = surface_counts, least_speed_m_s
        self._counts = [0] * window_ticks
        self.restart()

    def restart(self) -> None:
        """Forget all readings: what comes next has nothing to do with them."""
        self._read = self._next = self._origin = 0
        self._sum0 = self._sum1 = self._sum2 = self._sum3 = 0
        self._new0 = self._new1 = self._new2 = 0
        self.speed_m_s, self.phase = 0.0, NEVER

    def step(self, counts: int) -> None:
        """One tick's reading."""
        W, H = self._window, self._half
        if self._read == 0:
            self._origin = counts
        # Relative to the first reading, so that far from zero the sums stay small.
        newest = counts - self._origin
        oldest = self._counts[self._next] if self._read >= W else 0
        middle = self._counts[self._next - H if self._next >= H else self._next - H + W] if self._read >= H else 0
        # Every reading ages by one tick; the oldest leaves at age W, and the newer half at age H.
        self._sum3 += 3 * self._sum2 + 3 * self._sum1 + self._sum0 - W * W * W * oldest
        self._sum2 += 2 * self._sum1 + self._sum0 - W * W * oldest
        self._sum1 += self._sum0 - W * oldest
        self._sum0 += newest - oldest
        self._new2 += 2 * self._new1 + self._new0 - H * H * middle
        self._new1 += self._new0 - H * middle
        self._new0 += newest - middle
        self._counts[self._next] = newest
        self._next = self._next + 1 if self._next + 1 < W else 0
        if self._read < W:
            self._read += 1
            if self._read < W:
                return
        b = self._bend
        bend = b[0] * self._sum0 + b[1] * self._sum1 + b[2] * self._sum2 + b[3] * self._sum3
        now, before = newest - middle, middle - oldest
        most = BEND_COUNTS if abs(now - before) * 8 > abs(now) + 16 else STEADY_BEND_COUNTS
        if -most <= bend <= most:
            (value, slope), s0, s1, s2 = self._whole_rows, self._sum0, self._sum1, self._sum2
        else:
            (value, slope), s0, s1, s2 = self._half_rows, self._new0, self._new1, self._new2
        ahead = value[0] * s0 + value[1] * s1 + value[2] * s2
        rate = slope[0] * s0 + slope[1] * s1 + slope[2] * s2
        self.speed_m_s = -rate * self._m_s
        # Contact is where the tangent at `ahead` crosses the surface; within a few ticks the curvature is nothing.
        if self.speed_m_s >= self._least_speed_m_s:
            self.phase = (ahead + (self._origin - self._surface_counts)) / rate
        else:
            self.phase = NEVER


class Touch(IntEnum):
    """What one tick means for the surface."""

    NOTHING = 0
    CONTACT = 1
    CHATTER = 2


class Trigger:
    """When a transient may start.

    A contact is due as soon as c_0 falls into the tick to come (phase > -1). It is a CONTACT if the stylus has been
    above `rearm_height_m` for `rearm_ticks` since the last, else CHATTER; neither is said twice before the stylus
    has left the surface. Creeping onto the surface more slowly than the least speed counts as touching it; so far as
    a reading can tell, which a coarse encoder rounds down to half a count below the surface before the tap is due.
    """

    def __init__(self, count_m: float, touch_height_m: float, rearm_height_m: float, rearm_ticks: int) -> None:
        self._below_m = -0.5 * count_m
        self._touch_height_m, self._rearm_height_m, self._rearm_ticks = touch_height_m, rearm_height_m, rearm_ticks
        self.restart()

    def restart(self) -> None:
        self._above, self._ready, self._touching = 0, False, True
        # Armed too late for a contact that is already on its way: that is told too.
        self._fresh, self._was_above = True, False

    def step(self, z_m: float, speed_m_s: float, phase: float) -> Touch:
        if z_m > self._rearm_height_m:
            self._above += 1
            if self._above >= self._rearm_ticks:
                self._ready = True
        else:
            self._above = 0
        if self._fresh and self._touching:
            if z_m >= 0.0:
                self._was_above = True
            elif self._was_above:
                self._fresh = False
                return Touch.CHATTER
        if self._touching:
            # While it comes in, a fast stylus is above the touch height when its contact is already due.
            if z_m > self._touch_height_m and (speed_m_s <= 0.0 or self._ready):
                self._touching = self._fresh = False
            return Touch.NOTHING
        due = phase > -1.0
        if not due and z_m >= self._below_m:
            return Touch.NOTHING
        ready = self._ready
        self._touching, self._ready, self._above = True, False, 0
        if not due:
            return Touch.NOTHING
        return Touch.CONTACT if ready else Touch.CHATTER


# Worked out in the order of operations that the C core has too.
def fit_rows(window_ticks: int, ahead_ticks: float) -> tuple[list[float], list[float]]:
    """What the fit through the readings of the ages 0 to window - 1 [ticks] gives, ahead of the newest.

    The normal equations of c_0 - c_1 age + c_2 age^2 are solved by the adjugate of their matrix.

    Returns
    -------
    value, slope : (3,) weights of sum counts, sum counts * age, sum counts * age^2 for the value and for the slope
        per tick, `ahead_ticks` after the newest reading.
    """
    s = [0.0] * 5
    for age in range(window_ticks):
        power = 1.0
        for j in range(5):
            s[j] += power
            power *= age
    c00, c01, c02 = s[2] * s[4] - s[3] * s[3], s[2] * s[3] - s[1] * s[4], s[1] * s[3] - s[2] * s[2]
    c11, c12, c22 = s[0] * s[4] - s[2] * s[2], s[1] * s[2] - s[0] * s[3], s[0] * s[2] - s[1] * s[1]
    rows = ((c00, c01, c02), (c01, c11, c12), (c02, c12, c22))
    determinant = s[0] * c00 + s[1] * c01 + s[2] * c02
    ahead = ahead_ticks
    value = [(rows[0][j] - ahead * rows[1][j] + ahead * ahead * rows[2][j]) / determinant for j in range(3)]
    slope = [(2 * ahead * rows[2][j] - rows[1][j]) / determinant for j in range(3)]
    return value, slope


def bend_row(window_ticks: int) -> list[float]:
    """(4,) weights of the sums of counts times age^0 to age^3: how much of a cubic is in the readings, in counts.

    The cubic that is orthogonal to every parabola over n ages is P(u) = u^3 - u (3 n^2 - 7) / 20 about their middle,
    with sum P^2 = n (n^2 - 1) (n^2 - 4) (n^2 - 9) / 2800 (Gram's polynomials). The answer is sum y P / sqrt(sum P^2):
    readings that differ from a parabola by independent errors of one size have that size there.
    """
    n = float(window_ticks)
    middle = (n - 1) / 2
    g = (3 * n * n - 7) / 20
    size = math.sqrt(n * (n * n - 1) * (n * n - 4) * (n * n - 9) / 2800)
    return [
        (g * middle - middle * middle * middle) / size,
        (3 * middle * middle - g) / size,
        -3 * middle / size,
        1 / size,
    ]
