#include "td_device.h"

#include <math.h>

#include "td_bytes.h"
#include "td_request.h"

#define GREETING_BYTES (TD_HELLO_PROTOCOL + 2) /* magic and protocol, the same in every version */

const size_t TD_DEVICE_BYTES = sizeof(td_device);

static void hold(const td_device *device, bool held)
{
    if (device->port.hold != NULL)
        device->port.hold(device->port.context, held);
}

void td_device_begin(td_device *device, const td_port *port, const size_t *bytes)
{
    memset(device, 0, *bytes);
    device->port = *port;
    td_decoder_start(&device->decoder);
    td_events_start(&device->events, td_device_ticks(device, TD_EVENT_REPEAT_MS));
    td_evidence_start(&device->evidence);
    td_ring_start(&device->ring, &port->hardware, port->winding_C, port->housing_C);
    td_records_restart(&device->records, 0, 0, NULL, 0);
    device->records.hold_ticks = td_device_ticks(device, TD_TELEMETRY_HOLD_MS);
    device->silence_ticks = td_device_ticks(device, TD_LINK_SILENCE_MS);
}

uint8_t td_device_state(const td_device *device)
{
    if (device->store.configured)
        return device->servo.state;
    return device->stop_latched ? TD_STATE_FAULT : TD_STATE_IDLE;
}

uint8_t td_device_fault(const td_device *device)
{
    if (device->store.configured)
        return device->servo.fault;
    return device->stop_latched;
}

int32_t td_device_ticks(const td_device *device, double duration_ms)
{
    return (int32_t)floor(duration_ms * 1e-3 / device->port.hardware.dt_s + 0.5);
}

bool td_device_is_active(const td_device *device)
{
    const uint8_t state = td_device_state(device);

    return state == TD_STATE_ARMED || state == TD_STATE_PLAYING;
}

bool td_device_is_heard(const td_device *device)
{
    return device->open && device->silent_ticks < device->silence_ticks;
}

/* ------------------------------------------------------------------------------------------------ bytes out */

/* A frame to be sent, whose body is in td_device_body. It is decided and written between hold(true) and hold(false), and
 * encoded after that, since encoding takes the longest by far. */
typedef struct {
    enum { NOTHING, ONCE, KEPT, REPEATED } how; /* KEPT: a reply that is sent again if its request is; REPEATED: it is */
    uint8_t kind;
    uint16_t sequence;
    uint32_t session;
    size_t body_size;
} reply;

static const reply no_reply = {NOTHING, 0, 0, 0, 0}, same_reply = {REPEATED, 0, 0, 0, 0};

static reply once(const td_device *device, uint8_t kind, uint16_t sequence, size_t body_size)
{
    const reply made = {ONCE, kind, sequence, device->session, body_size};

    return made;
}

static reply kept(const td_device *device, uint8_t kind, uint16_t sequence, size_t body_size)
{
    reply made = once(device, kind, sequence, body_size);

    made.how = KEPT;
    return made;
}

static void put_reply(td_device *device, const reply *made)
{
    uint8_t *header = device->payload;
    size_t size;

    if (made->how == REPEATED)
        td_output_put(&device->output, device->reply, device->reply_size);
    if (made->how == NOTHING || made->how == REPEATED)
        return;
    header[TD_HEADER_KIND] = made->kind;
    header[TD_HEADER_FLAGS] = 0;
    td_put_u16(header + TD_HEADER_SEQUENCE, made->sequence);
    td_put_u32(header + TD_HEADER_SESSION, made->session);
    size = td_wire_encode(device->payload, TD_HEADER_BYTES + made->body_size, device->frame);
    td_output_put(&device->output, device->frame, size);
    if (made->how == KEPT) {
        device->reply_size = size;
        memcpy(device->reply, device->frame, size);
    }
}

uint8_t td_device_evidence(const td_device *device)
{
    return device->port.simulated ? TD_PULSE_SOUND | TD_TRIAL_FINISHED : device->evidence.bits;
}

