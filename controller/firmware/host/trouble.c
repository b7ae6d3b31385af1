#include "trouble.h"

#include <math.h>
#include <string.h>

void trouble_start(trouble *line, double delay_s, double loss, double corruption, uint64_t seed)
{
    memset(line, 0, sizeof *line);
    line->delay_s = delay_s;
    line->loss = loss;
    line->corruption = corruption;
    line->random = seed * 2 + 1;
}

/* xorshift64* (Vigna 2016), 0 to 1. */
static double uniform(trouble *line)
{
    line->random ^= line->random >> 12;
    line->random ^= line->random << 25;
    line->random ^= line->random >> 27;
    return (double)((line->random * UINT64_C(2685821657736338717)) >> 11) * 0x1p-53;
}

static void pass(trouble *line, double now_s)
{
    const size_t size = line->held_size;
    size_t j, last;

    line->held_size = 0;
    if (uniform(line) < line->loss || line->frame_count == TROUBLE_FRAMES || size > TROUBLE_BYTES - line->size)
        return;
    if (uniform(line) < line->corruption)
        line->held[(size_t)(uniform(line) * (double)size)] ^= (uint8_t)(1 + (int)(uniform(line) * 255));
    last = (line->first_frame + line->frame_count++) % TROUBLE_FRAMES;
    line->frames[last].due_s = now_s + line->delay_s;
    line->frames[last].size = size;
    for (j = 0; j < size; j++)
        line->bytes[(line->first + line->size++) % TROUBLE_BYTES] = line->held[j];
}

void trouble_enter(trouble *line, const uint8_t *bytes, size_t size, double now_s)
{
    for (; size > 0; size--, bytes++) {
        line->held[line->held_size++] = *bytes;
        if (*bytes == 0 || line->held_size == TROUBLE_FRAME_BYTES)
            pass(line, now_s);
    }
}

size_t trouble_leave(trouble *line, uint8_t *bytes, size_t room, double now_s)
{
    size_t left = 0, j;

    while (line->frame_count > 0 && line->frames[line->first_frame].due_s <= now_s &&
           line->frames[line->first_frame].size <= room - left) {
        const size_t size = line->frames[line->first_frame].size;

        for (j = 0; j < size; j++)
            bytes[left++] = line->bytes[(line->first + j) % TROUBLE_BYTES];
        line->first = (line->first + size) % TROUBLE_BYTES;
        line->size -= size;
        line->first_frame = (line->first_frame + 1) % TROUBLE_FRAMES;
        line->frame_count--;
    }
    return left;
}

double trouble_next_s(const trouble *line)
{
    return line->frame_count > 0 ? line->frames[line->first_frame].due_s : (double)INFINITY;
}
