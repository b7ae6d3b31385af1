/* Little-endian numbers in memory of any alignment. Floating point is IEEE 754 on both sides. */
#ifndef TD_BYTES_H
#define TD_BYTES_H

#include <stdint.h>
#include <string.h>

static inline uint16_t td_get_u16(const uint8_t *at)
{
    return (uint16_t)(at[0] | (unsigned)at[1] << 8);
}

static inline uint32_t td_get_u32(const uint8_t *at)
{
    return (uint32_t)at[0] | (uint32_t)at[1] << 8 | (uint32_t)at[2] << 16 | (uint32_t)at[3] << 24;
}

static inline uint64_t td_get_u64(const uint8_t *at)
{
    return (uint64_t)td_get_u32(at) | (uint64_t)td_get_u32(at + 4) << 32;
}

static inline int8_t td_get_i8(const uint8_t *at)
{
    int8_t value;

    memcpy(&value, at, sizeof value);
    return value;
}

static inline int16_t td_get_i16(const uint8_t *at)
{
    const uint16_t bits = td_get_u16(at);
    int16_t value;

    memcpy(&value, &bits, sizeof value);
    return value;
}

static inline int32_t td_get_i32(const uint8_t *at)
{
    const uint32_t bits = td_get_u32(at);
    int32_t value;

    memcpy(&value, &bits, sizeof value);
    return value;
}

static inline double td_get_f64(const uint8_t *at)
{
    const uint64_t bits = td_get_u64(at);
    double value;

    memcpy(&value, &bits, sizeof value);
    return value;
}

static inline void td_put_u16(uint8_t *at, uint16_t value)
{
    at[0] = (uint8_t)(value & 0xff);
    at[1] = (uint8_t)(value >> 8);
}

static inline void td_put_u32(uint8_t *at, uint32_t value)
{
    td_put_u16(at, (uint16_t)(value & 0xffff));
    td_put_u16(at + 2, (uint16_t)(value >> 16));
}

static inline void td_put_u64(uint8_t *at, uint64_t value)
{
    td_put_u32(at, (uint32_t)(value & 0xffffffffu));
    td_put_u32(at + 4, (uint32_t)(value >> 32));
}

static inline void td_put_f32(uint8_t *at, float value)
{
    uint32_t bits;

    memcpy(&bits, &value, sizeof bits);
    td_put_u32(at, bits);
}

static inline void td_put_f64(uint8_t *at, double value)
{
    uint64_t bits;

    memcpy(&bits, &value, sizeof bits);
    td_put_u64(at, bits);
}

#endif