static void write_evidence(td_device *device)
{
    const td_evidence *evidence = &device->evidence;
    uint8_t *body = td_device_body(device);

    body[TD_EVIDENCE_REPLY_BITS] = td_device_evidence(device);
    body[TD_EVIDENCE_REPLY_STAGE] = evidence->stage;
    td_put_u16(body + TD_EVIDENCE_REPLY_PULSES, evidence->pulses);
    td_put_f64(body + TD_EVIDENCE_REPLY_CURRENT_RATIO, evidence->current_ratio);
    td_put_f64(body + TD_EVIDENCE_REPLY_ACCELERATION_RATIO, evidence->acceleration_ratio);
    td_put_f64(body + TD_EVIDENCE_REPLY_PATH_RATIO, evidence->path_ratio);
    td_put_f64(body + TD_EVIDENCE_REPLY_SPEED_RATIO, evidence->speed_ratio);
}

static void write_hello_reply(td_device *device, uint32_t nonce)
{
    const td_port *port = &device->port;
    const td_hardware *hardware = &port->hardware;
    const td_store *store = &device->store;
    uint8_t *body = td_device_body(device);

    td_put_u32(body + TD_HELLO_REPLY_MAGIC, TD_MAGIC);
    td_put_u16(body + TD_HELLO_REPLY_PROTOCOL, TD_PROTOCOL);
    body[TD_HELLO_REPLY_REAL_BYTES] = sizeof(td_real);
    body[TD_HELLO_REPLY_STATE] = td_device_state(device);
    body[TD_HELLO_REPLY_FAULT] = td_device_fault(device);
    body[TD_HELLO_REPLY_EVIDENCE] = td_device_evidence(device);
    body[TD_HELLO_REPLY_SIMULATED] = port->simulated;
    td_put_u16(body + TD_HELLO_REPLY_BODY_LIMIT, TD_BODY_LIMIT);
    td_put_u16(body + TD_HELLO_REPLY_UPLOAD_FRAMES, TD_UPLOAD_FRAMES);
    td_put_u32(body + TD_HELLO_REPLY_FIRMWARE, TD_FIRMWARE);
    td_put_u32(body + TD_HELLO_REPLY_BOOT, port->boot);
    td_put_u32(body + TD_HELLO_REPLY_NONCE, nonce);
    td_put_u32(body + TD_HELLO_REPLY_EVENT, td_events_oldest(&device->events));
    td_put_u32(body + TD_HELLO_REPLY_CAPACITY_SAMPLES, TD_MAX_LIBRARY_SAMPLES);
    td_put_u32(body + TD_HELLO_REPLY_CAPACITY_WAVEFORM_SAMPLES, TD_MAX_SAMPLES);
    td_put_u16(body + TD_HELLO_REPLY_CAPACITY_SPEEDS, TD_MAX_SPEEDS);
    td_put_u16(body + TD_HELLO_REPLY_CAPACITY_GRIPS, TD_MAX_GRIPS);
    td_put_u16(body + TD_HELLO_REPLY_CAPACITY_APPROACH_TICKS, TD_MAX_WINDOW_TICKS);
    td_put_u16(body + TD_HELLO_REPLY_CAPACITY_LATENCY_TICKS, TD_MAX_LATENCY_TICKS);
    td_put_u64(body + TD_HELLO_REPLY_TICK, device->tick);
    td_put_f64(body + TD_HELLO_REPLY_DT_S, hardware->dt_s);
    td_put_f64(body + TD_HELLO_REPLY_CURRENT_A, hardware->current_A);
    td_put_f64(body + TD_HELLO_REPLY_COMMAND_A, hardware->command_A);
    td_put_f64(body + TD_HELLO_REPLY_PULSE_A, hardware->pulse_A);
    td_put_f64(body + TD_HELLO_REPLY_PULSE_S, hardware->pulse_s);
    td_put_f64(body + TD_HELLO_REPLY_POLE_LEAST_HZ, hardware->pole_least_Hz);
    td_put_f64(body + TD_HELLO_REPLY_POLE_MOST_HZ, hardware->pole_most_Hz);
    td_put_f64(body + TD_HELLO_REPLY_OVER_CURRENT_A, hardware->over_current_A);
    body[TD_HELLO_REPLY_HAS_COIL] = hardware->has_coil;
    td_put_f64(body + TD_HELLO_REPLY_R_OHM, hardware->R_ohm);
    td_put_f64(body + TD_HELLO_REPLY_R_WH_K_W, hardware->R_wh_K_W);
    td_put_f64(body + TD_HELLO_REPLY_R_HA_K_W, hardware->R_ha_K_W);
    td_put_f64(body + TD_HELLO_REPLY_TAU_W_S, hardware->tau_w_s);
    td_put_f64(body + TD_HELLO_REPLY_TAU_H_S, hardware->tau_h_s);
    td_put_f64(body + TD_HELLO_REPLY_LIMIT_C, hardware->limit_C);
    td_put_f64(body + TD_HELLO_REPLY_AMBIENT_C, hardware->ambient_C);
    memcpy(body + TD_HELLO_REPLY_CONFIGURATION_SHA256, store->configuration_sha256, TD_HASH_BYTES);
    memcpy(body + TD_HELLO_REPLY_LIBRARY_SHA256, store->library_sha256, TD_HASH_BYTES);
}

