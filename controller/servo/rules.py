"""Constants of the core that hold on every device, independent of its settings; `c_header` writes them for C."""

# Largest error of the measured current in every state: absolute, relative to the expected current, and the longest
# time beyond both. Amplifier and monitor that are 10 % off each leave 22 %; their lag lasts a few ticks only. Only
# the first counts without a command: it is six times the offset that the host's check admits.
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
# Turns between two neighbouring counts, within the time of a still encoder, of one that has lost a channel: those of
# a stylus that goes 3 mm at 24.5 um a count. A hand that trembles by 12 Hz on an edge makes 24 in a second.
STUCK_TURNS = 60
# Times that in a wall alone. A tilt is learnt late among its rare counts; in FOLLOW_STILL_S the whole of gravity
# makes 2 mm, eight times the ten counts of 24.5 um.
STUCK_HELD = 8.0
QUIET_M_S2 = 0.980665  # rms about the mean, a tenth of g, below which the accelerometer is silent
DEAD_M_S2 = 0.1  # rms below which an accelerometer is dead: without noise it cannot prove a motion
QUIET_BLOCK_S, QUIET_BLOCKS = 1e-3, 5  # length and number of blocks of the sliding window
# Least swing of the current within the window, and least push of it by the device's own prediction, to judge silence.
# A steady current proves nothing: a sound stylus held by 3.9 A feels 0.03 g.
QUIET_SWING_A, QUIET_PUSH_M_S2 = 1.0, 9.80665
