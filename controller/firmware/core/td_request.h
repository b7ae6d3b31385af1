/* What the host may ask a device for; each is carried out once or refused (controller/device.py). */
#ifndef TD_REQUEST_H
#define TD_REQUEST_H

#include "td_device.h"

/* Whether a kind of frame is such a question. */
bool td_is_request(uint8_t kind);

/* Carry it out, with a body of a length that has been checked. */
td_refusal td_request(td_device *device, uint8_t kind, const uint8_t *body, size_t size);

#endif
