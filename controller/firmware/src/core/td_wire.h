/* Frames on a byte stream: COBS(payload + CRC-32) + 0x00 (controller/protocol/wire.py, byte for byte). */
#ifndef TD_WIRE_H
#define TD_WIRE_H

#include "td_messages.h"
#include "td_real.h"

/* CRC-32 as in zlib (IEEE 802.3); start with crc = 0, continue with the last result. */
uint32_t td_crc32(uint32_t crc, const uint8_t *bytes, size_t size);

/* Encode a payload of at most TD_PAYLOAD_LIMIT bytes as a frame with its delimiter; `frame` has room for TD_FRAME_LIMIT
 * bytes. Returns the frame's length. */
size_t td_wire_encode(const uint8_t *payload, size_t size, uint8_t *frame);

/* An unfinished frame, and numbers of the frames so far. */
typedef struct {
    uint8_t held[TD_FRAME_LIMIT - 1];
    size_t size;
    bool overlong; /* longer than any frame: discarded up to the next delimiter */
    uint32_t frames, bad_frames; /* modulo 2^32; two delimiters in a row are neither */
} td_decoder;

void td_decoder_start(td_decoder *decoder);

/* Take one byte. If it completes an intact frame, return the length of its payload, which stays in `held` until the next
 * call; else 0. */
size_t td_decoder_take(td_decoder *decoder, uint8_t byte);

#endif
