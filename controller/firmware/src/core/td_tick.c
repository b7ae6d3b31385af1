/* One servo period of a device: servo, lease, test pulse, and what is told of it. */
#include <math.h>

#include "td_bytes.h"
#include "td_device.h"

static void tell(td_device *device, int what)
{
    td_event event;

    event.tick = device->tick;
    event.what = (uint8_t)what;
    event.speed_m_s = event.grip_N = (td_real)NAN;
    td_events_put(&device->events, &event);
}

void td_device_cut_pulse(td_device *device)
{
    if (device->pulse_left > 0) {
        device->pulse_left = 0;
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

/* Before there is a configuration: a stop is latched, nothing else is looked at. */
static void step_unconfigured(td_device *device, const td_readings *readings, td_output *output)
{
    device->stop_pressed = readings->emergency_stop;
    if ((readings->emergency_stop || readings->host_stop) && device->stop_latched == TD_NO_FAULT) {
        device->stop_latched = readings->emergency_stop ? TD_WHAT_EMERGENCY_STOP : TD_WHAT_HOST_STOP;
        tell(device, device->stop_latched);
    }
    output->command_A = output->transient_A = output->feedback_A = 0;
    output->winding_C = (td_real)NAN;
    output->state = td_device_state(device);
    output->event_count = 0;
}

static void step_pulse(td_device *device, td_output *output)
{
    if (output->state != TD_STATE_IDLE) {
        td_device_cut_pulse(device);
        return;
    }
    output->command_A = device->pulse_A;
    device->pulse_left--;
    if (device->pulse_left == 0)
        tell(device, TD_WHAT_PULSE_ENDED);
}

static void send_records(td_device *device)
{
    const td_records *records = &device->records;
    const size_t size = (size_t)records->size * TD_RECORD_BYTES;
    uint8_t *body = td_device_body(device);

    td_put_u32(body + TD_TELEMETRY_DATA_FIRST, records->first);
    td_put_u64(body + TD_TELEMETRY_DATA_TICK, records->tick);
    td_put_u16(body + TD_TELEMETRY_DATA_EVERY, records->every);
    memcpy(body + TD_TELEMETRY_DATA_RECORDS, records->records, size);
    td_device_put(device, TD_KIND_TELEMETRY_DATA, 0, device->session, TD_TELEMETRY_DATA_BYTES + size);
}

static void send_event(td_device *device, const td_told *told)
{
    uint8_t *body = td_device_body(device);

    td_put_u32(body + TD_EVENT_NUMBER, told->number);
    td_put_u64(body + TD_EVENT_TICK, told->event.tick);
    body[TD_EVENT_CODE] = told->event.what;
    td_put_u16(body + TD_EVENT_LOST, told->lost);
    td_put_f64(body + TD_EVENT_SPEED_M_S, (double)told->event.speed_m_s);
    td_put_f64(body + TD_EVENT_GRIP_N, (double)told->event.grip_N);
    td_device_put(device, TD_KIND_EVENT, 0, device->session, TD_EVENT_BYTES);
}

/* Telemetry and events of this tick, if somebody listens. */
static void report(td_device *device, bool complete)
{
    const bool heard = device->open && device->silent_ticks < td_device_ticks(device, TD_LINK_SILENCE_MS);
    const td_told *told;

    if (complete) {
        if (heard && device->output.size < TD_OUTPUT_LIMIT_BYTES)
            send_records(device);
        td_records_sent(&device->records);
    }
    if (!heard)
        return;
    td_events_tick(&device->events);
    for (told = td_events_due(&device->events); told != NULL; told = td_events_due(&device->events))
        send_event(device, told);
}

void td_device_step(td_device *device, const td_readings *readings, td_output *output)
{
    td_readings seen = *readings;
    int32_t j;

    device->tick = seen.tick;
    /* A stop over the link is there for one tick: latched like any other fault. */
    seen.host_stop = device->stop_wanted;
    device->stop_wanted = false;
    if (device->silent_ticks < INT32_MAX)
        device->silent_ticks++;
    if (td_device_is_active(device)) {
        if (device->lease_left == 0)
            td_device_give_up(device);
        else
            device->lease_left--;
    }
    if (device->store.configured)
        td_servo_step(&device->servo, &seen, output);
    else
        step_unconfigured(device, &seen, output);
    for (j = 0; j < output->event_count; j++)
        td_events_put(&device->events, &output->events[j]);
    if (device->pulse_left > 0)
        step_pulse(device, output);
    report(device, td_records_step(&device->records, &seen, output));
}
