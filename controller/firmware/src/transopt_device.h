/* The one header that a sketch includes; td_device.h tells how the device is used. */
#ifndef TRANSOPT_DEVICE_H
#define TRANSOPT_DEVICE_H

#include "transopt_port.h"

#include <math.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>

#ifdef __cplusplus
extern "C" {
#endif

#include "core/td_device.h"

#ifdef __cplusplus
}
#endif

#endif
