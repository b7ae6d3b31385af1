/* What makes the servo give up (tests/benches/oracle/faults.py). */
#ifndef TD_WATCH_H
#define TD_WATCH_H

#include "td_config.h"
#include "td_crosscheck.h"
#include "td_guard.h"
#include "td_interface.h"

/* What the faults are judged by, brought up to date every tick.
 * Nothing that is no number, or absurd, gets past this: `counts`, `grip_N` and `current_A` hold the last sound
 * readings, the grip smoothed. */
typedef struct {
    int32_t counts;
    td_real grip_N, raw_grip_N, current_A, step_m_s; /* step_m_s: of the encoder over the last tick */
    td_real expected_A;                              /* by the model, now */
    bool seen, gripped;                              /* whether there has been a sound reading yet */
    bool emergency_stop, host_stop, late, bad_encoder, bad_current;
    bool playing, held; /* a transient plays; one that ends in a fault if the grip is lost */
    uint32_t hardware; /* faults that the hardware's own limits have seen in this tick (td_ring.h) */
    int32_t missing_ticks; /* for so long far less current than expected was measured */
    int32_t still_ticks;   /* with current since the last count; both counted up to their limits */
    td_real still_A_s;     /* impulse of the transient since the last count */
    int32_t wrong_ticks; /* of a transient for so long another current than expected was measured */
    td_crosscheck crosscheck;
} td_watch;

void td_watch_start(td_watch *watch, const td_config *config);

/* Start every duration anew. */
void td_watch_forget(td_watch *watch);

/* One tick. `expected_A`: current of the model; `transient_A`: transient of the tick before. */
void td_watch_step(td_watch *watch, const td_config *config, const td_readings *readings, td_real expected_A,
                   td_real transient_A, bool playing, bool held);

/* The bit of a fault in a set. */
static inline uint32_t td_fault_bit(int what)
{
    return (uint32_t)1 << (what - TD_FIRST_FAULT);
}

/* Faults as a set of bits, see td_fault_bit. `td_watch_trips` sends the servo to FAULT; of those latched there,
 * `td_watch_remains` bars the reset. */
uint32_t td_watch_trips(const td_watch *watch, const td_config *config, const td_guard *guard);
uint32_t td_watch_remains(const td_watch *watch, const td_config *config, const td_guard *guard);

#endif
