"""What makes the servo give up, in one table."""

from collections.abc import Callable
from dataclasses import dataclass

from controller.servo.interface import Fault, Readings
from controller.servo.rules import FEWEST_TICKS, STUCK_TURNS, WRONG_CURRENT_A, WRONG_CURRENT_PART, WRONG_CURRENT_S
from controller.servo.settings import Settings
from tests.benches.oracle.crosscheck import Crosscheck
from tests.benches.oracle.guard import Guard


class Watch:
    """What the faults are judged by, brought up to date every tick.

    Nothing that is no number, or absurd, gets past this: `counts`, `grip_N` and `current_A` hold the last sound
    readings, the grip smoothed.

    Attributes
    ----------
    bad_encoder, bad_current : no number, or outside anything the device can give.
    raw_grip_N : as read. step_m_s : speed of the encoder over the last tick.
    expected_A : current that the amplifier model expects now, its whole ticks of delay included.
    missing_ticks : for so long far less current than expected was measured.
    low_counts : of the two neighbouring counts that the encoder is at.
    still_ticks, still_A_s : since the last count: ticks with current, impulse of the transient.
    turns, turn_ticks : back and forth between the two counts under current, and for so long.
    wrong, wrong_ticks : another current than expected was measured in the last tick, and for so long.
    crosscheck : what encoder, accelerometer and current say of each other.
    """

    def __init__(self, settings: Settings, guard: Guard | None) -> None:
        s = settings
        self.settings, self.guard = s, guard
        self.has_grip = s.assumed_grip_N is None
        self.grip_N = 0.0 if s.assumed_grip_N is None else s.assumed_grip_N
        self.over_current_A = s.over_current * s.current_limit_A
        self.missing_limit = max(s.ticks(s.no_current_s), FEWEST_TICKS)
        self.still_limit = s.ticks(s.stuck_s)
        self._rate_m_s = s.count_m / s.dt_s
        self._new_grip = 1.0 if s.grip_filter_s == 0 else min(s.dt_s / s.grip_filter_s, 1.0)
        self._seen = self._gripped = False
        self.counts = self.low_counts = 0
        self.current_A = self.expected_A = self.raw_grip_N = self.step_m_s = 0.0
        self.emergency_stop = self.host_stop = self.late = False
        self.bad_encoder = self.bad_current = self.playing = self.held = self.wrong = False
        self.wrong_limit = max(s.ticks(WRONG_CURRENT_S), FEWEST_TICKS)
        self.crosscheck = Crosscheck(s)
        self.forget()

    def forget(self) -> None:
        """Start every duration anew."""
        self.missing_ticks = self.still_ticks = self.turns = self.turn_ticks = self.wrong_ticks = 0
        self.still_A_s = 0.0
        self.crosscheck.forget()

    @property
    def turns_back(self) -> bool:
        """Whether it went so often, and no further, for the time of a still one; an excitation may shake it."""
        often = self.turns >= STUCK_TURNS and not self.settings.host_starts
        return often and self.turn_ticks >= self.still_limit

    def step(self, readings: Readings, expected_A: float, transient_A: float, playing: bool, held: bool) -> None:
        """One tick.

        Parameters
        ----------
        expected_A : current that the model expects. transient_A : transient of the tick before.
        playing : a waveform. held : one that ends if the grip is lost.
        """
        s = self.settings
        self.emergency_stop, self.host_stop, self.late = readings.emergency_stop, readings.host_stop, readings.late
        self.playing, self.held, self.expected_A = playing, held, expected_A
        counts, current, grip = readings.encoder_counts, readings.current_A, readings.grip_N
        # Comparisons with NaN are false: written so that NaN is bad.
        self.bad_encoder = not (-s.encoder_limit_counts <= counts <= s.encoder_limit_counts)
        self.bad_current = not (-s.current_range_A <= current <= s.current_range_A)
        moved = left = 0
        if not self.bad_encoder:
            counts = int(counts)
            if not self._seen:
                self.counts = self.low_counts = counts
            moved = counts - self.counts
            low = min(max(self.low_counts, counts - 1), counts)
            left = low - self.low_counts
            self.counts, self.low_counts, self._seen = counts, low, True
        self.step_m_s = moved * self._rate_m_s
        self.current_A = expected_A if self.bad_current else current
        self.raw_grip_N = grip
        if self.has_grip and s.grip_open_N <= grip <= s.grip_short_N:
            self.grip_N += (self._new_grip if self._gripped else 1.0) * (grip - self.grip_N)
            self._gripped = True
        size, expected = abs(self.current_A), abs(expected_A)
        missing = expected >= s.no_current_A and size < s.no_current_part * expected
        self.missing_ticks = self.missing_ticks + 1 if missing else 0
        self.wrong = abs(self.current_A - expected_A) > WRONG_CURRENT_A + WRONG_CURRENT_PART * expected
        self.wrong_ticks = self.wrong_ticks + 1 if self.wrong else 0
        self.crosscheck.step(left, readings.acceleration_m_s2, self.current_A, playing)
        over = self.turn_ticks >= self.still_limit
        if left != 0 or not size >= s.stuck_A or (over and not self.turns_back):
            self.turns = self.turn_ticks = 0
        elif not over:
            self.turn_ticks += 1
        if moved != 0:
            self.turns += 1
            self.still_ticks, self.still_A_s = 0, 0.0
        else:
            self.still_ticks = self.still_ticks + 1 if size >= s.stuck_A else 0
            # A slow tail of the transient may well be held still by the hand; its strokes cannot.
            self.still_A_s += transient_A * s.dt_s if abs(transient_A) >= s.stuck_A else 0.0


