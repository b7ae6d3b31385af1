#include "td_servo.h"

#include <math.h>
#include <string.h>

#define SATURATED_A 1e-3 /* a smaller cut is rounding of the waveforms and is not reported */

void td_servo_start(td_servo *servo, const td_config *config, const td_bank *bank)
{
    memset(servo, 0, sizeof *servo);
    servo->config = config;
    servo->bank = bank;
    servo->state = TD_STATE_IDLE;
    servo->fault = TD_NO_FAULT;
    servo->gain = servo->wanted_gain = 1;
    td_approach_restart(&servo->approach);
    td_trigger_restart(&servo->trigger);
    td_watch_start(&servo->watch, config);
    td_guard_start(&servo->guard, &config->coil);
}

static void silence(td_servo *servo)
{
    servo->earlier_A = servo->transient_A = servo->command_A = 0;
    servo->was_saturated = false;
    td_watch_forget(&servo->watch);
}

bool td_servo_arm(td_servo *servo)
{
    if (servo->bank == NULL)
        return false;
    if (servo->state == TD_STATE_IDLE) {
        servo->state = TD_STATE_ARMED;
        servo->engaged = false;
        servo->gain = servo->wanted_gain;
        servo->earlier_A = 0;
        td_trigger_restart(&servo->trigger);
    }
    return servo->state != TD_STATE_FAULT;
}

void td_servo_disarm(td_servo *servo)
{
    if (servo->state != TD_STATE_FAULT) {
        servo->state = TD_STATE_IDLE;
        silence(servo);
    }
}

bool td_servo_reset(td_servo *servo)
{
    if (servo->state == TD_STATE_FAULT) {
        /* The latched causes must be gone, and none may trip at once. */
        const uint32_t remains = td_watch_remains(&servo->watch, servo->config, &servo->guard) & servo->latched;
        const uint32_t trips = td_watch_trips(&servo->watch, servo->config, &servo->guard) & ~servo->latched;

        if (remains | trips)
            return false;
        servo->state = TD_STATE_IDLE;
        servo->fault = TD_NO_FAULT;
        servo->latched = 0;
        td_approach_restart(&servo->approach);
    }
    return true;
}

void td_servo_set_gain(td_servo *servo, td_wide gain)
{
    servo->wanted_gain = gain > 0 ? (gain > 1 ? 1 : gain) : 0;
}

void td_servo_set_surface(td_servo *servo, td_config *config, td_wide counts)
{
    const td_wide by_m = (config->surface_counts - counts) * config->count_m;
    int32_t j;

    config->surface_counts = counts;
    /* Motion above the old surface does not count for the new one: neither wall nor contact acts before the stylus has
     * been above it. */
    servo->engaged = false;
    td_trigger_restart(&servo->trigger);
    if (!servo->read)
        return;
    servo->z_m += by_m;
    for (j = 0; j <= config->wall.latency_ticks; j++)
        servo->ring_z[j] = (td_real)((td_wide)servo->ring_z[j] + by_m);
}

/* The event reported; NULL if there was no room. */
static td_event *tell(td_output *output, uint64_t tick, int what, td_real speed_m_s, td_real grip_N)
{
    td_event *event;

    if (output->event_count >= TD_MAX_EVENTS)
        return NULL;
    event = &output->events[output->event_count++];
    event->tick = tick;
    event->what = (uint8_t)what;
    event->speed_m_s = speed_m_s;
    event->grip_N = grip_N;
    event->scale = event->cooled = (td_real)NAN;
    return event;
}

static td_event *note(td_servo *servo, td_output *output, uint64_t tick, int notice, td_real speed_m_s, td_real grip_N)
{
    servo->counts[notice - TD_FIRST_NOTICE]++;
    return tell(output, tick, notice, speed_m_s, grip_N);
}

