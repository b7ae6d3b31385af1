#include "td_probe.h"

#include <stdlib.h>

#include "td_bytes.h"

size_t td_probe_device_size(void)
{
    return sizeof(td_probe);
}

size_t td_probe_decoder_size(void)
{
    return sizeof(td_decoder);
}

static void hold(void *context, bool held)
{
    td_probe *probe = context;

    probe->held += held ? 1 : -1;
    probe->holds += held;
    if (probe->held != (held ? 1 : 0))
        abort();
}

static void put(void *context, td_real command_A, bool enabled)
{
    td_probe *probe = context;

    (void)command_A;
    probe->enabled = enabled;
}

bool td_probe_enabled(const td_probe *probe)
{
    return probe->enabled;
}

void td_probe_coil(const td_probe *probe, double *heat_C)
{
    const uint32_t before = probe->holds;

    td_device_coil(&probe->device, &heat_C[0], &heat_C[1]);
    /* A tick in between would leave the halves of two numbers. */
    if (probe->holds != before + 1)
        abort();
}

void td_probe_start(td_probe *probe, uint32_t boot, const double *hardware, const double *heat_C, bool simulated)
{
    const double *h = hardware;
    const td_port port = {
        boot,
        {h[0], h[1], h[2], h[3], h[4], h[5], h[6], h[7], h[8] > 0, h[9], h[10], h[11], h[12], h[13], h[14], h[15]},
        simulated,
        heat_C[0],
        heat_C[1],
        hold,
        put,
        probe,
    };

    probe->held = 0;
    probe->holds = 0;
    probe->enabled = false;
    td_device_start(&probe->device, &port);
}

uint8_t td_probe_step(td_device *device, uint64_t tick, int32_t encoder_counts, uint8_t stops,
                      const double *grip_current_acceleration, double *answer, uint8_t *events, double *contacts)
{
    td_readings readings;
    td_output output;
    int32_t j;

    readings.tick = tick;
    readings.encoder_counts = encoder_counts;
    readings.grip_N = (td_real)grip_current_acceleration[0];
    readings.current_A = (td_real)grip_current_acceleration[1];
    readings.acceleration_m_s2 = (td_real)grip_current_acceleration[2];
    readings.emergency_stop = (stops & 1) != 0;
    readings.late = (stops & 2) != 0;
    readings.host_stop = false;
    td_device_step(device, &readings, &output);
    answer[0] = (double)output.command_A;
    answer[1] = (double)output.transient_A;
    answer[2] = (double)output.feedback_A;
    answer[3] = (double)output.winding_C;
    memset(events, 0, TD_MAX_EVENTS);
    for (j = 0; j < output.event_count; j++) {
        events[j] = output.events[j].what;
        contacts[4 * j] = (double)output.events[j].speed_m_s;
        contacts[4 * j + 1] = (double)output.events[j].grip_N;
        contacts[4 * j + 2] = (double)output.events[j].scale;
        contacts[4 * j + 3] = (double)output.events[j].cooled;
    }
    return output.state;
}

size_t td_probe_decode(td_decoder *decoder, const uint8_t *bytes, size_t size, uint8_t *payloads)
{
    uint8_t *at = payloads;

    for (; size > 0; size--, bytes++) {
        const size_t length = td_decoder_take(decoder, *bytes);

        if (length == 0)
            continue;
        td_put_u16(at, (uint16_t)length);
        memcpy(at + 2, decoder->held, length);
        at += 2 + length;
    }
    return (size_t)(at - payloads);
}

void td_probe_look(const td_device *device, td_probe_view *view)
{
    const td_store *store = &device->store;

    memset(view, 0, sizeof *view);
    view->winding_C = device->servo.guard.winding_C;
    view->housing_C = device->servo.guard.housing_C;
    view->boot = device->port.boot;
    view->events = device->events.number;
    view->oldest_event = td_events_oldest(&device->events);
    view->arrived_bytes = (uint32_t)store->arrived;
    view->dropped_frames = device->dropped_frames;
    view->lost_frames = device->output.lost;
    view->state = td_device_state(device);
    view->fault = td_device_fault(device);
    view->evidence = td_device_evidence(device);
    memcpy(view->configuration_sha256, store->configuration_sha256, TD_HASH_BYTES);
    memcpy(view->library_sha256, store->library_sha256, TD_HASH_BYTES);
}

const uint8_t *td_probe_image(const td_device *device, size_t *size)
{
    *size = device->store.size;
    return device->store.images[device->store.current];
}

void td_probe_heat(td_device *device, double winding_C, double housing_C)
{
    device->servo.guard.winding_C = winding_C;
    device->servo.guard.housing_C = housing_C;
}
