"""How fast the stylus comes in and when it will touch, from encoder counts.

A parabola is fitted by least squares to the last readings and evaluated `lead` ahead of the newest, which is where
the contact lies when the waveform has to start. A line would have to be short, since a hand that accelerates at
2 m/s^2 biases its slope. Rms errors of the speed and of the contact time over simulated taps at 0.1 m/s:

                    line 3 ms       line 5 ms       parabola 6 ms   parabola 10 ms
    steady          0.6 %, 11 us    0.2 %,  7 us    1.0 %, 16 us    0.3 %,  7 us
    2 m/s^2         3.6 %, 27 us    5.6 %, 56 us    1.1 %, 16 us    0.6 %, 12 us

At 0.05 m/s the parabola over 10 ms (2 m/s^2) gives 1.2 %, 25 us; at 0.4 m/s 0.15 %, 2.6 us; at 1 m/s 0.12 %, 1.9 us.
Longer windows would ask for more than 10 ms of undisturbed approach. The sums are of integers, so a sliding update
is exact and costs the same for every window.
"""

from enum import IntEnum

from controller.servo.parabola import fit_rows

NEVER = -1e9  # phase of a stylus that does not come in


class Approach:
    """Sliding parabola through encoder counts.

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
        self._value, self._slope = fit_rows(window_ticks, lead_s / dt_s)
        self._m_s = count_m / dt_s
        self._surface_counts, self._least_speed_m_s = surface_counts, least_speed_m_s
        self._window = window_ticks
        self._counts = [0] * window_ticks
        self.restart()

    def restart(self) -> None:
        """Forget all readings: what comes next has nothing to do with them."""
        self._read = self._next = self._origin = 0
        self._sum0 = self._sum1 = self._sum2 = 0
        self.speed_m_s, self.phase = 0.0, NEVER

    def step(self, counts: int) -> None:
        """One tick's reading."""
        W = self._window
        if self._read == 0:
            self._origin = counts
        # Relative to the first reading, so that far from zero the sums stay small.
        newest = counts - self._origin
        oldest = self._counts[self._next] if self._read >= W else 0
        # Every reading ages by one tick; the oldest leaves at age W.
        self._sum2 += 2 * self._sum1 + self._sum0 - W * W * oldest
        self._sum1 += self._sum0 - W * oldest
        self._sum0 += newest - oldest
        self._counts[self._next] = newest
        self._next = self._next + 1 if self._next + 1 < W else 0
        if self._read < W:
            self._read += 1
            if self._read < W:
                return
        value, slope = self._value, self._slope
        ahead = value[0] * self._sum0 + value[1] * self._sum1 + value[2] * self._sum2
        rate = slope[0] * self._sum0 + slope[1] * self._sum1 + slope[2] * self._sum2
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
    has left the surface. Creeping onto the surface more slowly than the least speed counts as touching it.
    """

    def __init__(self, touch_height_m: float, rearm_height_m: float, rearm_ticks: int) -> None:
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
        if not due and z_m >= 0.0:
            return Touch.NOTHING
        ready = self._ready
        self._touching, self._ready, self._above = True, False, 0
        if not due:
            return Touch.NOTHING
        return Touch.CONTACT if ready else Touch.CHATTER
