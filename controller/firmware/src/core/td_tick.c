/* One servo period of a device: issue the command first, then do the bookkeeping. */
#include <math.h>

#include "td_bytes.h"
#include "td_device.h"

static void tell(td_device *device, int what)
{
    td_event event;

    event.tick = device->tick;
    event.what = (uint8_t)what;
    event.speed_m_s = event.grip_N = event.scale = event.cooled = (td_real)NAN;
    td_events_put(&device->events, &event);
}

void td_device_cut_pulse(td_device *device)
{
    if (device->pulse.left > 0) {
        device->pulse.left = 0;
        if (device->pulse.judged)
            device->evidence.stage = TD_STAGE_NOTHING;
        tell(device, TD_WHAT_PULSE_CUT);
    }
}

void td_device_give_up(td_device *device)
{
    td_device_cut_pulse(device);
    if (td_device_is_active(device)) {
        td_servo_disarm(&device->servo);
        tell(device, TD_WHAT_LEASE_LOST);
    }
}

/* Apply the owner's calibration to raw readings. */
static void correct(const td_calibration *calibration, td_readings *seen)
{
    if (seen->encoder_counts != TD_NO_COUNTS)
        seen->encoder_counts *= calibration->encoder_direction;
    seen->grip_N = calibration->grip_scale * seen->grip_N - calibration->grip_zero_N;
    seen->current_A = calibration->monitor_scale * seen->current_A;
    seen->acceleration_m_s2 =
        calibration->acceleration_scale * seen->acceleration_m_s2 - calibration->acceleration_rest_m_s2;
}

static int first_of(const td_readings *seen, uint32_t tripped)
{
    if (seen->emergency_stop)
        return TD_WHAT_EMERGENCY_STOP;
    if (seen->host_stop)
        return TD_WHAT_HOST_STOP;
    if (seen->late)
        return TD_WHAT_LATE_TICK;
    return tripped & td_fault_bit(TD_WHAT_OVER_CURRENT) ? TD_WHAT_OVER_CURRENT : TD_WHAT_OVER_TEMPERATURE;
}

/* Without a configuration only stops and the hardware's own limits are latched. */
static void step_unconfigured(td_device *device, const td_readings *seen, td_output *output)
{
    device->stop_remains = seen->emergency_stop || seen->late || device->tripped != 0;
    if ((device->stop_remains || seen->host_stop) && device->stop_latched == TD_NO_FAULT) {
        device->stop_latched = (uint8_t)first_of(seen, device->tripped);
        tell(device, device->stop_latched);
    }
    output->command_A = output->transient_A = output->feedback_A = 0;
    output->winding_C = (td_real)NAN;
    output->state = td_device_state(device);
    output->enabled = false;
    output->event_count = 0;
}

static void pulse(td_device *device, const td_readings *seen, td_output *output)
{
    if (output->state != TD_STATE_IDLE) {
        td_device_cut_pulse(device);
        return;
    }
    td_pulse_see(&device->pulse, &device->store.config, seen);
    output->command_A = td_pulse_command(&device->pulse);
    output->enabled = true;
}

static void end_pulse(td_device *device)
{
    const td_config *config = &device->store.config;
    const td_wide grip_N = (td_wide)device->servo.watch.grip_N;
    td_pulse *pulse = &device->pulse;

    if (pulse->left == 0)
        return;
    /* The first wrong pulse is the last; the pulses so far are judged. */
    if (!td_pulse_next(pulse) && !(pulse->judged && pulse->at == 0 && td_evidence_is_wrong(config, pulse, grip_N)))
        return;
    pulse->left = 0;
    if (pulse->judged)
        td_evidence_pulsed(&device->evidence, config, pulse, grip_N);
    tell(device, TD_WHAT_PULSE_ENDED);
}

