/* The hardware's own limits, applied last to every command.
 *
 * A host can only configure tighter ones. This ring does not depend on the host: it follows the commands issued, with the
 * slowest and the fastest amplifier that the port admits, and limits each command so that the true current stays below
 * the hardware's limit L with any of them, if every command is held for exactly one period. Its state is that of the
 * hardware: CONFIGURE, DISARM, RESET and faults do not change it.
 *
 * A port calls a tick late only from one and a half periods on. Let f and g = f^1.5 be what the fastest amplifier keeps of
 * its current over one period and over one and a half, and C the largest command. A longer hold takes the current further
 * towards a command c than the bound m, which is followed here, by (f - g) (c - m) at most; g of that is left after the
 * next. The last step up to L has c - m <= (C - L) / f, those before it C + L, so that L is passed by at most
 *
 *     (f - g) ((C - L) / f + g / (1 - g) (C + L))
 *
 * for C >= L, however holds between half a period and one and a half follow each other: 1.2 A for L = 4 A, C = 6 A and
 * 1575 Hz. A port whose motor or amplifier does not bear that for some periods states a smaller L.
 */
#ifndef TD_RING_H
#define TD_RING_H

#include "td_check.h"
#include "td_guard.h"

typedef struct {
    bool sound; /* whether the port's numbers are valid; if not, every command is zero */
    td_real current_A, command_A, over_current_A;
    td_real fast, slow;      /* exp(-w dt) of the fastest and the slowest amplifier */
    td_real least_A, most_A; /* bounds of the current at the next switching instant */
    td_real flowing_A;       /* largest size that it may have had during the last period */
    td_coil coil;
    td_guard guard;
} td_ring;

/* Start without current. `winding_C`, `housing_C`: temperatures kept over the restart, above the limit too; NaN if
 * unknown, and then just below the limit. */
void td_ring_start(td_ring *ring, const td_hardware *hardware, double winding_C, double housing_C);

/* One tick's raw reading of the current, in any state; returns faults as bits (td_fault_bit). */
uint32_t td_ring_watch(td_ring *ring, td_real measured_A);

/* The nearest command within the limits; 0 for NaN or infinity. */
td_real td_ring_limited(const td_ring *ring, td_real command_A);

/* This command was issued and is held until the next tick. */
void td_ring_follow(td_ring *ring, td_real command_A);

#endif
