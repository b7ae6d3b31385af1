#include "td_watch.h"

#include <string.h>

void td_watch_forget(td_watch *watch)
{
    watch->missing_ticks = watch->still_ticks = watch->turns = watch->turn_ticks = watch->wrong_ticks = 0;
    watch->still_A_s = 0;
    td_crosscheck_forget(&watch->crosscheck);
}

void td_watch_start(td_watch *watch, const td_config *config)
{
    watch->counts = watch->low_counts = 0;
    watch->grip_N = config->assumed_grip_N;
    watch->raw_grip_N = watch->current_A = watch->expected_A = watch->step_m_s = 0;
    watch->seen = watch->gripped = false;
    watch->emergency_stop = watch->host_stop = watch->late = watch->bad_encoder = watch->bad_current = false;
    watch->playing = watch->held = watch->pulsing = watch->wrong = false;
    watch->hardware = 0;
    memset(&watch->crosscheck, 0, sizeof watch->crosscheck);
    td_watch_forget(watch);
}

/* By how much the encoder has left its two counts, between which one with a single channel goes back and forth however far
 * the stylus goes; when a sound one turns back this is one count late. */
static int32_t leave(int32_t *low_counts, int32_t counts)
{
    const int32_t before = *low_counts;

    if (counts < before)
        *low_counts = counts;
    else if (counts > before + 1)
        *low_counts = counts - 1;
    return *low_counts - before;
}

/* Whether it went so often, and no further, for the time of a still one: a wall may chatter by a count, but no hand holds it
 * there. */
static bool turns_back(const td_watch *watch, const td_config *config)
{
    return watch->turn_ticks >= config->still_limit && watch->turns >= config->turns_limit;
}

void td_watch_step(td_watch *watch, const td_config *config, const td_readings *readings, td_real expected_A,
                   td_real transient_A, bool playing, bool held)
{
    const int32_t counts = readings->encoder_counts;
    const td_real current = readings->current_A, grip = readings->grip_N;
    td_real size, expected, gap;
    int32_t moved = 0, left = 0;

    watch->emergency_stop = readings->emergency_stop;
    watch->host_stop = readings->host_stop;
    watch->late = readings->late;
    watch->playing = playing;
    watch->held = held;
    watch->expected_A = expected_A;
    /* Comparisons with NaN are false, so these treat NaN as bad. TD_NO_COUNTS is below any limit. */
    watch->bad_encoder = !(-config->encoder_limit_counts <= counts && counts <= config->encoder_limit_counts);
    watch->bad_current = !(-config->current_range_A <= current && current <= config->current_range_A);
    if (!watch->bad_encoder) {
        if (!watch->seen)
            watch->counts = watch->low_counts = counts;
        moved = counts - watch->counts;
        left = leave(&watch->low_counts, counts);
        watch->counts = counts;
        watch->seen = true;
    }
    watch->step_m_s = (td_real)((td_wide)moved * config->encoder_m_s);
    watch->current_A = watch->bad_current ? expected_A : current;
    watch->raw_grip_N = grip;
    if (config->has_grip && config->grip_open_N <= grip && grip <= config->grip_short_N) {
        watch->grip_N += (watch->gripped ? config->new_grip : 1) * (grip - watch->grip_N);
        watch->gripped = true;
    }
    size = td_size(watch->current_A);
    expected = td_size(expected_A);
    if (!(expected >= config->no_current_A && size < config->no_current_part * expected))
        watch->missing_ticks = 0;
    else if (watch->missing_ticks < config->missing_limit)
        watch->missing_ticks++;
    gap = td_size(watch->current_A - expected_A);
    watch->wrong = !watch->pulsing && gap > (td_real)TD_WRONG_CURRENT_A + (td_real)TD_WRONG_CURRENT_PART * expected;
    if (!watch->wrong)
        watch->wrong_ticks = 0;
    else if (watch->wrong_ticks < config->wrong_limit)
        watch->wrong_ticks++;
    td_crosscheck_step(&watch->crosscheck, config, left, readings->acceleration_m_s2, watch->current_A, playing);
    if (left != 0 || !(size >= config->stuck_A) || (watch->turn_ticks >= config->still_limit && !turns_back(watch, config)))
        watch->turns = watch->turn_ticks = 0;
    else if (watch->turn_ticks < config->still_limit)
        watch->turn_ticks++;
    if (moved != 0) {
        watch->turns++;
        watch->still_ticks = 0;
        watch->still_A_s = 0;
        return;
    }
    if (!(size >= config->stuck_A))
        watch->still_ticks = 0;
    else if (watch->still_ticks < config->still_limit)
        watch->still_ticks++;
    /* A hand may hold the stylus still during the slow tail of a transient, but not during its strokes. */
    if (td_size(transient_A) >= config->stuck_A)
        watch->still_A_s += transient_A * config->tick_s;
}

static uint32_t bit(int what, bool set)
{
    return set ? td_fault_bit(what) : 0;
}

static uint32_t alike(const td_watch *w, const td_config *c)
{
    const bool moves = -c->fastest_m_s <= w->step_m_s && w->step_m_s <= c->fastest_m_s;
    const bool flows = -c->over_current_A <= w->current_A && w->current_A <= c->over_current_A;

    return w->hardware | bit(TD_WHAT_EMERGENCY_STOP, w->emergency_stop) | bit(TD_WHAT_HOST_STOP, w->host_stop) |
           bit(TD_WHAT_LATE_TICK, w->late) | bit(TD_WHAT_BAD_SENSOR, w->bad_encoder || w->bad_current) |
           bit(TD_WHAT_OVER_CURRENT, !flows) | bit(TD_WHAT_ENCODER_JUMP, !moves) |
           bit(TD_WHAT_ENCODER_STUCK, w->still_ticks >= c->still_limit || td_size(w->still_A_s) >= c->stuck_A_s ||
                                          turns_back(w, c) || w->crosscheck.stuck) |
           bit(TD_WHAT_NO_CURRENT, w->missing_ticks >= c->missing_limit) |
           bit(TD_WHAT_ACCELEROMETER_DEAD, w->crosscheck.quiet) |
           bit(TD_WHAT_GRIP_OPEN, c->has_grip && !(w->raw_grip_N >= c->grip_open_N)) |
           bit(TD_WHAT_GRIP_SHORT, c->has_grip && w->raw_grip_N > c->grip_short_N);
}

bool td_watch_is_wrong(const td_watch *watch)
{
    return watch->wrong_ticks >= TD_FEWEST_TICKS;
}

static bool loose(const td_watch *w, const td_config *c)
{
    return c->has_grip && !(w->raw_grip_N >= c->grip_min_N);
}

uint32_t td_watch_trips(const td_watch *watch, const td_config *config, const td_guard *guard)
{
    return alike(watch, config) | bit(TD_WHAT_WRONG_CURRENT, watch->wrong_ticks >= config->wrong_limit) |
           bit(TD_WHAT_OVER_TEMPERATURE, config->coil.present && td_guard_too_hot(guard, &config->coil)) |
           bit(TD_WHAT_GRIP_LOST, watch->held && loose(watch, config));
}

uint32_t td_watch_remains(const td_watch *watch, const td_config *config, const td_guard *guard)
{
    const bool hot = config->coil.present && !(guard->winding_C <= config->coil.play_limit_C);

    return alike(watch, config) | bit(TD_WHAT_WRONG_CURRENT, watch->wrong) | bit(TD_WHAT_OVER_TEMPERATURE, hot) |
           bit(TD_WHAT_GRIP_LOST, loose(watch, config));
}
