/* Approach speed of the stylus and instant of its contact, from encoder counts.
 *
 * A parabola is fitted by least squares to the last readings and evaluated one lead ahead of the newest, where the
 * contact lies when the waveform has to start. A line would need a short window, since a hand that accelerates at
 * 2 m/s^2 biases its slope. Rms errors of the speed and of the contact time over simulated taps at 0.1 m/s:
 *
 *                     line 3 ms       line 5 ms       parabola 6 ms   parabola 10 ms
 *     steady          0.6 %, 11 us    0.2 %,  7 us    1.0 %, 16 us    0.3 %,  7 us
 *     2 m/s^2         3.6 %, 27 us    5.6 %, 56 us    1.1 %, 16 us    0.6 %, 12 us
 *
 * At 0.05 m/s the parabola over 10 ms (2 m/s^2) gives 1.2 %, 25 us; at 0.4 m/s 0.15 %, 2.6 us; at 1 m/s 0.12 %, 1.9 us.
 * Longer windows would require more than 10 ms of undisturbed approach.
 *
 * A tap from rest close above the surface begins within the window, or its acceleration changes there, so that the
 * readings do not follow a parabola. They then have a part along the cubic that is orthogonal to every parabola
 * (td_parabola_bend). If this part exceeds twice that of rounding, only the newer half of the window is used. At a
 * steady speed near a whole number of counts per tick rounding is a slow sawtooth with a larger cubic part: so the
 * threshold is higher if the paths of the two halves differ by no more than an eighth and two counts. Rms errors of
 * the contact time of taps from rest, 1 to 5 mm above the surface at 5 to 30 m/s^2, at 24.5 um per count
 * (tests/campaigns/test_from_rest.py):
 *
 *                     10 ms alone     5 ms alone      10 or 5 ms
 *     constant force  9 us            14 us           9 us
 *     minimum jerk    19 us           15 us           12 us
 *     half sine       64 us           22 us           28 us
 *     0.1 m/s         13 us           21 us           13 us
 *
 * Steady approaches keep the whole window and the errors above. The sums are integers, so a sliding update is exact and
 * its cost does not depend on the window.
 *
 * The test oracle is tests/benches/oracle/approach.py.
 */
#ifndef TD_APPROACH_H
#define TD_APPROACH_H

#include "td_config.h"

#define TD_NEVER (-1e9) /* phase of a stylus that does not approach */

/* Sliding parabola through encoder counts, over the whole window or, if the motion is not one, over its newer half. */
typedef struct {
    int32_t counts[TD_MAX_WINDOW_TICKS]; /* ring, relative to `origin` */
    int32_t read, next, origin;
    int64_t sum0, sum1, sum2, sum3; /* of counts times age^0 .. age^3 */
    int64_t new0, new1, new2;       /* the same over the newer half */
    td_wide speed_m_s;        /* the lead ahead of the newest reading, positive coming in */
    td_wide phase;            /* ticks by which the newest reading lies after the instant at which c_0 is due */
} td_approach;

/* Discard all readings. */
void td_approach_restart(td_approach *approach);

/* One tick's reading, which lies within +-TD_ENCODER_MOST_COUNTS. */
void td_approach_step(td_approach *approach, const td_config *config, int32_t counts);

typedef enum { TD_TOUCH_NOTHING, TD_TOUCH_CONTACT, TD_TOUCH_CHATTER } td_touch;

/* Decides when a transient starts: it is due once c_0 falls into the next tick, and counts as a contact only if the
 * stylus was above the rearm height for a while. */
typedef struct {
    int32_t above; /* ticks above the rearm height, saturating at the required number */
    bool ready, touching, fresh, was_above;
} td_trigger;

void td_trigger_restart(td_trigger *trigger);

td_touch td_trigger_step(td_trigger *trigger, const td_config *config, td_wide z_m, td_wide speed_m_s, td_wide phase);

#endif
