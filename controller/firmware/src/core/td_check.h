/* What a device asks of a configuration and of an image before it puts them in force (controller/protocol/configuration.py,
 * image.py): the sender's word is not enough. Not for the timer's interrupt: an image takes milliseconds. */
#ifndef TD_CHECK_H
#define TD_CHECK_H

#include "td_bank.h"
#include "td_config.h"

/* What is compiled into a port about the amplifier and the motor behind it; a host may only ask for less
 * (controller/protocol/capacity.py, Hardware). */
typedef struct {
    td_wide dt_s; /* servo period of the timer */
    td_wide current_A, command_A;
    td_wide pulse_A, pulse_s; /* of a test pulse */
    td_wide pole_least_Hz, pole_most_Hz; /* between these the amplifier's pole lies */
    td_wide over_current_A; /* of the monitor's raw reading, a fault in every state */
    bool has_coil; /* whether what follows is known */
    td_wide R_ohm, R_wh_K_W, R_ha_K_W, tau_w_s, tau_h_s, limit_C, ambient_C;
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

/* An image for a configuration; opened as `bank` if it is sound. */
td_refusal td_check_image(const uint8_t *image, size_t size, const td_config *config, td_bank *bank);

#endif
