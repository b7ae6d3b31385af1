/* The line to the device under the fuzzer: its bytes as a program, and what a host says by it.
 *
 * Requests have sound checksums, sequences and sessions; what stands in them is near what is sound, or anything.
 */
#ifndef FUZZ_LINE_H
#define FUZZ_LINE_H

#include "td_device.h"

extern td_device device;
extern td_hardware hardware; /* its own, for the coming start */

/* From this program on; nothing is configured or uploaded. */
void line_begin(const uint8_t *data, size_t size);

/* Ticks since the host last sent a LEASE, or a PULSE, which begins a lease of its own; counted by the harness. */
extern int32_t leased_ticks;

/* Whole ticks by which a sound configuration says that the amplifier is late. */
extern int32_t stated_late_ticks;

/* The device has started anew. */
void line_restart(void);

/* Whether there is anything left of the program, and its next byte, word, or number; zero behind its end. */
bool more(void);
uint8_t byte(void);
uint32_t word(void);
double odd(void);

/* Take what the device sends. */
void drain(void);

void say(uint8_t kind, const uint8_t *body, size_t size);
void hello(void);
void configure(uint8_t how, int changes);
void upload(uint8_t how, int changes);
void arm(void);
void arm_trial(void); /* as the check does it */
void pulse(void);
void one_number(uint8_t kind);
void lease(void);
void anything(void);

#endif
