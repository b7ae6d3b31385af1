"""Rules that hold on every device independent of its settings: constants of the core, and the criteria of faults."""

from controller.servo.interface import Fault
from transopt.base import signals

# Largest error of the measured current while a transient plays: absolute, relative to the expected current, and the
# longest time beyond both. Amplifier and monitor that are 10 % off each leave 22 %; their lag lasts a few ticks only.
WRONG_CURRENT_A, WRONG_CURRENT_PART, WRONG_CURRENT_S = 0.3, 0.3, 2e-3
# Least ticks over which a wrong or a missing current is judged. The expected current ignores the fraction of a period
# in the amplifier's delay, so that after a jump of the command one reading and the next may be off.
FEWEST_TICKS = 3

# A third-order observer corrects the accelerometer's motion by the encoder's at each count. All its poles have this
# rate, which is fast enough for a scale that is 20 % off and slow enough for the quantisation of a count. Its third
# state is the offset of the reading by gravity and a tilted hand.
FOLLOW_RATE_1_S = 200.0
FOLLOW_PART = 0.5  # largest product of the rate and the time between two counts: rare counts correct more softly
FOLLOW_FAR_M = 5e-3  # difference of the two positions beyond which the observer restarts
FOLLOW_STILL_S = 20e-3  # time without a count after which the stylus counts as at rest and the integrals restart
ABSURD_M_S2 = 1e4  # a reading beyond this, or NaN, counts as 0
STUCK_COUNTS, STUCK_LEAST_M = 10.0, 2e-4  # motion without a count of a stuck encoder, the larger of both
QUIET_M_S2 = 0.980665  # rms about the mean, a tenth of g, below which the accelerometer is silent
DEAD_M_S2 = 0.1  # rms below which an accelerometer is dead: without noise it cannot prove a motion
QUIET_BLOCK_S, QUIET_BLOCKS = 1e-3, 5  # length and number of blocks of the sliding window
# Least swing of the current within the window, and least push of it by the device's own prediction, to judge silence.
# A steady current proves nothing: a sound stylus held by 3.9 A feels 0.03 g.
QUIET_SWING_A, QUIET_PUSH_M_S2 = 1.0, 9.80665

# Criterion of each fault, for the manual, in the order of the checks: the first one that trips is latched. Names in
# braces are settings.
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
