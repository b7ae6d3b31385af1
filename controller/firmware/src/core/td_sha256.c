#include "td_sha256.h"

#include <string.h>

static uint32_t rotated(uint32_t value, int by)
{
    return value >> by | value << (32 - by);
}

static uint32_t big_endian(const uint8_t *at)
{
    return (uint32_t)at[0] << 24 | (uint32_t)at[1] << 16 | (uint32_t)at[2] << 8 | (uint32_t)at[3];
}

/* One block; the message schedule is kept as a ring of its last 16 words. */
static void compress(uint32_t state[8], const uint8_t *block)
{
    /* Fractional parts of the cube roots of the first 64 primes. */
    static const uint32_t constants[64] = {
        0x428a2f98u, 0x71374491u, 0xb5c0fbcfu, 0xe9b5dba5u, 0x3956c25bu, 0x59f111f1u, 0x923f82a4u, 0xab1c5ed5u,
        0xd807aa98u, 0x12835b01u, 0x243185beu, 0x550c7dc3u, 0x72be5d74u, 0x80deb1feu, 0x9bdc06a7u, 0xc19bf174u,
        0xe49b69c1u, 0xefbe4786u, 0x0fc19dc6u, 0x240ca1ccu, 0x2de92c6fu, 0x4a7484aau, 0x5cb0a9dcu, 0x76f988dau,
        0x983e5152u, 0xa831c66du, 0xb00327c8u, 0xbf597fc7u, 0xc6e00bf3u, 0xd5a79147u, 0x06ca6351u, 0x14292967u,
        0x27b70a85u, 0x2e1b2138u, 0x4d2c6dfcu, 0x53380d13u, 0x650a7354u, 0x766a0abbu, 0x81c2c92eu, 0x92722c85u,
        0xa2bfe8a1u, 0xa81a664bu, 0xc24b8b70u, 0xc76c51a3u, 0xd192e819u, 0xd6990624u, 0xf40e3585u, 0x106aa070u,
        0x19a4c116u, 0x1e376c08u, 0x2748774cu, 0x34b0bcb5u, 0x391c0cb3u, 0x4ed8aa4au, 0x5b9cca4fu, 0x682e6ff3u,
        0x748f82eeu, 0x78a5636fu, 0x84c87814u, 0x8cc70208u, 0x90befffau, 0xa4506cebu, 0xbef9a3f7u, 0xc67178f2u,
    };
    uint32_t a = state[0], b = state[1], c = state[2], d = state[3];
    uint32_t e = state[4], f = state[5], g = state[6], h = state[7];
    uint32_t w[16];
    int t;

    for (t = 0; t < 64; t++) {
        uint32_t sum, choice, majority, early, late;

        if (t < 16) {
            w[t] = big_endian(block + 4 * t);
        } else {
            early = w[(t + 1) & 15];
            late = w[(t + 14) & 15];
            w[t & 15] += (rotated(early, 7) ^ rotated(early, 18) ^ early >> 3) + w[(t + 9) & 15] +
                         (rotated(late, 17) ^ rotated(late, 19) ^ late >> 10);
        }
        choice = (e & f) ^ (~e & g);
        majority = (a & b) ^ (a & c) ^ (b & c);
        sum = h + (rotated(e, 6) ^ rotated(e, 11) ^ rotated(e, 25)) + choice + constants[t] + w[t & 15];
        h = g;
        g = f;
        f = e;
        e = d + sum;
        d = c;
        c = b;
        b = a;
        a = sum + (rotated(b, 2) ^ rotated(b, 13) ^ rotated(b, 22)) + majority;
    }
    state[0] += a;
    state[1] += b;
    state[2] += c;
    state[3] += d;
    state[4] += e;
    state[5] += f;
    state[6] += g;
    state[7] += h;
}

void td_sha256_start(td_sha256 *hash)
{
    /* Fractional parts of the square roots of the first 8 primes. */
    static const uint32_t start[8] = {
        0x6a09e667u, 0xbb67ae85u, 0x3c6ef372u, 0xa54ff53au, 0x510e527fu, 0x9b05688cu, 0x1f83d9abu, 0x5be0cd19u,
    };

    memcpy(hash->state, start, sizeof start);
    hash->size = 0;
}

void td_sha256_add(td_sha256 *hash, const uint8_t *bytes, size_t size)
{
    size_t held = (size_t)(hash->size % TD_SHA256_BLOCK);

    hash->size += size;
    if (held > 0 && held + size >= TD_SHA256_BLOCK) {
        memcpy(hash->block + held, bytes, TD_SHA256_BLOCK - held);
        compress(hash->state, hash->block);
        bytes += TD_SHA256_BLOCK - held;
        size -= TD_SHA256_BLOCK - held;
        held = 0;
    }
    if (held == 0) {
        for (; size >= TD_SHA256_BLOCK; size -= TD_SHA256_BLOCK, bytes += TD_SHA256_BLOCK)
            compress(hash->state, bytes);
    }
    if (size > 0)
        memcpy(hash->block + held, bytes, size);
}

void td_sha256_end(td_sha256 *hash, uint8_t digest[TD_SHA256_BYTES])
{
    const uint64_t bits = 8 * hash->size;
    const uint8_t one = 0x80, none = 0;
    uint8_t length[8];
    int j;

    for (j = 0; j < 8; j++)
        length[j] = (uint8_t)(bits >> (56 - 8 * j) & 0xff);
    td_sha256_add(hash, &one, 1);
    while (hash->size % TD_SHA256_BLOCK != TD_SHA256_BLOCK - sizeof length)
        td_sha256_add(hash, &none, 1);
    td_sha256_add(hash, length, sizeof length);
    for (j = 0; j < TD_SHA256_BYTES; j++)
        digest[j] = (uint8_t)(hash->state[j / 4] >> (24 - 8 * (j % 4)) & 0xff);
}

void td_sha256_of(const uint8_t *bytes, size_t size, uint8_t digest[TD_SHA256_BYTES])
{
    td_sha256 hash;

    td_sha256_start(&hash);
    td_sha256_add(&hash, bytes, size);
    td_sha256_end(&hash, digest);
}