/* Least current of a trial that is evidence: a share of the hardware's current and of the library's peak. */
static td_wide least_of_trial_A(const td_device *device)
{
    const td_wide of_hardware = TD_TRIAL_HARDWARE_PART * device->port.hardware.current_A;
    const td_wide of_library = TD_TRIAL_LIBRARY_PART * device->servo.bank->peak_A;

    return of_library > of_hardware ? of_library : of_hardware;
}

/* Gather evidence; a fault whose remedy is at a cable takes it, since what is plugged in anew may be reversed. */
static void witness(td_device *device, const td_readings *seen, const td_output *output)
{
    const td_config *config = &device->store.config;
    const td_watch *watch = &device->servo.watch;
    int32_t j;

    if (device->servo.latched & TD_EVIDENCE_FAULTS) {
        td_evidence_start(&device->evidence);
        return;
    }
    td_evidence_see(&device->evidence, config, seen);
    if (!device->trial)
        return;
    if (watch->playing)
        td_evidence_flows(&device->evidence, config, watch->expected_A, watch->current_A);
    for (j = 0; j < output->event_count; j++) {
        if (output->events[j].what == TD_WHAT_CONTACT)
            td_evidence_contact(&device->evidence, config);
        else if (output->events[j].what == TD_WHAT_FINISHED)
            td_evidence_tried(&device->evidence, config, device->servo.gain, least_of_trial_A(device));
    }
}

void td_device_step(td_device *device, const td_readings *readings, td_output *output)
{
    td_readings seen = *readings;
    td_real scale = 1, applied_A, out_A;
    int32_t j;

    device->tick = seen.tick;
    /* A stop over the link lasts one tick and is latched like any other fault. */
    seen.host_stop = device->stop_wanted;
    device->stop_wanted = false;
    if (device->silent_ticks < INT32_MAX)
        device->silent_ticks++;
    device->tripped = td_ring_watch(&device->ring, seen.current_A);
    if (device->broken)
        device->tripped |= td_fault_bit(TD_WHAT_BAD_SENSOR);
    if (td_device_is_active(device) || device->pulse.left > 0) {
        if (device->lease_left == 0)
            td_device_give_up(device);
        else
            device->lease_left--;
    }
    if (device->store.configured) {
        correct(&device->store.config.calibration, &seen);
        /* What the servo plays must not end in the hardware's limit. A tick after each update of the hardware's estimate,
         * which takes long enough itself. */
        if (device->ring.guard.count == 1)
            td_guard_warm(&device->servo.guard, &device->ring.guard);
        scale = device->store.config.calibration.amplifier_scale;
        device->servo.watch.hardware = device->tripped;
        device->servo.watch.pulsing = device->pulse.left > 0;
        td_servo_answer(&device->servo, &seen, output);
        if (device->settled_ticks < INT32_MAX)
            device->settled_ticks++;
    } else {
        step_unconfigured(device, &seen, output);
    }
    if (device->pulse.left > 0)
        pulse(device, &seen, output);

    /* Issue the command. */
    applied_A = output->command_A;
    output->command_A = applied_A / scale;
    out_A = output->enabled ? td_ring_limited(&device->ring, output->command_A) : 0;
    device->broken = !(td_size(applied_A) < (td_real)1e30);
    if (out_A < output->command_A || out_A > output->command_A || device->broken) {
        applied_A = out_A * scale;
        output->command_A = out_A;
    }
    if (device->port.put != NULL)
        device->port.put(device->port.context, output->command_A, output->enabled);

    /* Bookkeeping. */
    td_ring_follow(&device->ring, output->command_A);
    if (device->store.configured) {
        td_servo_applied(&device->servo, applied_A);
        witness(device, &seen, output);
    }
    for (j = 0; j < output->event_count; j++)
        td_events_put(&device->events, &output->events[j]);
    end_pulse(device);
    td_records_step(&device->records, &seen, output, applied_A, td_device_is_heard(device));
    if (td_device_is_heard(device))
        td_events_tick(&device->events);
}
