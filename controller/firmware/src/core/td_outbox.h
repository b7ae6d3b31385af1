/* What a device tells on its own: events until they are acknowledged, telemetry once; and the bytes that wait to
 * go out. */
#ifndef TD_OUTBOX_H
#define TD_OUTBOX_H

#include "td_interface.h"
#include "td_port.h"

#ifndef TD_OUTPUT_LIMIT_BYTES
#define TD_OUTPUT_LIMIT_BYTES 65536 /* telemetry that nobody fetches is dropped beyond */
#endif
#define TD_OUTPUT_BYTES (TD_OUTPUT_LIMIT_BYTES + 16 * TD_FRAME_LIMIT) /* answers and events beyond this */

typedef struct {
    uint8_t bytes[TD_OUTPUT_BYTES]; /* ring */
    size_t first, size;
    uint32_t lost; /* frames that found no room, modulo 2^32 */
} td_output_bytes;

/* A frame goes in whole or not at all. */
void td_output_put(td_output_bytes *output, const uint8_t *bytes, size_t size);

/* At most `room` bytes, oldest first; how many. */
size_t td_output_take(td_output_bytes *output, uint8_t *bytes, size_t room);

typedef struct {
    uint32_t number;
    uint16_t lost; /* events before this one that found no room */
    td_event event;
} td_told;

/* Events in order, numbered without gaps; the oldest few are in flight, again and again until acknowledged. */
typedef struct {
    td_told queue[TD_EVENT_QUEUE]; /* ring */
    int32_t first, size, sent;
    int32_t age, repeat_ticks; /* of the oldest in flight; after how many it goes out again */
    uint32_t number;           /* of the next event */
    uint16_t lost;
} td_events;

void td_events_start(td_events *events, int32_t repeat_ticks);
void td_events_put(td_events *events, const td_event *event);

/* Everything below `wanted` has arrived; a number that is not in the queue means nothing. */
void td_events_acknowledge(td_events *events, uint32_t wanted);

/* Send all that is not acknowledged once more. */
void td_events_restart(td_events *events);

/* Number of the first event not acknowledged, of the next one if all are. */
uint32_t td_events_oldest(const td_events *events);

/* One tick passes while somebody listens. */
void td_events_tick(td_events *events);

/* The next one that is to be sent in this tick, NULL after the last. */
const td_told *td_events_due(td_events *events);

/* Telemetry records of every n-th tick, sent when a frame is full or the first has waited long enough. */
typedef struct {
    uint8_t records[TD_RECORDS_LIMIT * TD_RECORD_BYTES];
    int32_t size; /* records */
    int32_t age, hold_ticks;
    uint16_t every, skip; /* every: 0 for none */
    uint32_t first;       /* number of the first record held */
    uint64_t tick;        /* of it */
} td_records;

/* One record every so many ticks from now on, numbered from 0. */
void td_records_restart(td_records *records, uint16_t every);

/* One tick; whether the records held are to be sent now, and then td_records_sent is to be called. */
bool td_records_step(td_records *records, const td_readings *readings, const td_output *output);
void td_records_sent(td_records *records);

#endif
