/* What a device tells on its own: events until they are acknowledged, telemetry once; and the bytes that wait to
 * go out. */
#ifndef TD_OUTBOX_H
#define TD_OUTBOX_H

#include "td_interface.h"
#include "td_port.h"

#ifndef TD_MAX_RECORDS
#define TD_MAX_RECORDS 2048 /* of telemetry; what nobody fetches is dropped beyond */
#endif
#define TD_OUTPUT_BYTES (16 * TD_FRAME_LIMIT)

typedef struct {
    uint8_t bytes[TD_OUTPUT_BYTES]; /* ring */
    size_t first, size;
    uint32_t lost; /* frames that found no room, modulo 2^32 */
} td_output_bytes;

/* A frame goes in whole or not at all. */
void td_output_put(td_output_bytes *output, const uint8_t *bytes, size_t size);

/* Whether any frame fits, with some room left for answers. */
bool td_output_has_room(const td_output_bytes *output);

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

#define TD_KEPT_BYTES (4 + TD_RECORD_BYTES) /* number of a record, with a gap where there was no room; what is sent of it */

/* Telemetry records of every n-th tick: a ring that the tick fills, and frames are made of outside of it, full ones or
 * where the oldest record has waited long enough. Behind its own memory it uses what it is lent, so that a slow line may
 * send afterwards what it does not carry meanwhile; told to, it begins with a waveform and with what was just before. */
typedef struct {
    uint8_t own[TD_MAX_RECORDS][TD_KEPT_BYTES];
    uint8_t *lent;    /* NULL without */
    int32_t capacity; /* records, those in lent memory included */
    int32_t first, size;
    int32_t hold_ticks;
    uint16_t every, skip; /* every: 0 for none */
    int32_t before;       /* so many of the newest alone are kept until a waveform plays, and none is sent; or 0 */
    uint32_t passed;      /* records that were dropped so */
    uint32_t next;        /* number of the next record */
    uint64_t tick;        /* of the one before it */
} td_records;

/* One record every so many ticks from now on, numbered from 0. `before`: not 0 waits for a waveform, see above. `lent`:
 * memory for more of them, `bytes` long; or NULL. */
void td_records_restart(td_records *records, uint16_t every, uint16_t before, uint8_t *lent, size_t bytes);

/* Lent memory is wanted back: whatever waits is lost, which its numbers tell. */
void td_records_give_back(td_records *records);

/* One tick; `heard`: somebody listens. `command_A`: what was applied. */
void td_records_step(td_records *records, const td_readings *readings, const td_output *output, td_real command_A,
                     bool heard);

/* The body of the next frame, if one is due at this tick; how many bytes, 0 without. */
size_t td_records_take(td_records *records, uint64_t tick, uint8_t *body);

#endif
