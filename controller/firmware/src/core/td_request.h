/* What the host may ask a device for; each is carried out once or refused. */
#ifndef TD_REQUEST_H
#define TD_REQUEST_H

#include "td_device.h"

/* Carry out a request, of a kind that a host may send and with a body of the length that it has. */
td_refusal td_request(td_device *device, uint8_t kind, const uint8_t *body, size_t size);

#endif
