/* The device, the decoder and the hash for callers that know no struct of theirs: a shared library for tests. */
#ifndef TD_PROBE_H
#define TD_PROBE_H

#include "td_device.h"

/* What step and receive both touch is held once at a time, else the program ends. */
typedef struct {
    td_device device;
    int32_t held;
} td_probe;

size_t td_probe_device_size(void);
size_t td_probe_decoder_size(void);

void td_probe_start(td_probe *probe, uint32_t boot, double current_A, double command_A, double dt_s);

/* One period: what the sensors say in; command, transient, feedback, temperature out, and the state. */
uint8_t td_probe_step(td_device *device, uint64_t tick, int32_t encoder_counts, bool emergency_stop,
                      const double *grip_current_acceleration, double *answer, uint8_t *events, double *contacts);

/* Sound frames' payloads, each behind its u16 length; how many bytes were written, at most `size` and some. */
size_t td_probe_decode(td_decoder *decoder, const uint8_t *bytes, size_t size, uint8_t *payloads);

/* Counters: dropped frames of the device, its decoder's frames and bad frames, frames that found no room. */
void td_probe_counts(const td_device *device, uint32_t *counts);

#endif
