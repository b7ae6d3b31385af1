#include "td_outbox.h"

#include <float.h>
#include <math.h>

#include "td_bytes.h"

void td_output_put(td_output_bytes *output, const uint8_t *bytes, size_t size)
{
    size_t last, until_end;

    if (size > sizeof output->bytes - output->size) {
        output->lost++;
        return;
    }
    last = (output->first + output->size) % sizeof output->bytes;
    until_end = sizeof output->bytes - last;
    if (size <= until_end) {
        memcpy(output->bytes + last, bytes, size);
    } else {
        memcpy(output->bytes + last, bytes, until_end);
        memcpy(output->bytes, bytes + until_end, size - until_end);
    }
    output->size += size;
}

bool td_output_has_room(const td_output_bytes *output)
{
    return sizeof output->bytes - output->size >= 4 * TD_FRAME_LIMIT;
}

size_t td_output_take(td_output_bytes *output, uint8_t *bytes, size_t room)
{
    const size_t size = output->size < room ? output->size : room, until_end = sizeof output->bytes - output->first;

    if (size <= until_end) {
        memcpy(bytes, output->bytes + output->first, size);
    } else {
        memcpy(bytes, output->bytes + output->first, until_end);
        memcpy(bytes + until_end, output->bytes, size - until_end);
    }
    output->first = (output->first + size) % sizeof output->bytes;
    output->size -= size;
    return size;
}

void td_events_start(td_events *events, int32_t repeat_ticks)
{
    memset(events, 0, sizeof *events);
    events->repeat_ticks = repeat_ticks;
}

void td_events_put(td_events *events, const td_event *event)
{
    td_told *told;

    if (events->size == TD_EVENT_QUEUE) {
        if (events->lost < UINT16_MAX)
            events->lost++;
        return;
    }
    told = &events->queue[(events->first + events->size++) % TD_EVENT_QUEUE];
    told->number = events->number++;
    told->lost = events->lost;
    told->event = *event;
}

void td_events_acknowledge(td_events *events, uint32_t wanted)
{
    while (events->size > 0 && events->queue[events->first].number < wanted && wanted <= events->number) {
        events->first = (events->first + 1) % TD_EVENT_QUEUE;
        events->size--;
        if (events->sent > 0)
            events->sent--;
        events->age = 0;
    }
}

void td_events_restart(td_events *events)
{
    events->sent = events->age = 0;
}

uint32_t td_events_oldest(const td_events *events)
{
    return events->size > 0 ? events->queue[events->first].number : events->number;
}

void td_events_tick(td_events *events)
{
    if (events->sent > 0) {
        events->age++;
        if (events->age >= events->repeat_ticks)
            td_events_restart(events);
    }
}

const td_told *td_events_due(td_events *events)
{
    if (events->sent >= events->size || events->sent >= TD_EVENT_WINDOW)
        return NULL;
    return &events->queue[(events->first + events->sent++) % TD_EVENT_QUEUE];
}

void td_records_restart(td_records *records, uint16_t every, uint16_t before, uint8_t *lent, size_t bytes)
{
    records->every = every;
    records->skip = 0;
    records->first = records->size = 0;
    records->next = records->passed = 0;
    records->lent = lent;
    records->capacity = TD_MAX_RECORDS + (lent == NULL ? 0 : (int32_t)(bytes / TD_KEPT_BYTES));
    records->before = before < records->capacity ? before : records->capacity;
}

void td_records_give_back(td_records *records)
{
    if (records->lent == NULL)
        return;
    records->first = records->size = 0;
    records->lent = NULL;
    records->capacity = TD_MAX_RECORDS;
    if (records->before > records->capacity)
        records->before = records->capacity;
}

/* Place of the record that is `behind` records younger than the oldest. */
static uint8_t *kept(td_records *records, int32_t behind)
{
    int32_t at = records->first + behind;

    if (at >= records->capacity)
        at -= records->capacity;
    return at < TD_MAX_RECORDS ? records->own[at] : records->lent + (size_t)(at - TD_MAX_RECORDS) * TD_KEPT_BYTES;
}

/* As float32; infinite beyond its range. */
static float narrow(td_real value)
{
    if (value > (td_real)FLT_MAX)
        return (float)INFINITY;
    if (value < -(td_real)FLT_MAX)
        return -(float)INFINITY;
    return (float)value;
}

static void write_record(uint8_t *at, const td_readings *readings, const td_output *output, td_real command_A)
{
    td_put_u32(at + TD_RECORD_ENCODER_COUNTS, (uint32_t)readings->encoder_counts);
    td_put_f32(at + TD_RECORD_GRIP_N, narrow(readings->grip_N));
    td_put_f32(at + TD_RECORD_MEASURED_CURRENT_A, narrow(readings->current_A));
    td_put_f32(at + TD_RECORD_ACCELERATION_M_S2, narrow(readings->acceleration_m_s2));
    td_put_f32(at + TD_RECORD_COMMAND_A, narrow(command_A));
    td_put_f32(at + TD_RECORD_TRANSIENT_A, narrow(output->transient_A));
    td_put_f32(at + TD_RECORD_FEEDBACK_A, narrow(output->feedback_A));
    td_put_f32(at + TD_RECORD_WINDING_C, narrow(output->winding_C));
    at[TD_RECORD_STATE] = output->state;
    at[TD_RECORD_FLAGS] = readings->emergency_stop;
}

static void drop(td_records *records, int32_t count)
{
    records->first += count;
    if (records->first >= records->capacity)
        records->first -= records->capacity;
    records->size -= count;
}

void td_records_step(td_records *records, const td_readings *readings, const td_output *output, td_real command_A,
                     bool heard)
{
    uint8_t *at;

    if (records->every == 0)
        return;
    if (records->skip == 0) {
        records->skip = records->every;
        if (output->state == TD_STATE_PLAYING)
            records->before = 0;
        if (records->before > 0 && records->size == records->before)
            drop(records, 1);
        /* The first record sent must have the number 0. */
        if (records->before > 0)
            records->passed = records->size > 0 ? td_get_u32(kept(records, 0)) : records->next;
        if (heard && records->size < records->capacity) {
            at = kept(records, records->size++);
            td_put_u32(at, records->next);
            write_record(at + 4, readings, output, command_A);
        }
        records->next++;
        records->tick = readings->tick;
    }
    records->skip--;
}

size_t td_records_take(td_records *records, uint64_t tick, uint8_t *body)
{
    uint8_t *at = body + TD_TELEMETRY_DATA_RECORDS;
    uint32_t number;
    uint64_t first_tick;
    int32_t count = 0;

    if (records->size == 0 || records->before > 0)
        return 0;
    number = td_get_u32(kept(records, 0));
    first_tick = records->tick - (uint64_t)(records->next - 1 - number) * records->every;
    if (records->size < TD_RECORDS_LIMIT && tick - first_tick + 1 < (uint64_t)records->hold_ticks)
        return 0;
    td_put_u32(body + TD_TELEMETRY_DATA_FIRST, number - records->passed);
    td_put_u64(body + TD_TELEMETRY_DATA_TICK, first_tick);
    td_put_u16(body + TD_TELEMETRY_DATA_EVERY, records->every);
    for (; count < records->size && count < TD_RECORDS_LIMIT; count++, at += TD_RECORD_BYTES) {
        const uint8_t *record = kept(records, count);

        /* The records of a frame have no gap. */
        if (td_get_u32(record) != number + (uint32_t)count)
            break;
        memcpy(at, record + 4, TD_RECORD_BYTES);
    }
    drop(records, count);
    return (size_t)(at - body);
}