void td_device_coil(const td_device *device, double *winding_C, double *housing_C)
{
    const bool known = device->ring.coil.present;

    hold(device, true);
    *winding_C = known ? device->ring.guard.winding_C : (double)NAN;
    *housing_C = known ? device->ring.guard.housing_C : (double)NAN;
    hold(device, false);
}

/* Take the next event or the next records that are due, between hold(true) and hold(false): a copy, no more. */
static size_t take_due(td_device *device, uint8_t *kind)
{
    const td_told *told;
    uint8_t *body = td_device_body(device);

    if (!td_device_is_heard(device))
        return 0;
    told = td_events_due(&device->events);
    if (told == NULL) {
        *kind = TD_KIND_TELEMETRY_DATA;
        return td_records_take(&device->records, device->tick, body);
    }
    *kind = TD_KIND_EVENT;
    td_put_u32(body + TD_EVENT_NUMBER, told->number);
    td_put_u64(body + TD_EVENT_TICK, told->event.tick);
    body[TD_EVENT_CODE] = told->event.what;
    td_put_u16(body + TD_EVENT_LOST, told->lost);
    td_put_f64(body + TD_EVENT_SPEED_M_S, (double)told->event.speed_m_s);
    td_put_f64(body + TD_EVENT_GRIP_N, (double)told->event.grip_N);
    td_put_f64(body + TD_EVENT_SCALE, (double)told->event.scale);
    td_put_f64(body + TD_EVENT_COOLED, (double)told->event.cooled);
    return TD_EVENT_BYTES;
}

size_t td_device_send(td_device *device, uint8_t *bytes, size_t room)
{
    uint8_t kind = 0;
    reply due;

    while (device->output.size < room && td_output_has_room(&device->output)) {
        hold(device, true);
        due = once(device, 0, 0, take_due(device, &kind));
        hold(device, false);
        if (due.body_size == 0)
            break;
        due.kind = kind;
        put_reply(device, &due);
    }
    return td_output_take(&device->output, bytes, room);
}

/* ------------------------------------------------------------------------------------------------ bytes in */

/* Whether this is a valid length for the body of a host's frame of this kind. */
static bool fits(uint8_t kind, size_t size)
{
    static const struct {
        uint8_t kind, open; /* open: the length is a minimum */
        uint16_t bytes;
    } kinds[] = {
        {TD_KIND_HELLO, 0, TD_HELLO_BYTES},
        {TD_KIND_CONFIGURE, 1, TD_CONFIGURE_BYTES},
        {TD_KIND_CONFIGURE_COMMIT, 0, TD_CONFIGURE_COMMIT_BYTES},
        {TD_KIND_UPLOAD_BEGIN, 0, TD_UPLOAD_BEGIN_BYTES},
        {TD_KIND_DATA, 1, TD_DATA_BYTES},
        {TD_KIND_COMMIT, 0, TD_COMMIT_BYTES},
        {TD_KIND_ARM, 0, TD_ARM_BYTES},
        {TD_KIND_LEASE, 0, TD_LEASE_BYTES},
        {TD_KIND_DISARM, 0, TD_DISARM_BYTES},
        {TD_KIND_RESET, 0, TD_RESET_BYTES},
        {TD_KIND_GAIN, 0, TD_GAIN_BYTES},
        {TD_KIND_TELEMETRY, 0, TD_TELEMETRY_BYTES},
        {TD_KIND_PULSE, 0, TD_PULSE_BYTES},
        {TD_KIND_EVIDENCE, 0, TD_EVIDENCE_BYTES},
        {TD_KIND_SURFACE, 0, TD_SURFACE_BYTES},
        {TD_KIND_EVENT_ACK, 0, TD_EVENT_ACK_BYTES},
        {TD_KIND_EMERGENCY_STOP, 0, TD_EMERGENCY_STOP_BYTES},
        {TD_KIND_START, 0, TD_START_BYTES},
    };
    size_t j;

    for (j = 0; j < sizeof kinds / sizeof kinds[0]; j++) {
        if (kinds[j].kind == kind)
            return kinds[j].open ? size >= kinds[j].bytes : size == kinds[j].bytes;
    }
    return false;
}

