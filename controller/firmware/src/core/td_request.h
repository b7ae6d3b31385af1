/* Requests of the host; each is executed once or refused. */
#ifndef TD_REQUEST_H
#define TD_REQUEST_H

#include "td_device.h"

/* Execute a request. Its kind must be one of a host's, with a body of the right length. */
td_refusal td_request(td_device *device, uint8_t kind, const uint8_t *body, size_t size);

#endif
