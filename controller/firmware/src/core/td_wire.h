/* Frames on a byte stream: COBS(payload + CRC-32) + 0x00 (controller/protocol/wire.py, byte for byte). */
#ifndef TD_WIRE_H
#define TD_WIRE_H

#include "td_messages.h"
#include "td_real.h"

/* CRC-32 as zlib's (IEEE 802.3); begin with crc = 0, go on with what came out. */
uint32_t td_crc32(uint32_t crc, const uint8_t *bytes, size_t size);

/* One frame, delimiter included, of a payload of at most TD_PAYLOAD_LIMIT bytes; `frame` has room for TD_FRAME_LIMIT.
 * Returns the frame's length. */
size_t td_wire_encode(const uint8_t *payload, size_t size, uint8_t *frame);

/* One unfinished frame and what came of the ones before. */
typedef struct {
    uint8_t held[TD_FRAME_LIMIT - 1];
    size_t size;
    bool overlong; /* more came than any frame has: thrown away up to the next delimiter */
    uint32_t frames, bad_frames; /* modulo 2^32; two delimiters in a row are neither */
} td_decoder;

void td_decoder_start(td_decoder *decoder);

/* One byte. If it completes a sound frame: its payload's length, and the payload stands in `held` until the next
 * call; else 0. */
size_t td_decoder_take(td_decoder *decoder, uint8_t byte);

#endif
