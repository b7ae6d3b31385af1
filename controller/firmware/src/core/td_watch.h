/* Detection of faults (test oracle tests/benches/oracle/faults.py). */
#ifndef TD_WATCH_H
#define TD_WATCH_H

#include "td_config.h"
#include "td_crosscheck.h"
#include "td_guard.h"
#include "td_interface.h"

/* Quantities by which faults are judged, updated every tick. NaN and absurd readings are rejected here: `counts`,
 * `grip_N` and `current_A` hold the last valid readings, the grip smoothed. */
typedef struct {
    int32_t counts, low_counts; /* of the two neighbouring counts, low_counts and one more, that the encoder is at */
    td_real grip_N, raw_grip_N, current_A, step_m_s; /* step_m_s: velocity of the encoder over the last tick */
    td_real expected_A;                              /* present current of the model */
    bool seen, gripped;                              /* whether there has been a valid reading of encoder and grip */
    bool emergency_stop, host_stop, late, bad_encoder, bad_current;
    bool playing, held; /* a transient plays; one for which a lost grip is a fault */
    uint32_t hardware; /* faults by the hardware's own limits in this tick (td_ring.h) */
    int32_t missing_ticks; /* duration of far less current than expected */
    int32_t still_ticks;   /* duration of current since the last count; both saturate at their limits */
    int32_t turns, turn_ticks; /* how often the encoder went back and forth between its two counts under current, and for how
                                  long, up to the time of a still one */
    td_real still_A_s;     /* impulse of the transient since the last count */
    bool pulsing;        /* set by the device: a test pulse runs, which td_evidence.h judges */
    bool wrong;          /* whether the last reading of the current is further from the model's than allowed */
    int32_t wrong_ticks; /* for how long it has been so; saturates as well */
    td_crosscheck crosscheck;
} td_watch;

void td_watch_start(td_watch *watch, const td_config *config);

/* Restart all durations. */
void td_watch_forget(td_watch *watch);

/* One tick. `expected_A`: current of the model; `transient_A`: transient command of the previous tick. */
void td_watch_step(td_watch *watch, const td_config *config, const td_readings *readings, td_real expected_A,
                   td_real transient_A, bool playing, bool held);

/* The bit of a fault in a set. */
static inline uint32_t td_fault_bit(int what)
{
    return (uint32_t)1 << (what - TD_FIRST_FAULT);
}

/* Whether another current than the model's has been flowing for longer than noise and rounded delays explain. */
bool td_watch_is_wrong(const td_watch *watch);

/* Faults as a set of bits, see td_fault_bit: those that send the servo to FAULT, and those that prevent the reset. */
uint32_t td_watch_trips(const td_watch *watch, const td_config *config, const td_guard *guard);
uint32_t td_watch_remains(const td_watch *watch, const td_config *config, const td_guard *guard);

#endif
