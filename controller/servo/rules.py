"""Rules that hold on every device whatever its settings: numbers of the core, and what each fault is seen by."""

from controller.servo.interface import Fault
from transopt.base import signals

# While a transient plays a measured current may be off by so much and by this part of what is expected, for so long.
# Amplifier and monitor that are 10 % off each leave 22 %; their lag passes within a few ticks.
WRONG_CURRENT_A, WRONG_CURRENT_PART, WRONG_CURRENT_S = 0.3, 0.3, 2e-3
# Neither this nor a missing current is judged by fewer: the part of a period by which an amplifier is late beyond
# whole ones is not in what is expected, and at a jump of the command one reading and the next may be off by it.
FEWEST_TICKS = 3

# How the accelerometer's motion is drawn to the encoder's at each count: an observer of third order, its poles all
# at this rate, quick enough for a scale that is 20 % off, slow enough for the quantum of a count. Its third state is
# the offset that gravity and a tilted hand leave in the reading.
FOLLOW_RATE_1_S = 200.0
FOLLOW_PART = 0.5  # of the time between two counts, at the least, that the rate spans: rare counts draw more softly
FOLLOW_FAR_M = 5e-3  # further apart the two tell of nothing common: begin anew
FOLLOW_STILL_S = 20e-3  # after so long without a count an integral of the acceleration says nothing: at rest
ABSURD_M_S2 = 1e4  # a reading that is larger, or no number, counts as none
STUCK_COUNTS, STUCK_LEAST_M = 10.0, 2e-4  # of motion that no encoder sleeps through; a fine one's counts are too few
QUIET_M_S2 = 0.980665  # rms about the mean, a tenth of g: less is silence where current shakes
DEAD_M_S2 = 0.1  # less is a wire that nothing hangs on: it has no noise of its own, and tells of no motion
QUIET_BLOCK_S, QUIET_BLOCKS = 1e-3, 5  # of the window that slides over the readings
# So far the current must swing within the window, and so hard must that push by the device's own prediction. A
# current that stands still proves nothing: a sound stylus that is held by 3.9 A feels 0.03 g.
QUIET_SWING_A, QUIET_PUSH_M_S2 = 1.0, 9.80665

# What each is seen by, for the manual, in the order in which they are looked for: the first that trips is the one
# that is latched. In braces the settings that decide.
SEEN_WHEN = {
    Fault.EMERGENCY_STOP: "it is pressed",
    Fault.HOST_STOP: "a host asks for it over the link",
    Fault.LATE_TICK: "the port says that a servo period came late",
    Fault.BAD_SENSOR: (
        "encoder or current give no number, or more than {encoder_limit_counts} counts or {current_range_A} A"
    ),
    Fault.OVER_CURRENT: "the measured current is above {over_current} times the limit",
    Fault.OVER_TEMPERATURE: "the estimated winding is above its limit, or no number",
    Fault.ENCODER_JUMP: "the encoder moves faster than {fastest_m_s} m/s",
    Fault.ENCODER_STUCK: (
        "{stuck_A_s} A s of a transient, or {stuck_s} s above {stuck_A} A, pass without a count of the encoder; "
        f"or, while a transient plays, a motion of {STUCK_COUNTS:g} counts and {1e3 * STUCK_LEAST_M:g} mm by the "
        "accelerometer"
    ),
    Fault.NO_CURRENT: (
        "for {no_current_s} s less than {no_current_part} of the expected current flows, where that is "
        f"{{no_current_A}} A or more; {FEWEST_TICKS} periods at least"
    ),
    Fault.WRONG_CURRENT: (
        f"while a transient plays the measured current is for {1e3 * WRONG_CURRENT_S:g} ms further from the expected "
        f"one than {WRONG_CURRENT_A:g} A and {100 * WRONG_CURRENT_PART:g} % of it; {FEWEST_TICKS} periods at least"
    ),
    Fault.GRIP_OPEN: "the grip reads below {grip_open_N} N, or no number",
    Fault.GRIP_SHORT: "the grip reads above {grip_short_N} N",
    Fault.GRIP_LOST: "while a transient plays the grip falls below the library's least",
    Fault.ACCELEROMETER_DEAD: (
        f"while a transient plays the current swings by {QUIET_SWING_A:g} A or more within "
        f"{1e3 * QUIET_BLOCKS * QUIET_BLOCK_S:g} ms and the accelerometer by less than "
        f"{QUIET_M_S2 / signals.STANDARD_GRAVITY_M_S2:g} g rms"
    ),
}
