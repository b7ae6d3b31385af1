#include "td_approach.h"

#define BEND_COUNTS 0.6 /* largest cubic part of the readings for the whole window: twice that of rounding */
#define STEADY_BEND_COUNTS 2.0 /* the same at a steady speed, where rounding may be a slow sawtooth */

void td_approach_restart(td_approach *approach)
{
    approach->read = approach->next = approach->origin = 0;
    approach->sum0 = approach->sum1 = approach->sum2 = approach->sum3 = 0;
    approach->new0 = approach->new1 = approach->new2 = 0;
    approach->speed_m_s = 0;
    approach->phase = TD_NEVER;
}

/* The reading that leaves the newer half of the window; 0 before there is one. */
static int64_t middle_of(const td_approach *approach, const td_config *config)
{
    const int32_t at = approach->next - config->half_ticks;

    if (approach->read < config->half_ticks)
        return 0;
    return approach->counts[at >= 0 ? at : at + config->window_ticks];
}

/* Add a reading to the sums: every reading ages by a tick, and the oldest leaves the window. Returns whether the paths of
 * the newer and the older half differ by more than an eighth and two counts. */
static bool slide(td_approach *approach, const td_config *config, int64_t newest)
{
    const int64_t W = config->window_ticks, H = config->half_ticks;
    const int64_t oldest = approach->read >= config->window_ticks ? approach->counts[approach->next] : 0;
    const int64_t middle = middle_of(approach, config), now = newest - middle, change = now - (middle - oldest);

    approach->sum3 += 3 * approach->sum2 + 3 * approach->sum1 + approach->sum0 - W * W * W * oldest;
    approach->sum2 += 2 * approach->sum1 + approach->sum0 - W * W * oldest;
    approach->sum1 += approach->sum0 - W * oldest;
    approach->sum0 += newest - oldest;
    approach->new2 += 2 * approach->new1 + approach->new0 - H * H * middle;
    approach->new1 += approach->new0 - H * middle;
    approach->new0 += newest - middle;
    approach->counts[approach->next] = (int32_t)newest;
    approach->next = approach->next + 1 < config->window_ticks ? approach->next + 1 : 0;
    return (change < 0 ? -change : change) * 8 > (now < 0 ? -now : now) + 16;
}

void td_approach_step(td_approach *approach, const td_config *config, int32_t counts)
{
    const td_wide *bend = config->bend;
    const td_parabola *fit = &config->whole;
    td_wide s0, s1, s2, bent, most, ahead, rate;
    bool changes;

    if (approach->read == 0)
        approach->origin = counts;
    /* Readings relative to the first one keep the sums small far from zero. */
    changes = slide(approach, config, (int64_t)counts - approach->origin);
    if (approach->read < config->window_ticks) {
        approach->read++;
        if (approach->read < config->window_ticks)
            return;
    }
    s0 = (td_wide)approach->sum0;
    s1 = (td_wide)approach->sum1;
    s2 = (td_wide)approach->sum2;
    bent = bend[0] * s0 + bend[1] * s1 + bend[2] * s2 + bend[3] * (td_wide)approach->sum3;
    most = changes ? BEND_COUNTS : STEADY_BEND_COUNTS;
    if (!(-most <= bent && bent <= most)) {
        fit = &config->half;
        s0 = (td_wide)approach->new0;
        s1 = (td_wide)approach->new1;
        s2 = (td_wide)approach->new2;
    }
    ahead = fit->value[0] * s0 + fit->value[1] * s1 + fit->value[2] * s2;
    rate = fit->slope[0] * s0 + fit->slope[1] * s1 + fit->slope[2] * s2;
    approach->speed_m_s = -rate * config->approach_m_s;
    /* Contact is where the tangent at `ahead` crosses the surface; within a few ticks the curvature is negligible. */
    if (approach->speed_m_s >= config->least_speed_m_s)
        approach->phase = (ahead + ((td_wide)approach->origin - config->surface_counts)) / rate;
    else
        approach->phase = TD_NEVER;
}

void td_trigger_restart(td_trigger *trigger)
{
    trigger->above = 0;
    trigger->ready = false;
    trigger->touching = true;
    /* If the device is armed too late for a contact under way, the crossing of the surface reports CHATTER. */
    trigger->fresh = true;
    trigger->was_above = false;
}

td_touch td_trigger_step(td_trigger *trigger, const td_config *config, td_wide z_m, td_wide speed_m_s, td_wide phase)
{
    bool due, ready;

    if (z_m > config->rearm_height_m) {
        if (trigger->above < config->rearm_ticks)
            trigger->above++;
        if (trigger->above >= config->rearm_ticks)
            trigger->ready = true;
    } else {
        trigger->above = 0;
    }
    if (trigger->fresh && trigger->touching) {
        if (z_m >= 0) {
            trigger->was_above = true;
        } else if (trigger->was_above) {
            trigger->fresh = false;
            return TD_TOUCH_CHATTER;
        }
    }
    if (trigger->touching) {
        /* A fast stylus coming in may still be above the touch height when its contact is already due. */
        if (z_m > config->touch_height_m && (speed_m_s <= 0 || trigger->ready))
            trigger->touching = trigger->fresh = false;
        return TD_TOUCH_NOTHING;
    }
    due = phase > -1;
    /* A coarse encoder may read half a count below the surface, by rounding, before the tap is due. */
    if (!due && z_m >= -0.5 * config->count_m)
        return TD_TOUCH_NOTHING;
    ready = trigger->ready;
    trigger->touching = true;
    trigger->ready = false;
    trigger->above = 0;
    if (!due)
        return TD_TOUCH_NOTHING;
    return ready ? TD_TOUCH_CONTACT : TD_TOUCH_CHATTER;
}
