/* Configuration and library of a device: the active ones, and those arriving. Nothing is activated before it has arrived
 * completely and been checked. */
#ifndef TD_STORE_H
#define TD_STORE_H

#include "td_check.h"

typedef struct {
    bool configured;
    uint8_t draft[TD_CONFIGURATION_BYTES]; /* arriving configuration */
    td_config config; /* active configuration */
    uint8_t configuration_sha256[TD_HASH_BYTES], library_sha256[TD_HASH_BYTES]; /* zero if there is none */
    uint8_t images[2][TD_MAX_IMAGE_BYTES];
    td_bank banks[2];
    int32_t current;     /* index of the active image */
    size_t size;         /* its size; 0 without a library */
    size_t arrived;      /* bytes of the arriving image so far */
    uint32_t length;     /* its announced length; 0 if none is arriving */
    uint8_t sha256[TD_HASH_BYTES];
} td_store;

/* Store a part of the arriving configuration. */
td_refusal td_store_configure(td_store *store, uint32_t offset, const uint8_t *bytes, size_t size);

/* Check the draft; if it is valid, return its contents and whether the active library fits it. */
td_refusal td_store_check_config(
    td_store *store, const uint8_t *sha256, const td_hardware *hardware, td_config *config, bool *fits);

/* Activate the checked draft, and drop the library if it does not fit. */
void td_store_configured(td_store *store, const uint8_t *sha256, const td_config *config, bool fits);

/* Bank of the active library; NULL without one. */
const td_bank *td_store_bank(const td_store *store);

/* Memory of TD_MAX_IMAGE_BYTES that is free until an image arrives; NULL while one is arriving in this session. Without
 * that, what an upload left that was cut off is forgotten: whoever does not finish it would else have little memory for
 * records until the next start. */
uint8_t *td_store_spare(td_store *store, bool arrives);

/* Begin an image; `arrived` then tells where to continue, if it was interrupted or is active already. */
td_refusal td_store_begin(td_store *store, uint32_t length, const uint8_t *sha256);

/* Store a part of the image if it is the next one. */
void td_store_take(td_store *store, uint32_t offset, const uint8_t *bytes, size_t size);

/* Check the arrived image; it is discarded if it is invalid. */
td_refusal td_store_check_image(td_store *store);

/* Activate the checked image. */
void td_store_committed(td_store *store);

#endif
