/* The device, the decoder and the hash for callers that know no struct of theirs: a shared library for tests. */
#ifndef TD_PROBE_H
#define TD_PROBE_H

#include "td_device.h"

/* What step and receive both touch is held once at a time, else the program ends. */
typedef struct {
    td_device device;
    int32_t held;
    uint32_t holds; /* so far, modulo 2^32 */
    bool enabled; /* of the amplifier, as it was last put out */
} td_probe;

size_t td_probe_device_size(void);
size_t td_probe_decoder_size(void);

/* `hardware`: the numbers of td_hardware in their order, the flag as 0 or 1; `heat_C`: winding and housing as they were
 * kept over the restart, NaN if they were not. */
#define TD_PROBE_HARDWARE 16
void td_probe_start(td_probe *probe, uint32_t boot, const double *hardware, const double *heat_C, bool simulated);

/* One period: what the sensors say in, `stops` bit 0 pressed and bit 1 late; command, transient, feedback, temperature out, and the
 * state; of each event its kind and four numbers: speed, grip, scale, part of the cool command. */
uint8_t td_probe_step(td_device *device, uint64_t tick, int32_t encoder_counts, uint8_t stops,
                      const double *grip_current_acceleration, double *answer, uint8_t *events, double *contacts);

/* Sound frames' payloads, each behind its u16 length; how many bytes were written, at most `size` and some. */
size_t td_probe_decode(td_decoder *decoder, const uint8_t *bytes, size_t size, uint8_t *payloads);

/* What a device has in it, for whoever wants to see more than it says; controller/firmware/core_device.py has the same struct. */
typedef struct {
    double winding_C, housing_C; /* of the coil, as far as it is configured */
    uint32_t boot;
    uint32_t events, oldest_event; /* number of the next event, and of the first that is not acknowledged */
    uint32_t arrived_bytes;        /* of the image on its way */
    uint32_t dropped_frames;       /* sound, but not for this session, out of order, or of no meaning */
    uint32_t lost_frames;          /* that found no room to go out */
    uint8_t state, fault, evidence; /* TD_STATE_..., TD_WHAT_..., bits */
    uint8_t configuration_sha256[TD_HASH_BYTES], library_sha256[TD_HASH_BYTES];
} td_probe_view;

/* Whether the amplifier may be on; winding and housing as a port keeps them. */
bool td_probe_enabled(const td_probe *probe);
void td_probe_coil(const td_probe *probe, double *heat_C);

void td_probe_look(const td_device *device, td_probe_view *view);

/* The image in force, and how many bytes it has; 0 without one. */
const uint8_t *td_probe_image(const td_device *device, size_t *size);

/* The coil is so warm, whatever was played. */
void td_probe_heat(td_device *device, double winding_C, double housing_C);

#endif
