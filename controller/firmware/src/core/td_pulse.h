/* Test pulses, each after a rest: a single one, or pairs of alternating sign whose responses are summed. */
#ifndef TD_PULSE_H
#define TD_PULSE_H

#include "td_config.h"
#include "td_interface.h"

typedef struct {
    int32_t left;  /* pulses that have not ended; 0 if none is played */
    int32_t at;    /* ticks since the beginning of the rest before this pulse */
    int32_t rest_ticks, ticks, cycle_ticks;
    td_real size_A;
    int32_t sign;
    bool judged; /* pairs, whose responses are judged */
    int32_t begin_counts;
    td_wide rest_A, rest_m_s2, driven_A, pushed_m_s2; /* sums over this pulse */
    int32_t rests, drives, pushes;                    /* numbers of readings in them */
    td_wide last_A, last_m_s2;                        /* responses to the last pulse, times its sign */
    int32_t done;                                     /* number of pulses in the sums below, also times their signs */
    td_wide current_A, acceleration_m_s2, path_counts;
} td_pulse;

/* `pairs` 0: a single pulse, which is not judged. */
void td_pulse_start(td_pulse *pulse, const td_config *config, td_real current_A, int32_t ticks, int32_t pairs);

/* Take one tick's corrected readings; the command of the tick is available afterwards. */
void td_pulse_see(td_pulse *pulse, const td_config *config, const td_readings *seen);

td_real td_pulse_command(const td_pulse *pulse);

/* End the tick; whether the last pulse has ended with it. */
bool td_pulse_next(td_pulse *pulse);

#endif
