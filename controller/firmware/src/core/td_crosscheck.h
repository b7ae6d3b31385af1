/* Encoder, accelerometer and current held against each other, tick by tick (tests/benches/oracle/crosscheck.py).
 *
 * A stylus that moves, by its accelerometer, while its encoder stands still has a stuck encoder; one that current shakes
 * while its accelerometer is silent has a dead accelerometer.
 */
#ifndef TD_CROSSCHECK_H
#define TD_CROSSCHECK_H

#include "td_config.h"

typedef struct {
    td_real sum, square; /* of the acceleration about `middle_m_s2` */
    td_real low_A, high_A;
} td_block;

typedef struct {
    td_real path_m;  /* by the accelerometer, since the encoder's last count */
    td_real ahead_m; /* of the encoder, by which the accelerometer's motion is */
    td_real speed_m_s, offset_m_s2;
    int32_t still_ticks; /* since the encoder's last count */
    bool stuck; /* while a transient plays that path is longer than an encoder can sleep through */
    bool quiet; /* the accelerometer was silent while current shook the stylus */
    td_block blocks[TD_QUIET_BLOCKS];
    int32_t at, ticks, whole; /* block under way, readings in it, whole blocks before it */
    td_real middle_m_s2;
} td_crosscheck;

/* Begin another window of the accelerometer's silence. */
void td_crosscheck_forget(td_crosscheck *check);

/* One tick: counts since the last one, acceleration, current, whether a transient plays. */
void td_crosscheck_step(td_crosscheck *check, const td_config *config, int32_t moved, td_real acceleration_m_s2,
                        td_real current_A, bool playing);

#endif
