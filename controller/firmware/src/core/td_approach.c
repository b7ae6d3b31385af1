#include "td_approach.h"

void td_approach_restart(td_approach *approach)
{
    approach->read = approach->next = approach->origin = 0;
    approach->sum0 = approach->sum1 = approach->sum2 = 0;
    approach->speed_m_s = 0;
    approach->phase = TD_NEVER;
}

void td_approach_step(td_approach *approach, const td_config *config, int32_t counts)
{
    const int64_t window = config->window_ticks;
    int64_t newest, oldest;
    td_wide ahead, rate;

    if (approach->read == 0)
        approach->origin = counts;
    /* Relative to the first reading, so that far from zero the sums stay small. */
    newest = (int64_t)counts - approach->origin;
    oldest = approach->read >= config->window_ticks ? approach->counts[approach->next] : 0;
    /* Every reading ages by one tick; the oldest leaves at the window's age. */
    approach->sum2 += 2 * approach->sum1 + approach->sum0 - window * window * oldest;
    approach->sum1 += approach->sum0 - window * oldest;
    approach->sum0 += newest - oldest;
    approach->counts[approach->next] = (int32_t)newest;
    approach->next = approach->next + 1 < config->window_ticks ? approach->next + 1 : 0;
    if (approach->read < config->window_ticks) {
        approach->read++;
        if (approach->read < config->window_ticks)
            return;
    }
    ahead = config->value[0] * (td_wide)approach->sum0 + config->value[1] * (td_wide)approach->sum1 +
            config->value[2] * (td_wide)approach->sum2;
    rate = config->slope[0] * (td_wide)approach->sum0 + config->slope[1] * (td_wide)approach->sum1 +
           config->slope[2] * (td_wide)approach->sum2;
    approach->speed_m_s = -rate * config->approach_m_s;
    /* Contact is where the tangent at `ahead` crosses the surface; within a few ticks the curvature is nothing. */
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
    /* Armed too late for a contact that is already on its way: that is told too. */
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
        /* While it comes in, a fast stylus is above the touch height when its contact is already due. */
        if (z_m > config->touch_height_m && (speed_m_s <= 0 || trigger->ready))
            trigger->touching = trigger->fresh = false;
        return TD_TOUCH_NOTHING;
    }
    due = phase > -1;
    if (!due && z_m >= 0)
        return TD_TOUCH_NOTHING;
    ready = trigger->ready;
    trigger->touching = true;
    trigger->ready = false;
    trigger->above = 0;
    if (!due)
        return TD_TOUCH_NOTHING;
    return ready ? TD_TOUCH_CONTACT : TD_TOUCH_CHATTER;
}