/* Latch these faults and report each; the first of the list becomes the servo's fault. */
static void latch(td_servo *servo, td_output *output, uint64_t tick, uint32_t faults)
{
    static const uint8_t order[TD_FAULTS] = {
        TD_WHAT_EMERGENCY_STOP, TD_WHAT_HOST_STOP,        TD_WHAT_LATE_TICK,    TD_WHAT_BAD_SENSOR,
        TD_WHAT_OVER_CURRENT,   TD_WHAT_OVER_TEMPERATURE, TD_WHAT_ENCODER_JUMP, TD_WHAT_ENCODER_STUCK,
        TD_WHAT_NO_CURRENT,     TD_WHAT_WRONG_CURRENT,    TD_WHAT_GRIP_OPEN,    TD_WHAT_GRIP_SHORT,
        TD_WHAT_GRIP_LOST,      TD_WHAT_ACCELEROMETER_DEAD,
    };
    int j;

    for (j = 0; j < TD_FAULTS; j++) {
        if (!(faults & td_fault_bit(order[j])))
            continue;
        if (servo->fault == TD_NO_FAULT)
            servo->fault = order[j];
        tell(output, tick, order[j], (td_real)NAN, (td_real)NAN);
    }
    servo->latched |= faults;
}

/* Position, filtered velocity and approach from the last sound reading. */
static void measure(td_servo *servo)
{
    const td_config *config = servo->config;
    const td_wide z = ((td_wide)servo->watch.counts - config->surface_counts) * config->count_m;
    const td_wide a = config->wall.smoothing;
    int32_t j;

    if (!servo->read) {
        /* At the first reading the stylus counts as at rest. */
        servo->z_m = z;
        servo->read = true;
        for (j = 0; j <= config->wall.latency_ticks; j++)
            servo->ring_z[j] = (td_real)z;
    }
    servo->v_m_s = a * servo->v_m_s + (1 - a) * (z - servo->z_m) / config->dt_s;
    servo->z_m = z;
    servo->ring_z[servo->ring_next] = (td_real)z;
    servo->ring_v[servo->ring_next] = (td_real)servo->v_m_s;
    servo->ring_next = servo->ring_next < config->wall.latency_ticks ? servo->ring_next + 1 : 0;
    td_approach_step(&servo->approach, config, servo->watch.counts);
}

/* Feedback current of the wall (seed Eq. 9): it pushes below the surface and never pulls. */
static td_real law(td_servo *servo)
{
    const td_wall *wall = &servo->config->wall;
    const td_real z = servo->ring_z[servo->ring_next], v = servo->ring_v[servo->ring_next];
    td_real wanted;

    if (z >= 0) {
        servo->engaged = true;
        return 0;
    }
    if (!wall->present || !servo->engaged)
        return 0;
    wanted = -(wall->stiffness_N_m * z + wall->damping_N_s_m * v) / wall->force_per_current_N_A;
    return wanted > 0 ? wanted : 0;
}

/* Whether a contact lies outside the grid by more than the errors of the sensors. */
static bool outside(const td_servo *servo, td_wide speed_m_s, td_wide grip_N)
{
    const td_bank *bank = servo->bank;
    const td_wide slack = servo->config->grid_slack * speed_m_s, slack_N = servo->config->grid_slack_N;

    if (!(bank->speed_m_s[0] - slack <= speed_m_s && speed_m_s <= bank->speed_m_s[bank->speeds - 1] + slack))
        return true;
    return bank->by_grip &&
           !(bank->grip_N[0] - slack_N <= grip_N && grip_N <= bank->grip_N[bank->grips - 1] + slack_N);
}

/* Start playing `phase` ticks after c_0: sample j is a fraction of a tick late, interpolated with the previous one. */
static void start(td_servo *servo, td_wide phase)
{
    const int32_t samples = servo->bank->samples;
    int32_t index = samples + 1; /* ends before it begins */

    servo->part = 0;
    if (phase <= (td_wide)samples) {
        index = (int32_t)phase;
        if ((td_wide)index < phase)
            index++;
        servo->part = (td_real)((td_wide)index - phase);
    }
    servo->index = index;
    servo->last = samples;
    servo->sample_A = index >= 1 && index <= samples ? td_bank_sample(servo->bank, &servo->play, index - 1) : 0;
    servo->state = TD_STATE_PLAYING;
}

/* Whether the grip is too small for a transient to start. */
static bool loose(const td_servo *servo)
{
    const td_config *config = servo->config;

    return config->has_grip && !(servo->watch.raw_grip_N >= config->grip_min_N + config->grip_margin_N);
}

bool td_servo_excite(td_servo *servo, bool negative)
{
    const td_config *config = servo->config;
    const td_bank *bank = servo->bank;
    td_play *play = &servo->play;

    if (servo->state != TD_STATE_ARMED || !config->host_starts)
        return false;
    td_bank_at(bank, bank->speed_m_s[0], bank->grip_N[0], play);
    if (play->silent)
        return false;
    if (config->coil.present &&
        td_guard_allowed(&servo->guard, &config->coil, play->transient_A, HUGE_VAL, play->feedback_A, bank->samples + 1,
                         bank->root_ticks)
                .scale < 1)
        return false;
    servo->scale = negative ? -1 : 1;
    servo->held = !loose(servo);
    start(servo, 0);
    return true;
}