static reply greet(td_device *device, uint16_t sequence, uint32_t session, uint32_t nonce)
{
    if (device->open && session == device->session) {
        /* A repeated or late copy of the HELLO that opened this session. */
        return sequence == device->sequence ? same_reply : no_reply;
    }
    /* The lease belonged to the previous session. */
    td_device_give_up(device);
    device->open = true;
    device->uploads = false;
    device->session = session;
    device->sequence = sequence;
    device->silent_ticks = 0;
    device->lease_us = 0;
    td_events_restart(&device->events);
    td_records_restart(&device->records, 0, 0, NULL, 0);
    write_hello_reply(device, nonce);
    return kept(device, TD_KIND_HELLO_REPLY, sequence, TD_HELLO_REPLY_BYTES);
}

static void write_done(td_device *device, uint8_t kind)
{
    uint8_t *body = td_device_body(device);

    body[TD_DONE_REQUEST] = kind;
    body[TD_DONE_STATE] = td_device_state(device);
    body[TD_DONE_FAULT] = td_device_fault(device);
}

static void write_refused(td_device *device, uint8_t kind, const td_refusal *refusal)
{
    uint8_t *body = td_device_body(device);

    body[TD_REFUSED_REQUEST] = kind;
    body[TD_REFUSED_REASON] = refusal->reason;
    body[TD_REFUSED_STATE] = td_device_state(device);
    body[TD_REFUSED_FAULT] = td_device_fault(device);
    td_put_f64(body + TD_REFUSED_VALUE, refusal->value);
}

static reply request(td_device *device, uint8_t kind, uint16_t sequence, const uint8_t *body, size_t size)
{
    const uint16_t newer = (uint16_t)(sequence - device->sequence);
    td_refusal refusal;

    if (newer == 0)
        return same_reply;
    if (newer >= 0x8000u) {
        device->dropped_frames++;
        return no_reply;
    }
    refusal = td_request(device, kind, body, size);
    device->sequence = sequence;
    if (refusal.reason != 0) {
        write_refused(device, kind, &refusal);
        return kept(device, TD_KIND_REFUSED, sequence, TD_REFUSED_BYTES);
    }
    if (kind == TD_KIND_UPLOAD_BEGIN) {
        td_put_u32(td_device_body(device) + TD_UPLOAD_READY_OFFSET, (uint32_t)device->store.arrived);
        return kept(device, TD_KIND_UPLOAD_READY, sequence, TD_UPLOAD_READY_BYTES);
    }
    if (kind == TD_KIND_EVIDENCE) {
        write_evidence(device);
        return kept(device, TD_KIND_EVIDENCE_REPLY, sequence, TD_EVIDENCE_REPLY_BYTES);
    }
    write_done(device, kind);
    return kept(device, TD_KIND_DONE, sequence, TD_DONE_BYTES);
}

static reply take_data(td_device *device, const uint8_t *body, size_t size)
{
    if (!td_device_is_active(device))
        td_store_take(&device->store, td_get_u32(body + TD_DATA_OFFSET), body + TD_DATA_DATA, size - TD_DATA_BYTES);
    td_put_u32(td_device_body(device) + TD_ACK_WANTED, (uint32_t)device->store.arrived);
    return once(device, TD_KIND_ACK, 0, TD_ACK_BYTES);
}

