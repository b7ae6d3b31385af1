#include "td_request.h"

#include <math.h>

#include "td_bytes.h"

static void hold(const td_device *device, bool held)
{
    if (device->port.hold != NULL)
        device->port.hold(device->port.context, held);
}

static bool same_hash(const uint8_t *one, const uint8_t *other)
{
    return memcmp(one, other, TD_HASH_BYTES) == 0;
}

static td_refusal need_silent(const td_device *device)
{
    return td_device_is_active(device) ? td_refuse(TD_REASON_NOT_IDLE, (double)NAN) : td_granted;
}

/* The amplifier is off, so that nothing has to be stopped while a long request is executed. */
static td_refusal need_unpowered(const td_device *device)
{
    const td_refusal found = need_silent(device);

    return found.reason == 0 && device->pulse.left > 0 ? td_refuse(TD_REASON_PULSING, (double)NAN) : found;
}

static td_refusal need_idle(const td_device *device)
{
    return td_device_state(device) == TD_STATE_FAULT ? td_refuse(TD_REASON_FAULT_LATCHED, (double)NAN)
                                                     : need_unpowered(device);
}

/* Too few readings show no motion, so rest requires a whole window. */
static td_refusal need_rest(const td_device *device)
{
    const td_servo *servo = &device->servo;

    if (device->settled_ticks < device->store.config.window_ticks)
        return td_refuse(TD_REASON_NOT_AT_REST, (double)NAN);
    return fabs(servo->approach.speed_m_s) <= TD_REST_SPEED_M_S
               ? td_granted
               : td_refuse(TD_REASON_NOT_AT_REST, servo->approach.speed_m_s);
}

/* No current but the model's, which is zero in IDLE once the last command has decayed. */
static td_refusal need_known_current(const td_device *device)
{
    const td_watch *watch = &device->servo.watch;

    return td_watch_is_wrong(watch) ? td_refuse(TD_REASON_CURRENT_FLOWS, (double)watch->current_A) : td_granted;
}

static td_refusal need_gain(const td_device *device, double gain)
{
    const double most = device->trial ? TD_TRIAL_GAIN : 1;

    return gain >= 0 && gain <= most ? td_granted : td_refuse(TD_REASON_BAD_VALUE, gain);
}

/* A new configuration does not stop the current. */
static void flow_on(td_device *device)
{
    const td_real scale = device->store.config.calibration.amplifier_scale;
    const td_real least = device->ring.least_A * scale, most = device->ring.most_A * scale;

    td_servo_flowing(&device->servo, least < most ? least : most, least < most ? most : least);
}

static td_refusal configure_commit(td_device *device, const uint8_t *sha256)
{
    td_refusal found = need_idle(device);
    const td_guard before = device->servo.guard;
    const bool was = device->store.configured && device->store.config.coil.present;
    td_config config;
    bool fits = false;

    if (found.reason != 0)
        return found;
    hold(device, false);
    found = td_store_check_config(&device->store, sha256, &device->port.hardware, &config, &fits);
    hold(device, true);
    /* The state may have changed meanwhile. */
    if (found.reason == 0)
        found = need_idle(device);
    if (found.reason != 0)
        return found;
    td_store_configured(&device->store, sha256, &config, fits);
    td_evidence_start(&device->evidence);
    td_servo_start(&device->servo, &device->store.config, td_store_bank(&device->store));
    device->settled_ticks = 0;
    flow_on(device);
    /* Nor does it cool the coil. */
    if (was)
        td_guard_warm(&device->servo.guard, &before);
    if (device->ring.coil.present)
        td_guard_warm(&device->servo.guard, &device->ring.guard);
    return td_granted;
}

static td_refusal commit(td_device *device)
{
    td_refusal found = need_unpowered(device);

    if (found.reason != 0)
        return found;
    hold(device, false);
    found = td_store_check_image(&device->store);
    hold(device, true);
    if (found.reason != 0)
        return found;
    if (!same_hash(device->store.sha256, device->store.library_sha256))
        td_evidence_other_library(&device->evidence);
    td_store_committed(&device->store);
    device->servo.bank = td_store_bank(&device->store);
    return td_granted;
}

