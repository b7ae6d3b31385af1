#include "td_store.h"

#include <math.h>
#include <string.h>

#include "td_sha256.h"

static bool is_hash_of(const uint8_t *sha256, const uint8_t *bytes, size_t size)
{
    uint8_t digest[TD_SHA256_BYTES];

    td_sha256_of(bytes, size, digest);
    return memcmp(digest, sha256, sizeof digest) == 0;
}

static uint8_t *arriving(td_store *store)
{
    return store->images[1 - store->current];
}

static void forget(td_store *store)
{
    store->arrived = 0;
    store->length = 0;
    memset(store->sha256, 0, sizeof store->sha256);
}

td_refusal td_store_configure(td_store *store, uint32_t offset, const uint8_t *bytes, size_t size)
{
    if (size == 0 || offset > sizeof store->draft || size > sizeof store->draft - offset)
        return td_refuse(TD_REASON_BAD_OFFSET, offset);
    memcpy(store->draft + offset, bytes, size);
    return td_granted;
}

td_refusal td_store_check_config(
    td_store *store, const uint8_t *sha256, const td_hardware *hardware, td_config *config, bool *fits)
{
    td_refusal found;

    if (!is_hash_of(sha256, store->draft, sizeof store->draft))
        return td_refuse(TD_REASON_WRONG_HASH, (double)NAN);
    found = td_check_config(store->draft, hardware, config);
    *fits = found.reason == 0 && store->size > 0 &&
            td_check_image(store->images[store->current], store->size, config, &store->banks[1 - store->current])
                    .reason == 0;
    return found;
}

void td_store_configured(td_store *store, const uint8_t *sha256, const td_config *config, bool fits)
{
    store->configured = true;
    store->config = *config;
    memcpy(store->configuration_sha256, sha256, sizeof store->configuration_sha256);
    if (!fits) {
        store->size = 0;
        memset(store->library_sha256, 0, sizeof store->library_sha256);
    }
}

const td_bank *td_store_bank(const td_store *store)
{
    return store->size > 0 ? &store->banks[store->current] : NULL;
}

uint8_t *td_store_spare(td_store *store, bool arrives)
{
    if (!arrives)
        forget(store);
    return store->length == 0 ? arriving(store) : NULL;
}

td_refusal td_store_begin(td_store *store, uint32_t length, const uint8_t *sha256)
{
    if (length > TD_MAX_IMAGE_BYTES)
        return td_refuse(TD_REASON_TOO_LARGE, length);
    if (length == store->length && memcmp(sha256, store->sha256, sizeof store->sha256) == 0)
        return td_granted;
    forget(store);
    store->length = length;
    memcpy(store->sha256, sha256, sizeof store->sha256);
    if (length == store->size && memcmp(sha256, store->library_sha256, sizeof store->library_sha256) == 0) {
        /* The active library need not be sent again. */
        memcpy(arriving(store), store->images[store->current], store->size);
        store->arrived = store->size;
    }
    return td_granted;
}

void td_store_take(td_store *store, uint32_t offset, const uint8_t *bytes, size_t size)
{
    if (offset != store->arrived || size > store->length - store->arrived)
        return;
    memcpy(arriving(store) + store->arrived, bytes, size);
    store->arrived += size;
}

td_refusal td_store_check_image(td_store *store)
{
    td_refusal found;

    if (!store->configured)
        return td_refuse(TD_REASON_NO_CONFIGURATION, (double)NAN);
    if (store->length == 0 || store->arrived != store->length)
        return td_refuse(TD_REASON_INCOMPLETE, (double)store->arrived);
    if (!is_hash_of(store->sha256, arriving(store), store->arrived))
        found = td_refuse(TD_REASON_WRONG_HASH, (double)NAN);
    else
        found = td_check_image(
            arriving(store), store->arrived, &store->config, &store->banks[1 - store->current]);
    /* Discarded, so that the next upload does not resume a failed image. */
    if (found.reason != 0)
        forget(store);
    return found;
}

void td_store_committed(td_store *store)
{
    store->current = 1 - store->current;
    store->size = store->arrived;
    memcpy(store->library_sha256, store->sha256, sizeof store->library_sha256);
    forget(store);
}
