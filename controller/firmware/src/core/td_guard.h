/* Coil temperature, and the share of a transient that it allows (seed Eqs. 6-7; tests/benches/oracle/guard.py). */
#ifndef TD_GUARD_H
#define TD_GUARD_H

#include "td_config.h"

#define TD_CEILING_C 1000.0 /* of the estimates: one at infinity could not cool down again */

/* Two thermal nodes: i_eff^2 is summed every tick, the temperatures are updated every 10 ms. */
typedef struct {
    td_wide winding_C, housing_C;
    td_real sum, square; /* i_eff^2: sum since the last update, and value of the last tick [A^2] */
    int32_t count;
} td_guard;

void td_guard_start(td_guard *guard, const td_coil *coil);

/* Be no colder than another estimate. */
void td_guard_warm(td_guard *guard, const td_guard *other);

/* One tick with this current [A], which must be finite. */
void td_guard_step(td_guard *guard, const td_coil *coil, td_real current_A);

/* Whether the winding may exceed its limit before a command of zero takes effect; includes the heat since the last
 * update. */
bool td_guard_too_hot(const td_guard *guard, const td_coil *coil);

/* The part of a transient that keeps the winding at or below the play limit. */
typedef struct {
    td_wide scale;  /* factor on the blend, 0 if the transient is withheld */
    td_wide cooled; /* share of the cool command in the blend, 0 to 1 */
} td_allowed;

/* The first command if the coil allows it; else a blend with the cool one, with norms that add up to what the coil
 * allows; else the cool one scaled, or nothing below the least scale. Without a cooler command the first one is scaled.
 * `transient_A`, `cool_A` (infinite without), `feedback_A`: norms sqrt(sum i^2) over the `ticks` servo periods that a
 * transient takes; the caller takes their root, since a square root in software costs more than the rest of a contact. */
td_allowed td_guard_allowed(const td_guard *guard, const td_coil *coil, td_wide transient_A, td_wide cool_A,
                            td_wide feedback_A, int32_t ticks, td_wide root_ticks);

#endif
