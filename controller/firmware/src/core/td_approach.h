/* How fast the stylus comes in and when it will touch, from encoder counts (controller/servo/approach.py). */
#ifndef TD_APPROACH_H
#define TD_APPROACH_H

#include "td_config.h"

#define TD_NEVER (-1e9) /* phase of a stylus that does not come in */

/* Sliding parabola through encoder counts, over the whole window or, where the motion bends, over its newer half; sums
 * of integers, so the update is exact. */
typedef struct {
    int32_t counts[TD_MAX_WINDOW_TICKS]; /* ring, relative to `origin` */
    int32_t read, next, origin;
    int64_t sum0, sum1, sum2, sum3; /* of counts times age^0 .. age^3 */
    int64_t new0, new1, new2;       /* the same over the newer half */
    td_wide speed_m_s;        /* the lead ahead of the newest reading, positive coming in */
    td_wide phase;            /* ticks by which the newest reading lies after the instant at which c_0 is due */
} td_approach;

/* Forget all readings: what comes next has nothing to do with them. */
void td_approach_restart(td_approach *approach);

/* One tick's reading, which lies within +-TD_ENCODER_MOST_COUNTS. */
void td_approach_step(td_approach *approach, const td_config *config, int32_t counts);

typedef enum { TD_TOUCH_NOTHING, TD_TOUCH_CONTACT, TD_TOUCH_CHATTER } td_touch;

/* When a transient may start: due once c_0 falls into the tick to come, and a contact only after a while off. */
typedef struct {
    int32_t above; /* ticks above the rearm height, counted up to those asked for */
    bool ready, touching, fresh, was_above;
} td_trigger;

void td_trigger_restart(td_trigger *trigger);

td_touch td_trigger_step(td_trigger *trigger, const td_config *config, td_wide z_m, td_wide speed_m_s, td_wide phase);

#endif