/* Detect a contact, and start its transient if one may play. */
static void touch(td_servo *servo, td_output *output, uint64_t tick)
{
    const td_config *config = servo->config;
    const td_approach *approach = &servo->approach;
    const td_real speed = (td_real)approach->speed_m_s, grip = servo->watch.grip_N;
    td_allowed allowed = {1, 0};
    td_play *play = &servo->play;
    td_touch found;

    if (config->host_starts)
        return;
    found = td_trigger_step(&servo->trigger, config, servo->z_m, approach->speed_m_s, approach->phase);
    if (found == TD_TOUCH_NOTHING)
        return;
    if (found == TD_TOUCH_CHATTER || servo->state == TD_STATE_PLAYING) {
        note(servo, output, tick, TD_WHAT_CONTACT_CHATTER, speed, grip);
        return;
    }
    td_bank_at(servo->bank, approach->speed_m_s, (td_wide)grip, play);
    if (play->silent || loose(servo)) {
        note(servo, output, tick, TD_WHAT_NO_GRIP, speed, grip);
        return;
    }
    if (config->coil.present)
        allowed = td_guard_allowed(&servo->guard, &config->coil, play->transient_A, play->cool_A, play->feedback_A,
                                   servo->bank->samples + 1, servo->bank->root_ticks);
    if (allowed.scale <= 0) {
        note(servo, output, tick, TD_WHAT_TOO_HOT_TO_PLAY, speed, grip);
        return;
    }
    note(servo, output, tick, TD_WHAT_CONTACT, speed, grip);
    if (play->out_of_grid && outside(servo, approach->speed_m_s, (td_wide)grip))
        note(servo, output, tick, TD_WHAT_OUT_OF_GRID, speed, grip);
    servo->scale = (td_real)allowed.scale;
    play->cooled = (td_real)allowed.cooled;
    if (allowed.scale < 1 || allowed.cooled > 0) {
        td_event *told = note(servo, output, tick, TD_WHAT_SCALED_FOR_HEAT, speed, grip);

        if (told != NULL) {
            told->scale = servo->scale;
            told->cooled = play->cooled;
        }
    }
    servo->held = true;
    if (servo->bank->samples > 0)
        start(servo, approach->phase);
}

/* Transient command of this tick. */
static td_real next_sample(td_servo *servo, bool *ended)
{
    const int32_t j = servo->index;
    const td_real part = servo->part, before = servo->sample_A;

    *ended = j >= servo->last;
    if (j > servo->last)
        return 0;
    servo->sample_A = j < servo->last ? td_bank_sample(servo->bank, &servo->play, j) : 0;
    servo->index = j + 1;
    return servo->scale * (td_real)servo->gain * ((1 - part) * servo->sample_A + part * before);
}

/* The nearest command within the slew limit, the command's range and, with priority, the current limit. The current at
 * the next switching instant is e i + (1 - e) c, monotonic until then; it is closest to the limit for the fastest
 * amplifier and the current nearest to the limit. */
static td_real limited(const td_servo *servo, td_real command_A)
{
    const td_config *config = servo->config;
    const td_real e = config->fast;
    const td_real high = (config->current_limit_A - e * servo->most_A) / (1 - e);
    const td_real low = (-config->current_limit_A - e * servo->least_A) / (1 - e);

    if (config->has_slew)
        command_A = td_within(command_A, servo->command_A - config->slew_A, servo->command_A + config->slew_A);
    command_A = td_within(command_A, low, high);
    return td_within(command_A, -config->command_limit_A, config->command_limit_A);
}

/* Advance the model's current and its bounds to the next switching instant. */
static void expect(td_servo *servo, td_real command_A)
{
    const td_config *config = servo->config;
    const td_real most = command_A > servo->most_A ? config->fast : config->slow;
    const td_real least = command_A < servo->least_A ? config->fast : config->slow;
    int32_t j;

    for (j = config->late_ticks; j > 0; j--)
        servo->expected_A[j] = servo->expected_A[j - 1];
    servo->expected_A[0] = config->decay * servo->expected_A[0] + (1 - config->decay) * command_A;
    servo->most_A = most * servo->most_A + (1 - most) * command_A;
    servo->least_A = least * servo->least_A + (1 - least) * command_A;
}

