/* What a device keeps: the configuration and the library in force, and the ones that are arriving. Nothing is in force
 * before it has arrived whole and been checked. */
#ifndef TD_STORE_H
#define TD_STORE_H

#include "td_check.h"

typedef struct {
    bool configured;
    uint8_t draft[TD_CONFIGURATION_BYTES]; /* arriving */
    td_config config; /* in force */
    uint8_t configuration_sha256[TD_HASH_BYTES], library_sha256[TD_HASH_BYTES]; /* zero for what is not there */
    uint8_t images[2][TD_MAX_IMAGE_BYTES];
    td_bank banks[2];
    int32_t current;     /* of the two, the one in force */
    size_t size;         /* of it; 0 without a library */
    size_t arrived;      /* bytes of the other */
    uint32_t length;     /* announced for it */
    uint8_t sha256[TD_HASH_BYTES];
} td_store;

/* A part of the coming configuration. */
td_refusal td_store_configure(td_store *store, uint32_t offset, const uint8_t *bytes, size_t size);

/* Whether the draft could be in force; then what it says, and whether the library in force fits it. */
td_refusal td_store_check_config(
    td_store *store, const uint8_t *sha256, const td_hardware *hardware, td_config *config, bool *fits);

/* Put the checked draft in force, and the library out of force if it does not fit. */
void td_store_configured(td_store *store, const uint8_t *sha256, const td_config *config, bool fits);

/* The bank in force, NULL without. */
const td_bank *td_store_bank(const td_store *store);

/* Memory of TD_MAX_IMAGE_BYTES in which nothing is kept until an image is coming; NULL while one is. */
uint8_t *td_store_spare(td_store *store);

/* An image is coming; `arrived` then says from where it goes on, if it was interrupted or is in force already. */
td_refusal td_store_begin(td_store *store, uint32_t length, const uint8_t *sha256);

/* A part of the image, if it is the next one. */
void td_store_take(td_store *store, uint32_t offset, const uint8_t *bytes, size_t size);

/* Whether the image that has arrived could be in force; used up if not. */
td_refusal td_store_check_image(td_store *store);

/* Put the checked image in force. */
void td_store_committed(td_store *store);

#endif
