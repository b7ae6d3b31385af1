/* Rows of a parabola's least-squares fit to the readings of the ages 0 .. window - 1 (tests/benches/oracle/approach.py). */
#ifndef TD_PARABOLA_H
#define TD_PARABOLA_H

#include "td_real.h"

/* Weights of sum counts, sum counts * age, sum counts * age^2 for the value and for the slope, ahead of the newest. */
typedef struct {
    td_wide value[3], slope[3];
} td_parabola;

/* From the adjugate of the normal matrix. */
td_parabola td_parabola_fit(int32_t window, double ahead);

/* (4) weights of the sums of counts times age^0 .. age^3: how much of a cubic is in the readings. Window above 3. */
void td_parabola_bend(int32_t window, td_wide *bend);

#endif