static void follow_gain(td_servo *servo)
{
    const td_wide low = servo->gain - servo->config->gain_step, high = servo->gain + servo->config->gain_step;
    const td_wide wanted = servo->wanted_gain;

    servo->gain = wanted < low ? low : (wanted > high ? high : wanted);
}

/* Report once per run of cut ticks. */
static void saturation(td_servo *servo, td_output *output, uint64_t tick, td_real cut_A)
{
    const bool saturated = td_size(cut_A) > (td_real)SATURATED_A;

    if (saturated && !servo->was_saturated)
        note(servo, output, tick, TD_WHAT_COMMAND_SATURATED, (td_real)NAN, (td_real)NAN);
    servo->was_saturated = saturated;
}

/* Command of a tick in ARMED or PLAYING, within all limits. */
static void drive(td_servo *servo, uint64_t tick, td_output *output)
{
    const td_config *config = servo->config;
    td_real wanted, inside, cut;
    bool ended = false;

    touch(servo, output, tick);
    follow_gain(servo);
    wanted = (td_real)servo->gain * law(servo);
    output->feedback_A = config->now * wanted + config->before * servo->earlier_A;
    if (servo->state == TD_STATE_PLAYING) {
        output->transient_A = next_sample(servo, &ended);
        if (ended) {
            servo->state = TD_STATE_ARMED;
            note(servo, output, tick, TD_WHAT_FINISHED, (td_real)NAN, (td_real)NAN);
        }
    }
    output->command_A = output->transient_A + output->feedback_A;
    inside = limited(servo, output->command_A);
    cut = output->command_A - inside;
    if (cut < 0 || cut > 0) {
        /* Store the feedback current that results from the cut command. */
        wanted = (inside - output->transient_A - config->before * servo->earlier_A) / config->now;
        output->command_A = inside;
    }
    servo->earlier_A = wanted;
    saturation(servo, output, tick, cut);
}

void td_servo_flowing(td_servo *servo, td_real least_A, td_real most_A)
{
    int32_t j;

    servo->least_A = least_A;
    servo->most_A = most_A;
    for (j = 0; j <= TD_DELAY_TICKS; j++)
        servo->expected_A[j] = (least_A + most_A) / 2;
}

void td_servo_applied(td_servo *servo, td_real command_A)
{
    servo->command_A = command_A;
    expect(servo, command_A);
}

void td_servo_step(td_servo *servo, const td_readings *readings, td_output *output)
{
    td_servo_answer(servo, readings, output);
    td_servo_applied(servo, output->command_A);
}

void td_servo_answer(td_servo *servo, const td_readings *readings, td_output *output)
{
    const td_config *config = servo->config;
    td_watch *watch = &servo->watch;
    uint32_t trips;

    output->command_A = output->transient_A = output->feedback_A = 0;
    output->event_count = 0;
    td_watch_step(watch, config, readings, servo->expected_A[config->late_ticks], servo->transient_A,
                  servo->state == TD_STATE_PLAYING, servo->state == TD_STATE_PLAYING && servo->held);
    if (config->coil.present) {
        /* The larger of measured and expected current, so that a sensor that reads low does not overheat the coil. */
        const td_real measured = watch->bad_current ? config->over_current_A : td_size(watch->current_A);
        const td_real expected = td_size(servo->expected_A[0]);

        td_guard_step(&servo->guard, &config->coil, measured > expected ? measured : expected);
    }
    measure(servo);
    trips = td_watch_trips(watch, config, &servo->guard);
    if (servo->state == TD_STATE_FAULT) {
        /* Further faults are latched and reported too, since they prevent the reset. */
        latch(servo, output, readings->tick, trips & ~servo->latched);
        td_watch_forget(watch);
    } else if (trips) {
        servo->state = TD_STATE_FAULT;
        latch(servo, output, readings->tick, trips);
        silence(servo);
    } else if (servo->state != TD_STATE_IDLE) {
        drive(servo, readings->tick, output);
    }
    servo->transient_A = output->transient_A;
    output->state = servo->state;
    output->enabled = servo->state == TD_STATE_ARMED || servo->state == TD_STATE_PLAYING;
    output->winding_C = config->coil.present ? (td_real)servo->guard.winding_C : (td_real)NAN;
}
