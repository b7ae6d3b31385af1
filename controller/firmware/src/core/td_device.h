/* The device's end of the protocol in front of the servo: bytes and readings in, commands and bytes out.
 *
 *     td_device_receive      take bytes from the link, in pieces of any size
 *     td_device_step         one servo period: issue the command first, then do the bookkeeping
 *     td_device_send         give the bytes to send; frames are encoded here
 *
 * A port calls `step` in the timer's interrupt and the others outside of it. Shared data is changed only between
 * hold(context, true) and hold(context, false), which mask that interrupt for 42 us at most on an M4F at 168 MHz. Frames
 * are encoded without; so are libraries hashed and checked, which takes tens of milliseconds, only while the amplifier is
 * off. All state is in the struct; a port needs one static td_device.
 */
#ifndef TD_DEVICE_H
#define TD_DEVICE_H

#include "td_evidence.h"
#include "td_outbox.h"
#include "td_ring.h"
#include "td_servo.h"
#include "td_store.h"
#include "td_wire.h"

#define TD_FIRMWARE (2u << 16) /* major, minor, patch: 16, 8, 8 bits */
#define TD_REPLY_LIMIT (TD_HEADER_BYTES + TD_HELLO_REPLY_BYTES + 4 + 2 + 1) /* the longest answer as a frame */

typedef struct {
    uint32_t boot; /* different at every start */
    td_hardware hardware;
    bool simulated;             /* compiled in: there is no wiring that could be wrong, so evidence counts as given */
    double winding_C, housing_C; /* of the coil, kept over the restart (td_device_coil); NaN: not known, so hottest */
    void (*hold)(void *context, bool held); /* NULL where nothing interrupts */
    /* The command goes out; NULL where the caller takes it from what td_device_step answers. `enabled`: whether the
     * amplifier may be on at all. */
    void (*put)(void *context, td_real command_A, bool enabled);
    void *context;
} td_port;

typedef struct {
    td_port port;
    uint64_t tick; /* of the last readings */
    uint32_t dropped_frames; /* sound, but not for this session, out of order, or of no meaning; modulo 2^32 */
    td_decoder decoder;
    bool open, uploads; /* there has been a HELLO; and in its session the beginning of an upload */
    uint32_t session;
    uint16_t sequence; /* of the last request */
    uint8_t reply[TD_REPLY_LIMIT];
    size_t reply_size;
    td_store store;
    td_servo servo; /* once the store is configured */
    td_evidence evidence;
    bool stop_wanted; /* over the link */
    bool stop_remains;    /* before there is a servo: the cause of what is latched */
    uint8_t stop_latched; /* and what it is, TD_WHAT_..., 0 without */
    bool trial;                                   /* armed for the tap of the bring-up check */
    int32_t lease_ticks, lease_left;
    uint64_t lease_us; /* least host_us of the next LEASE of this session */
    int32_t silent_ticks, silence_ticks; /* since the host was heard, and from how many on it counts as gone */
    int32_t settled_ticks; /* since the approach began to be looked at anew: before a whole window nobody is at rest */
    td_pulse pulse;
    td_ring ring;
    uint32_t tripped; /* faults of the hardware's own limits in the last tick */
    bool broken;      /* a command was not finite */
    td_events events;
    td_records records;
    td_output_bytes output;
    uint8_t payload[TD_PAYLOAD_LIMIT], frame[TD_FRAME_LIMIT]; /* being written */
} td_device;

/* A constant with sizeof(td_device), whose name contains precision and capacities. A port compiled with others than the
 * core refers to a name that the core does not define, and does not link. */
#ifdef TD_REAL_FLOAT
#define TD_PRECISION float
#else
#define TD_PRECISION double
#endif
#define TD_NAMED(precision, samples, speeds, grips, longest, window, latency, records)                       \
    td_device_of_##precision##_##samples##_samples_##speeds##_speeds_##grips##_grips_##longest##_longest_##window \
        ##_window_##latency##_latency_##records##_records
#define TD_EXPANDED(precision, samples, speeds, grips, longest, window, latency, records) \
    TD_NAMED(precision, samples, speeds, grips, longest, window, latency, records)
#define TD_DEVICE_BYTES                                                                                          \
    TD_EXPANDED(TD_PRECISION, TD_MAX_LIBRARY_SAMPLES, TD_MAX_SPEEDS, TD_MAX_GRIPS, TD_MAX_SAMPLES, TD_MAX_WINDOW_TICKS, \
                TD_MAX_LATENCY_TICKS, TD_MAX_RECORDS)

extern const size_t TD_DEVICE_BYTES;

void td_device_begin(td_device *device, const td_port *port, const size_t *bytes);

static inline void td_device_start(td_device *device, const td_port *port)
{
    td_device_begin(device, port, &TD_DEVICE_BYTES);
}

void td_device_receive(td_device *device, const uint8_t *bytes, size_t size);

/* One servo period. `readings.tick` is one more each time, also after a period that was missed: records that wait to be sent
 * are numbered by the newest. A period missed is `readings.late`, also while the amplifier is off: the ticks are a record's
 * times. */
void td_device_step(td_device *device, const td_readings *readings, td_output *output);

/* Write at most `room` bytes that wait to be sent; returns their number. */
size_t td_device_send(td_device *device, uint8_t *bytes, size_t room);

/* Coil temperatures of the hardware's guard, to be kept over a restart; NaN if the motor's coil is not known. Call it
 * outside of the interrupt, which it masks so that both are of one tick. */
void td_device_coil(const td_device *device, double *winding_C, double *housing_C);

uint8_t td_device_state(const td_device *device); /* TD_STATE_... */
uint8_t td_device_fault(const td_device *device); /* TD_WHAT_..., 0 without */

/* For the core itself, between hold(true) and hold(false). */

/* Bits of evidence; all of them on a simulated device. */
uint8_t td_device_evidence(const td_device *device);

/* Where the body of the next frame is written. */
static inline uint8_t *td_device_body(td_device *device)
{
    return device->payload + TD_HEADER_BYTES;
}

/* Whether a host was heard recently enough. */
bool td_device_is_heard(const td_device *device);

/* Whether the state is ARMED or PLAYING. */
bool td_device_is_active(const td_device *device);

/* Number of servo periods in a duration, rounded. */
int32_t td_device_ticks(const td_device *device, double duration_ms);

/* The host is gone, so nothing may play: disarm, cut a pulse, and report it. */
void td_device_give_up(td_device *device);

/* End a pulse before its time. */
void td_device_cut_pulse(td_device *device);

#endif