static td_refusal arm(td_device *device, const uint8_t *body)
{
    td_servo *servo = &device->servo;
    const td_store *store = &device->store;
    const uint8_t none[TD_HASH_BYTES] = {0}, trial = body[TD_ARM_TRIAL];
    const uint16_t lease_ms = td_get_u16(body + TD_ARM_LEASE_MS);
    const double gain = td_get_f64(body + TD_ARM_GAIN);
    td_refusal found = need_idle(device);

    if (found.reason != 0)
        return found;
    if (!store->configured)
        return td_refuse(TD_REASON_NO_CONFIGURATION, (double)NAN);
    if (!same_hash(body + TD_ARM_CONFIGURATION_SHA256, store->configuration_sha256))
        return td_refuse(TD_REASON_WRONG_CONFIGURATION, (double)NAN);
    if (same_hash(store->library_sha256, none))
        return td_refuse(TD_REASON_NO_LIBRARY, (double)NAN);
    if (!same_hash(body + TD_ARM_LIBRARY_SHA256, store->library_sha256))
        return td_refuse(TD_REASON_WRONG_LIBRARY, (double)NAN);
    if (!(td_device_evidence(device) & TD_PULSE_SOUND))
        return td_refuse(TD_REASON_NO_PULSE, (double)NAN);
    if (!(td_device_evidence(device) & TD_TRIAL_FINISHED) && trial != 1)
        return td_refuse(TD_REASON_NO_TRIAL, (double)NAN);
    if (lease_ms < TD_LEASE_LEAST_MS || lease_ms > TD_LEASE_MOST_MS)
        return td_refuse(TD_REASON_BAD_LEASE, lease_ms);
    if (trial > 1)
        return td_refuse(TD_REASON_BAD_VALUE, trial);
    device->trial = trial == 1;
    found = need_gain(device, gain);
    if (found.reason != 0)
        return found;
    if (servo->config->coil.present && !(servo->guard.winding_C <= servo->config->coil.play_limit_C))
        return td_refuse(TD_REASON_TOO_HOT, servo->guard.winding_C);
    found = need_known_current(device);
    if (found.reason == 0)
        found = need_rest(device);
    if (found.reason != 0)
        return found;
    td_servo_set_gain(servo, gain);
    td_servo_arm(servo);
    if (device->trial)
        td_evidence_trying(&device->evidence);
    device->lease_ticks = device->lease_left = td_device_ticks(device, lease_ms);
    return td_granted;
}

static td_refusal reset(td_device *device)
{
    if (device->store.configured) {
        if (device->stop_wanted || !td_servo_reset(&device->servo))
            return td_refuse(TD_REASON_FAULT_REMAINS, (double)NAN);
        device->settled_ticks = 0;
        return td_granted;
    }
    if (device->stop_remains || device->stop_wanted)
        return td_refuse(TD_REASON_FAULT_REMAINS, (double)NAN);
    device->stop_latched = TD_NO_FAULT;
    return td_granted;
}

static td_refusal change_gain(td_device *device, double gain)
{
    td_refusal found;

    if (!device->store.configured)
        return td_refuse(TD_REASON_NO_CONFIGURATION, (double)NAN);
    if (need_silent(device).reason == 0)
        device->trial = false;
    found = need_gain(device, gain);
    if (found.reason == 0)
        td_servo_set_gain(&device->servo, gain);
    return found;
}

/* Whether a pulse is large enough to be evidence, by the host's scales and in the hardware's units. */
static bool shows(const td_hardware *hardware, const td_calibration *calibration, double size_A)
{
    const double usual_A = hardware->pulse_A < TD_PULSE_USUAL_A ? hardware->pulse_A : TD_PULSE_USUAL_A;
    const double least_A = TD_PULSE_LEAST_PART * usual_A;

    return size_A >= least_A && size_A >= least_A * (double)td_size(calibration->amplifier_scale) &&
           size_A >= least_A * (double)td_size(calibration->monitor_scale);
}

static td_refusal pulse(td_device *device, double current_A, uint16_t ticks, uint8_t pairs)
{
    const td_hardware *hardware = &device->port.hardware;
    const td_config *config = &device->store.config;
    const td_calibration *calibration = &config->calibration;
    td_refusal found = need_idle(device);
    double commanded_A;

    if (found.reason != 0)
        return found;
    if (!device->store.configured)
        return td_refuse(TD_REASON_NO_CONFIGURATION, (double)NAN);
    /* The host states the amplifier's scale, so both the current and the command are limited. */
    commanded_A = current_A / (double)calibration->amplifier_scale;
    if (!(fabs(current_A) <= hardware->pulse_A && fabs(commanded_A) <= hardware->pulse_A &&
          fabs(current_A) <= (double)config->current_limit_A))
        return td_refuse(TD_REASON_BAD_VALUE, current_A);
    if (ticks == 0 || ticks > td_device_ticks(device, 1e3 * hardware->pulse_s))
        return td_refuse(TD_REASON_BAD_VALUE, ticks);
    if (pairs > 0 && (config->pulse.nodes == 0 || ticks != config->pulse.ticks ||
                      !(fabs(current_A) >= config->pulse.current_A && fabs(current_A) <= config->pulse.current_A)))
        return td_refuse(TD_REASON_OTHER_PULSE, current_A);
    if (pairs > 0 && !shows(hardware, calibration, fabs(current_A)))
        return td_refuse(TD_REASON_BAD_VALUE, current_A);
    found = need_known_current(device);
    if (found.reason == 0)
        found = need_rest(device);
    if (found.reason != 0)
        return found;
    td_pulse_start(&device->pulse, config, (td_real)current_A, ticks, pairs);
    device->lease_ticks = device->lease_left = td_device_ticks(device, TD_PULSE_LEASE_MS);
    if (pairs > 0)
        td_evidence_pulsing(&device->evidence);
    return td_granted;
}