Test = Callable[[Watch], bool]


@dataclass(frozen=True, slots=True)
class Rule:
    """`trips` in any state sends the servo to FAULT at once; there `remains` bars the reset."""

    fault: Fault
    trips: Test
    remains: Test


def _rule(fault: Fault, trips: Test, remains: Test | None = None) -> Rule:
    """What trips bars the reset too, unless something else does."""
    return Rule(fault, trips, trips if remains is None else remains)


def _loose(w: Watch) -> bool:
    return w.has_grip and not w.raw_grip_N >= w.settings.grip_min_N


# The first that trips is the one reported as the servo's fault; each that trips in that tick is an event. Comparisons
# with NaN are false: where a reading must lie within a range, its negation is asked.
FAULTS = (
    _rule(Fault.EMERGENCY_STOP, lambda w: w.emergency_stop),
    _rule(Fault.HOST_STOP, lambda w: w.host_stop),
    _rule(Fault.LATE_TICK, lambda w: w.late),
    _rule(Fault.BAD_SENSOR, lambda w: w.bad_encoder or w.bad_current),
    _rule(Fault.OVER_CURRENT, lambda w: not -w.over_current_A <= w.current_A <= w.over_current_A),
    _rule(
        Fault.OVER_TEMPERATURE,
        lambda w: w.guard is not None and w.guard.too_hot,
        lambda w: w.guard is not None and not w.guard.winding_C <= w.guard.play_limit_C,
    ),
    _rule(Fault.ENCODER_JUMP, lambda w: not -w.settings.fastest_m_s <= w.step_m_s <= w.settings.fastest_m_s),
    _rule(
        Fault.ENCODER_STUCK,
        lambda w: (
            w.still_ticks >= w.still_limit
            or abs(w.still_A_s) >= w.settings.stuck_A_s
            or w.turns_back
            or w.crosscheck.stuck
        ),
    ),
    _rule(Fault.NO_CURRENT, lambda w: w.missing_ticks >= w.missing_limit),
    _rule(Fault.WRONG_CURRENT, lambda w: w.wrong_ticks >= w.wrong_limit, lambda w: w.wrong),
    _rule(Fault.GRIP_OPEN, lambda w: w.has_grip and not w.raw_grip_N >= w.settings.grip_open_N),
    _rule(Fault.GRIP_SHORT, lambda w: w.has_grip and w.raw_grip_N > w.settings.grip_short_N),
    _rule(Fault.GRIP_LOST, lambda w: w.held and _loose(w), _loose),
    _rule(Fault.ACCELEROMETER_DEAD, lambda w: w.crosscheck.quiet),
)
