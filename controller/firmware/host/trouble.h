/* A bad line, one direction of it: frames arrive late, not at all, or with a byte changed. */
#ifndef TROUBLE_H
#define TROUBLE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#define TROUBLE_BYTES (1u << 22) /* under way at once; what comes on top of it is lost */
#define TROUBLE_FRAMES 16384
#define TROUBLE_FRAME_BYTES 2048 /* what goes on for longer without a delimiter is passed on in pieces */

typedef struct {
    double delay_s, loss, corruption; /* parts of the frames */
    uint64_t random;
    uint8_t bytes[TROUBLE_BYTES]; /* ring of frames, oldest first */
    size_t first, size;
    struct {
        double due_s;
        size_t size;
    } frames[TROUBLE_FRAMES]; /* ring */
    size_t first_frame, frame_count;
    uint8_t held[TROUBLE_FRAME_BYTES]; /* of a frame that is not complete */
    size_t held_size;
} trouble;

void trouble_start(trouble *line, double delay_s, double loss, double corruption, uint64_t seed);

/* Bytes enter at this time. */
void trouble_enter(trouble *line, const uint8_t *bytes, size_t size, double now_s);

/* What has come through by now, whole frames of at most `room` bytes together (>= TROUBLE_FRAME_BYTES). */
size_t trouble_leave(trouble *line, uint8_t *bytes, size_t room, double now_s);

/* When the next frame comes through; infinity if none is under way. */
double trouble_next_s(const trouble *line);

#endif
