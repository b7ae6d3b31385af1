/* The coil's temperature, and how much of a transient it allows (tests/benches/oracle/guard.py; seed Eqs. 6-7). */
#ifndef TD_GUARD_H
#define TD_GUARD_H

#include "td_config.h"

/* Two thermal nodes, fed with i_eff^2 every tick and moved on every 10 ms. */
typedef struct {
    td_wide winding_C, housing_C;
    td_real sum, square; /* of i_eff^2 since the last update, and in the last tick [A^2] */
    int32_t count;
} td_guard;

void td_guard_start(td_guard *guard, const td_coil *coil);

/* One tick's current [A]; the caller has seen to it that it is a number. */
void td_guard_step(td_guard *guard, const td_coil *coil, td_real current_A);

/* Whether the winding may pass its limit before a command of zero is felt; heat since the last update counts. */
bool td_guard_too_hot(const td_guard *guard, const td_coil *coil);

/* What keeps the winding at or below the play limit. */
typedef struct {
    td_wide scale;  /* of what is played, 0 if it is withheld */
    td_wide cooled; /* part of the cool command in it, 0 to 1 */
} td_allowed;

/* All of the first command, else a blend with the cool one whose norms add up to what the coil can take, else the cool
 * one scaled, or nothing below the least scale; without a cool one of less heat the first is scaled.
 * `transient_A`, `cool_A` (infinite without), `feedback_A`: norms sqrt(sum i^2) over the `ticks` servo periods that a
 * transient takes; their root comes from the caller, since a square root in software costs more than all the rest at a
 * contact. */
td_allowed td_guard_allowed(const td_guard *guard, const td_coil *coil, td_wide transient_A, td_wide cool_A,
                            td_wide feedback_A, int32_t ticks, td_wide root_ticks);

#endif
