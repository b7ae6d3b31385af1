/* Messages that a device sends unasked: events until they are acknowledged, telemetry once; and the bytes waiting to be
 * sent. */
#ifndef TD_OUTBOX_H
#define TD_OUTBOX_H

#include "td_interface.h"
#include "td_port.h"

#ifndef TD_MAX_RECORDS
#define TD_MAX_RECORDS 2048 /* telemetry records in the device's own ring; further ones are dropped */
#endif
#define TD_OUTPUT_BYTES (16 * TD_FRAME_LIMIT)

typedef struct {
    uint8_t bytes[TD_OUTPUT_BYTES]; /* ring */
    size_t first, size;
    uint32_t lost; /* frames that found no room, modulo 2^32 */
} td_output_bytes;

/* Queue a frame, whole or not at all. */
void td_output_put(td_output_bytes *output, const uint8_t *bytes, size_t size);

/* Whether a frame of any length fits, with room left for replies. */
bool td_output_has_room(const td_output_bytes *output);

/* Take at most `room` bytes, oldest first; returns their number. */
size_t td_output_take(td_output_bytes *output, uint8_t *bytes, size_t room);

typedef struct {
    uint32_t number;
    uint16_t lost; /* events before this one that found no room */
    td_event event;
} td_told;

/* Events in order, numbered without gaps; the oldest few are in flight and repeated until acknowledged. */
typedef struct {
    td_told queue[TD_EVENT_QUEUE]; /* ring */
    int32_t first, size, sent;
    int32_t age, repeat_ticks; /* age of the oldest event in flight, and age at which it is repeated */
    uint32_t number;           /* number of the next event */
    uint16_t lost;
} td_events;

void td_events_start(td_events *events, int32_t repeat_ticks);
void td_events_put(td_events *events, const td_event *event);

/* All events below `wanted` have arrived; a number outside of the queue is ignored. */
void td_events_acknowledge(td_events *events, uint32_t wanted);

/* Repeat all unacknowledged events. */
void td_events_restart(td_events *events);

/* Number of the oldest unacknowledged event, or of the next one if there is none. */
uint32_t td_events_oldest(const td_events *events);

/* One tick while a host listens. */
void td_events_tick(td_events *events);

/* The next event to send in this tick; NULL after the last. */
const td_told *td_events_due(td_events *events);

#define TD_KEPT_BYTES (4 + TD_RECORD_BYTES) /* a record with its number; numbers have gaps where there was no room */

/* Telemetry records of every n-th tick: a ring that the tick fills. Frames are made outside of the tick, when they are
 * full or when the oldest record has waited long enough. The ring extends into lent memory, so that records which a slow
 * line does not carry are sent later. If requested, it starts with a waveform and a number of records before it. */
typedef struct {
    uint8_t own[TD_MAX_RECORDS][TD_KEPT_BYTES];
    uint8_t *lent;    /* NULL if there is none */
    int32_t capacity; /* records, including those in lent memory */
    int32_t first, size;
    int32_t hold_ticks;
    uint16_t every, skip; /* every: 0 for none */
    int32_t before;       /* number of newest records that are kept, none sent, until a waveform plays; or 0 */
    uint32_t passed;      /* records dropped before the waveform */
    uint32_t next;        /* number of the next record */
    uint64_t tick;        /* tick of the last record */
} td_records;

/* Start one record per `every` ticks, numbered from 0. `before`: if not 0, wait for a waveform, see above. `lent`: memory
 * of `bytes` bytes for further records, or NULL. */
void td_records_restart(td_records *records, uint16_t every, uint16_t before, uint8_t *lent, size_t bytes);

/* Return the lent memory: all waiting records are lost, which the gap in the numbers shows. */
void td_records_give_back(td_records *records);

/* One tick. `heard`: a host listens. `command_A`: the command applied. */
void td_records_step(td_records *records, const td_readings *readings, const td_output *output, td_real command_A,
                     bool heard);

/* Write the body of the next frame if one is due at this tick; returns its length, 0 if none is. */
size_t td_records_take(td_records *records, uint64_t tick, uint8_t *body);

#endif
