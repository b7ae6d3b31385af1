/* Checks of a configuration and of an image before a device activates them (controller/protocol/configuration.py,
 * image.py); the device does not trust the sender. Not for the timer's interrupt: an image takes tens of milliseconds. */
#ifndef TD_CHECK_H
#define TD_CHECK_H

#include "td_bank.h"
#include "td_config.h"

/* Limits of amplifier and motor that are compiled into a port; a host may only request less
 * (controller/protocol/capacity.py, Hardware). */
typedef struct {
    td_wide dt_s; /* servo period of the timer */
    td_wide current_A, command_A;
    td_wide pulse_A, pulse_s; /* of a test pulse */
    td_wide pole_least_Hz, pole_most_Hz; /* range of the amplifier's pole */
    td_wide over_current_A; /* a larger raw reading of the monitor is a fault in every state */
    bool has_coil; /* whether the following numbers are known */
    td_wide R_ohm, R_wh_K_W, R_ha_K_W, tau_w_s, tau_h_s, limit_C, ambient_C;
} td_hardware;

/* Reason of a refusal, TD_REASON_..., 0 if granted; and the offending number, NaN if there is none. */
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

/* Check a configuration of TD_CONFIGURATION_BYTES; it is unpacked into `config` if it is valid. */
td_refusal td_check_config(const uint8_t *bytes, const td_hardware *hardware, td_config *config);

/* Check an image for a configuration; it is opened as `bank` if it is valid. */
td_refusal td_check_image(const uint8_t *image, size_t size, const td_config *config, td_bank *bank);

#endif
