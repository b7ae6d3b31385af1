#include "td_wire.h"

#include "td_bytes.h"

#define CRC_BYTES 4
#define FULL_RUN 0xff /* code of 254 bytes without a zero after them */

uint32_t td_crc32(uint32_t crc, const uint8_t *bytes, size_t size)
{
    /* Indexed by half a byte: 64 bytes of table instead of 1024, at half the speed. */
    static const uint32_t table[16] = {
        0x00000000u, 0x1db71064u, 0x3b6e20c8u, 0x26d930acu, 0x76dc4190u, 0x6b6b51f4u, 0x4db26158u, 0x5005713cu,
        0xedb88320u, 0xf00f9344u, 0xd6d6a3e8u, 0xcb61b38cu, 0x9b64c2b0u, 0x86d3d2d4u, 0xa00ae278u, 0xbdbdf21cu,
    };

    crc = ~crc;
    for (; size > 0; size--) {
        crc ^= *bytes++;
        crc = crc >> 4 ^ table[crc & 15];
        crc = crc >> 4 ^ table[crc & 15];
    }
    return ~crc;
}

/* COBS, byte by byte; `code` is the place for the length of the present run. */
typedef struct {
    uint8_t *code, *end;
    bool full; /* the last run had 254 bytes; the next byte starts a new run */
} stuffing;

static void stuff(stuffing *to, const uint8_t *bytes, size_t size)
{
    for (; size > 0; size--, bytes++) {
        if (to->full) {
            to->code = to->end++;
            to->full = false;
        }
        if (*bytes != 0)
            *to->end++ = *bytes;
        if (*bytes == 0 || to->end - to->code == FULL_RUN) {
            *to->code = (uint8_t)(to->end - to->code);
            to->full = *bytes != 0;
            if (!to->full)
                to->code = to->end++;
        }
    }
}

size_t td_wire_encode(const uint8_t *payload, size_t size, uint8_t *frame)
{
    stuffing to = {frame, frame + 1, false};
    uint8_t crc[CRC_BYTES];

    td_put_u32(crc, td_crc32(0, payload, size));
    stuff(&to, payload, size);
    stuff(&to, crc, sizeof crc);
    if (!to.full)
        *to.code = (uint8_t)(to.end - to.code);
    *to.end++ = 0;
    return (size_t)(to.end - frame);
}

/* Undo COBS in place; returns the shorter length, 0 if a run points beyond the end. */
static size_t unstuff(uint8_t *bytes, size_t size)
{
    size_t from = 0, to = 0;

    while (from < size) {
        const size_t code = bytes[from];

        if (code > size - from)
            return 0;
        memmove(bytes + to, bytes + from + 1, code - 1);
        to += code - 1;
        from += code;
        if (code != FULL_RUN && from < size)
            bytes[to++] = 0;
    }
    return to;
}

void td_decoder_start(td_decoder *decoder)
{
    decoder->size = 0;
    decoder->overlong = false;
    decoder->frames = decoder->bad_frames = 0;
}

size_t td_decoder_take(td_decoder *decoder, uint8_t byte)
{
    size_t size = decoder->size;

    if (byte != 0) {
        if (size == sizeof decoder->held)
            decoder->overlong = true;
        else
            decoder->held[decoder->size++] = byte;
        return 0;
    }
    decoder->size = 0;
    if (size == 0)
        return 0;
    size = decoder->overlong ? 0 : unstuff(decoder->held, size);
    decoder->overlong = false;
    if (size > CRC_BYTES && size <= TD_PAYLOAD_LIMIT + CRC_BYTES &&
        td_crc32(0, decoder->held, size - CRC_BYTES) == td_get_u32(decoder->held + size - CRC_BYTES)) {
        decoder->frames++;
        return size - CRC_BYTES;
    }
    decoder->bad_frames++;
    return 0;
}
