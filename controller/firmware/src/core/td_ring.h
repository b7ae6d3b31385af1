/* The hardware's own limits, behind everything that makes a command.
 *
 * What a host configures may only be tighter. This ring knows nothing of hosts: it follows what went out, by the slowest
 * and the fastest amplifier that the port admits, and lets no command pass that could carry the true current beyond the
 * hardware's limit with any of them. Its state is that of the hardware, so that neither CONFIGURE nor DISARM nor RESET
 * nor a fault touches it.
 */
#ifndef TD_RING_H
#define TD_RING_H

#include "td_check.h"
#include "td_guard.h"

typedef struct {
    bool sound; /* the port's numbers make sense; without, nothing goes out */
    td_real current_A, command_A, over_current_A;
    td_real fast, slow;      /* exp(-w dt) of the fastest and the slowest amplifier */
    td_real least_A, most_A; /* between these the current is at the coming switching instant */
    td_real flowing_A;       /* the largest size that it may have had during the last period */
    td_coil coil;
    td_guard guard;
} td_ring;

/* From no current. `winding_C`, `housing_C`: as they were kept over the restart; NaN for what is not known, and then as
 * hot as the guard lets them be. */
void td_ring_start(td_ring *ring, const td_hardware *hardware, double winding_C, double housing_C);

/* One tick's raw reading of the current: faults as bits (td_fault_bit), whatever the state. */
uint32_t td_ring_watch(td_ring *ring, td_real measured_A);

/* What may go out in place of a command: the nearest inside the limits, 0 for what is no number. */
td_real td_ring_limited(const td_ring *ring, td_real command_A);

/* That went out, to be held until the next tick. */
void td_ring_follow(td_ring *ring, td_real command_A);

#endif