static reply renew_lease(td_device *device, uint16_t sequence, const uint8_t *body)
{
    const uint64_t host_us = td_get_u64(body + TD_LEASE_HOST_US);
    uint8_t *said = td_device_body(device);

    /* An old frame that something on the way repeats is no sign of a host that lives. */
    if (host_us < device->lease_us) {
        device->dropped_frames++;
        return no_reply;
    }
    device->lease_us = host_us < UINT64_MAX ? host_us + 1 : UINT64_MAX;
    device->lease_left = device->lease_ticks;
    td_put_u64(said + TD_LEASE_REPLY_HOST_US, host_us);
    td_put_u64(said + TD_LEASE_REPLY_TICK, device->tick);
    said[TD_LEASE_REPLY_STATE] = td_device_state(device);
    said[TD_LEASE_REPLY_FAULT] = td_device_fault(device);
    return once(device, TD_KIND_LEASE_REPLY, sequence, TD_LEASE_REPLY_BYTES);
}

/* Handle an intact frame of this session, with a valid length. */
static reply handle(td_device *device, uint8_t kind, uint16_t sequence, const uint8_t *body, size_t size)
{
    if (kind == TD_KIND_LEASE)
        return renew_lease(device, sequence, body);
    if (kind == TD_KIND_DATA)
        return take_data(device, body, size);
    if (kind != TD_KIND_EVENT_ACK)
        return request(device, kind, sequence, body, size);
    td_events_acknowledge(&device->events, td_get_u32(body + TD_EVENT_ACK_WANTED));
    return no_reply;
}

/* Whether a greeting is of another protocol. Another version of ours is told this one's; foreign ones get no reply. */
static bool other_protocol(td_device *device, const uint8_t *payload, size_t size, reply *made)
{
    const uint8_t kind = payload[TD_HEADER_KIND], *body = payload + TD_HEADER_BYTES;

    if ((kind != TD_KIND_HELLO && kind != TD_KIND_HELLO_REPLY) || size < GREETING_BYTES)
        return false;
    if (td_get_u32(body + TD_HELLO_MAGIC) == TD_MAGIC && td_get_u16(body + TD_HELLO_PROTOCOL) == TD_PROTOCOL)
        return false;
    if (td_get_u32(body + TD_HELLO_MAGIC) != TD_MAGIC || kind != TD_KIND_HELLO)
        return true;
    write_hello_reply(device, 0);
    *made = once(device, TD_KIND_HELLO_REPLY, td_get_u16(payload + TD_HEADER_SEQUENCE), TD_HELLO_REPLY_BYTES);
    made->session = td_get_u32(payload + TD_HEADER_SESSION);
    return true;
}

static reply take_payload(td_device *device, const uint8_t *payload, size_t size)
{
    const uint8_t kind = payload[TD_HEADER_KIND], *body = payload + TD_HEADER_BYTES;
    reply made = no_reply;
    uint16_t sequence;
    uint32_t session;
    bool ours;

    if (size < TD_HEADER_BYTES || payload[TD_HEADER_FLAGS] != 0) {
        device->dropped_frames++;
        return no_reply;
    }
    size -= TD_HEADER_BYTES;
    sequence = td_get_u16(payload + TD_HEADER_SEQUENCE);
    session = td_get_u32(payload + TD_HEADER_SESSION);
    if (other_protocol(device, payload, size, &made))
        return made;
    if (!fits(kind, size)) {
        device->dropped_frames++;
        return no_reply;
    }
    if (kind == TD_KIND_HELLO && session != 0) /* 0 is no session: frames of none have it */
        return greet(device, sequence, session, td_get_u32(body + TD_HELLO_NONCE));
    ours = device->open && session == device->session;
    if (ours)
        device->silent_ticks = 0;
    if (kind == TD_KIND_EMERGENCY_STOP)
        device->stop_wanted = true;
    else if (ours)
        made = handle(device, kind, sequence, body, size);
    else
        device->dropped_frames++;
    return made;
}

void td_device_receive(td_device *device, const uint8_t *bytes, size_t size)
{
    for (; size > 0; size--, bytes++) {
        const size_t payload_size = td_decoder_take(&device->decoder, *bytes);
        reply made;

        if (payload_size == 0)
            continue;
        hold(device, true);
        made = take_payload(device, device->decoder.held, payload_size);
        hold(device, false);
        put_reply(device, &made);
    }
}
