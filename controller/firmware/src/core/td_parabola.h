/* Rows of a parabola's least-squares fit to readings of age 0 to window - 1 (tests/benches/oracle/approach.py). */
#ifndef TD_PARABOLA_H
#define TD_PARABOLA_H

#include "td_real.h"

/* Weights of the sums of counts, counts * age and counts * age^2 for value and slope ahead of the newest reading. */
typedef struct {
    td_wide value[3], slope[3];
} td_parabola;

/* Computed from the adjugate of the normal matrix. */
td_parabola td_parabola_fit(int32_t window, double ahead);

/* (4) weights of the sums of counts times age^0 to age^3: cubic part of the readings. The window must exceed 3. */
void td_parabola_bend(int32_t window, td_wide *bend);

#endif
