"""Encoder, accelerometer and current held against each other, tick by tick.

A stylus that moves, by its accelerometer, while its encoder stands still has a stuck encoder; one that current shakes
while its accelerometer is silent has a dead accelerometer. Neither is seen by any of the sensors alone.
"""

from controller.servo.rules import (
    ABSURD_M_S2,
    DEAD_M_S2,
    FOLLOW_FAR_M,
    FOLLOW_PART,
    FOLLOW_RATE_1_S,
    FOLLOW_STILL_S,
    QUIET_BLOCK_S,
    QUIET_BLOCKS,
    QUIET_M_S2,
    QUIET_PUSH_M_S2,
    QUIET_SWING_A,
    STUCK_COUNTS,
    STUCK_HELD,
    STUCK_LEAST_M,
)
from controller.servo.settings import Settings


class Crosscheck:
    """What the sensors say of each other.

    Attributes
    ----------
    path_m : by the accelerometer, since the encoder last moved.
    stuck : while a current flows that path is longer than an encoder can sleep through.
    quiet : the accelerometer was silent while current shook the stylus.
    """

    def __init__(self, s: Settings) -> None:
        self._dt_s, self._count_m, self._stuck_A = s.dt_s, s.count_m, s.stuck_A
        self._stuck_m, self._swing_A = float("inf"), float("inf")
        # An excitation may be played on a rotor that is blocked on purpose.
        if s.has_accelerometer and not s.host_starts:
            self._stuck_m = max(STUCK_COUNTS * s.count_m, STUCK_LEAST_M)
            push = min(s.pulse_acceleration, default=QUIET_PUSH_M_S2 / QUIET_SWING_A)
            self._swing_A = max(QUIET_SWING_A, QUIET_PUSH_M_S2 / push)
        self._still_limit, self._block_ticks = s.ticks(FOLLOW_STILL_S), s.ticks(QUIET_BLOCK_S)
        self.path_m = self._ahead_m = self._speed_m_s = self._offset_m_s2 = 0.0
        self._still_ticks = 0
        self.forget()

    def forget(self) -> None:
        """Begin another window of the accelerometer's silence."""
        self.quiet = self.stuck = False
        # Each block: sum and sum of squares of the acceleration, least and largest current.
        self._blocks = [(0.0, 0.0, 0.0, 0.0)] * QUIET_BLOCKS
        self._at = self._ticks = self._whole = 0
        self._middle_m_s2 = 0.0

    def step(self, moved: int, acceleration_m_s2: float, current_A: float, playing: bool) -> None:
        """One tick: counts by which the encoder moved, acceleration, current, whether a transient plays."""
        # Written so that NaN is absurd.
        sound = -ABSURD_M_S2 <= acceleration_m_s2 <= ABSURD_M_S2
        acceleration = acceleration_m_s2 if sound else 0.0
        self._follow(moved, acceleration)
        if playing or abs(current_A) >= self._stuck_A:
            self._listen(acceleration, current_A, playing)
            # A dead accelerometer takes the end of a motion for its going on.
            least_m = (1.0 if playing else STUCK_HELD) * self._stuck_m
            self.stuck = abs(self.path_m) >= least_m and self._heard() >= DEAD_M_S2 * DEAD_M_S2
        elif self._whole or self._ticks:
            self.forget()

    def _follow(self, moved: int, acceleration_m_s2: float) -> None:
        self._speed_m_s += self._dt_s * (acceleration_m_s2 - self._offset_m_s2)
        step_m = self._dt_s * self._speed_m_s
        self._ahead_m += step_m
        self.path_m += step_m
        self._still_ticks += 1
        if moved == 0:
            if self._still_ticks >= self._still_limit:
                # At rest: what is read on average is the offset.
                self._offset_m_s2 += self._speed_m_s / (self._still_ticks * self._dt_s)
                self._rest()
            return
        self._ahead_m -= moved * self._count_m
        if not -FOLLOW_FAR_M <= self._ahead_m <= FOLLOW_FAR_M:
            self._offset_m_s2 = 0.0
            self._rest()
            return
        since_s, ahead_m = self._still_ticks * self._dt_s, self._ahead_m
        r = min(FOLLOW_RATE_1_S, FOLLOW_PART / since_s)
        self._speed_m_s -= 3.0 * r * r * since_s * ahead_m
        self._offset_m_s2 += r * r * r * since_s * ahead_m
        self._ahead_m -= min(3.0 * r * since_s, 1.0) * ahead_m
        self.path_m, self._still_ticks = 0.0, 0

    def _rest(self) -> None:
        self.path_m = self._ahead_m = self._speed_m_s = 0.0
        self._still_ticks = 0

    def _listen(self, acceleration_m_s2: float, current_A: float, playing: bool) -> None:
        if self._ticks == 0 and self._whole == 0 and self._at == 0:
            # About the first reading, so that squares of a large offset do not hide a small motion.
            self._middle_m_s2 = acceleration_m_s2
        a = acceleration_m_s2 - self._middle_m_s2
        total, square, low_A, high_A = self._blocks[self._at]
        if self._ticks == 0:
            total, square, low_A, high_A = 0.0, 0.0, current_A, current_A
        self._blocks[self._at] = (total + a, square + a * a, min(low_A, current_A), max(high_A, current_A))
        self._ticks += 1
        if self._ticks < self._block_ticks:
            return
        self._ticks = 0
        self._at = self._at + 1 if self._at + 1 < QUIET_BLOCKS else 0
        self._whole = min(self._whole + 1, QUIET_BLOCKS)
        if self._whole == QUIET_BLOCKS:
            self._judge(playing)

    def _judge(self, playing: bool) -> None:
        # The answer to what the current did in the newest block is still to come.
        newest = (self._at if self._at > 0 else QUIET_BLOCKS) - 1
        low_A, high_A = self._blocks[self._at][2:]
        for j, (_, _, low, high) in enumerate(self._blocks):
            if j != newest:
                low_A, high_A = min(low_A, low), max(high_A, high)
        silent = self._heard() < QUIET_M_S2 * QUIET_M_S2
        self.quiet = playing and silent and high_A - low_A >= self._swing_A

    def _heard(self) -> float:
        """Variance of the acceleration within the window, as far as it has come."""
        total = square = 0.0
        for one, of_squares, _, _ in self._blocks[: max(self._whole, self._at + 1)]:
            total, square = total + one, square + of_squares
        readings = min(self._whole, QUIET_BLOCKS) * self._block_ticks
        if self._ticks:
            # The block under way has taken the place of the oldest.
            readings += self._ticks - (self._block_ticks if self._whole == QUIET_BLOCKS else 0)
        mean = total / readings
        return square / readings - mean * mean
