/* What a device asks of a configuration and of an image before it puts them in force (controller/protocol/configuration.py,
 * image.py): the sender's word is not enough. Not for the timer's interrupt: an image takes milliseconds. */
#ifndef TD_CHECK_H
#define TD_CHECK_H

#include "td_bank.h"
#include "td_config.h"

/* What the amplifier behind the device is good for: no configuration may ask for more. */
typedef struct {
    td_wide current_A, command_A;
    td_wide dt_s; /* servo period of the timer */
} td_hardware;

/* Why not, TD_REASON_..., 0 if nothing speaks against it; and the number that offends, NaN if there is none. */
typedef struct {
    uint8_t reason;
    double value;
} td_refusal;

static const td_refusal td_granted = {0, 0};

static inline td_refusal td_refuse(int reason, double value)
{
    const td_refusal refusal = {(uint8_t)reason, value};

    return refusal;
}

/* A configuration of TD_CONFIGURATION_BYTES; unpacked into `config` if it is sound. */
td_refusal td_check_config(const uint8_t *bytes, const td_hardware *hardware, td_config *config);

/* An image for a configuration in force; opened as `bank` if it is sound. `bytes`: of that configuration. */
td_refusal td_check_image(const uint8_t *image, size_t size, const uint8_t *bytes, td_bank *bank);

#endif