static td_refusal move_surface(td_device *device, double counts)
{
    const uint8_t state = td_device_state(device);

    if (!device->store.configured)
        return td_refuse(TD_REASON_NO_CONFIGURATION, (double)NAN);
    if (state == TD_STATE_FAULT)
        return td_refuse(TD_REASON_FAULT_LATCHED, (double)NAN);
    if (state == TD_STATE_PLAYING)
        return td_refuse(TD_REASON_STILL_PLAYING, (double)NAN);
    /* The wall of another surface lets go of the stylus at once. */
    if (td_size(device->servo.earlier_A) > 0)
        return td_refuse(TD_REASON_WALL_PUSHES, (double)device->servo.earlier_A);
    if (!(fabs(counts) <= TD_ENCODER_MOST_COUNTS))
        return td_refuse(TD_REASON_BAD_VALUE, counts);
    td_servo_set_surface(&device->servo, &device->store.config, counts);
    return td_granted;
}

static td_refusal start(td_device *device, uint8_t negative)
{
    td_servo *servo = &device->servo;
    const uint8_t state = td_device_state(device);

    if (state == TD_STATE_FAULT)
        return td_refuse(TD_REASON_FAULT_LATCHED, (double)NAN);
    if (state == TD_STATE_IDLE)
        return td_refuse(TD_REASON_NOT_ARMED, (double)NAN);
    if (!servo->config->host_starts)
        return td_refuse(TD_REASON_BY_CONTACT, (double)NAN);
    if (state == TD_STATE_PLAYING)
        return td_refuse(TD_REASON_STILL_PLAYING, (double)NAN);
    if (negative > 1)
        return td_refuse(TD_REASON_BAD_VALUE, negative);
    if (!td_servo_excite(servo, negative == 1))
        return td_refuse(TD_REASON_TOO_HOT, servo->config->coil.present ? servo->guard.winding_C : (double)NAN);
    return td_granted;
}

static td_refusal begin(td_device *device, const uint8_t *body)
{
    td_refusal found = need_silent(device);

    if (found.reason != 0)
        return found;
    /* The servo does not use the arriving image, so this needs no hold, except that the tick may record in its memory. */
    td_records_give_back(&device->records);
    device->uploads = true;
    hold(device, false);
    found = td_store_begin(&device->store, td_get_u32(body + TD_UPLOAD_BEGIN_LENGTH), body + TD_UPLOAD_BEGIN_SHA256);
    hold(device, true);
    return found;
}

static td_refusal record(td_device *device, uint16_t every, uint16_t before)
{
    uint8_t *lent = every > 0 ? td_store_spare(&device->store, device->uploads) : NULL;

    td_records_restart(&device->records, every, before, lent, TD_MAX_IMAGE_BYTES);
    return td_granted;
}

td_refusal td_request(td_device *device, uint8_t kind, const uint8_t *body, size_t size)
{
    switch (kind) {
    case TD_KIND_CONFIGURE:
        return td_store_configure(&device->store, td_get_u32(body + TD_CONFIGURE_OFFSET), body + TD_CONFIGURE_DATA,
                                  size - TD_CONFIGURE_BYTES);
    case TD_KIND_CONFIGURE_COMMIT:
        return configure_commit(device, body + TD_CONFIGURE_COMMIT_SHA256);
    case TD_KIND_UPLOAD_BEGIN:
        return begin(device, body);
    case TD_KIND_COMMIT:
        return commit(device);
    case TD_KIND_ARM:
        return arm(device, body);
    case TD_KIND_DISARM:
        if (device->store.configured)
            td_servo_disarm(&device->servo);
        td_device_cut_pulse(device);
        return td_granted;
    case TD_KIND_RESET:
        return reset(device);
    case TD_KIND_GAIN:
        return change_gain(device, td_get_f64(body + TD_GAIN_GAIN));
    case TD_KIND_TELEMETRY:
        return record(device, td_get_u16(body + TD_TELEMETRY_EVERY), td_get_u16(body + TD_TELEMETRY_BEFORE));
    case TD_KIND_PULSE:
        return pulse(device, td_get_f64(body + TD_PULSE_CURRENT_A), td_get_u16(body + TD_PULSE_TICKS),
                     body[TD_PULSE_PAIRS]);
    case TD_KIND_START:
        return start(device, body[TD_START_NEGATIVE]);
    case TD_KIND_SURFACE:
        return move_surface(device, td_get_f64(body + TD_SURFACE_COUNTS));
    default: /* only TD_KIND_EVIDENCE is left */
        return td_granted;
    }
}
