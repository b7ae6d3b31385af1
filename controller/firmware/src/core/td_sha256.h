/* SHA-256 (FIPS 180-4) of data that arrive in pieces. */
#ifndef TD_SHA256_H
#define TD_SHA256_H

#include <stddef.h>
#include <stdint.h>

#define TD_SHA256_BYTES 32
#define TD_SHA256_BLOCK 64

typedef struct {
    uint32_t state[8];
    uint64_t size; /* bytes so far */
    uint8_t block[TD_SHA256_BLOCK];
} td_sha256;

void td_sha256_start(td_sha256 *hash);
void td_sha256_add(td_sha256 *hash, const uint8_t *bytes, size_t size);
void td_sha256_end(td_sha256 *hash, uint8_t digest[TD_SHA256_BYTES]);

/* Hash of data in one piece. */
void td_sha256_of(const uint8_t *bytes, size_t size, uint8_t digest[TD_SHA256_BYTES]);

#endif
