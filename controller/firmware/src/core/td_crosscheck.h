/* Consistency of encoder, accelerometer and current, checked tick by tick (tests/benches/oracle/crosscheck.py).
 *
 * If the accelerometer shows motion while the encoder stands still, the encoder is stuck. If a current shakes the stylus
 * while the accelerometer is silent, the accelerometer is dead.
 */
#ifndef TD_CROSSCHECK_H
#define TD_CROSSCHECK_H

#include "td_config.h"

typedef struct {
    td_real sum, square; /* of the acceleration about `middle_m_s2` */
    td_real low_A, high_A;
} td_block;

typedef struct {
    td_real path_m;  /* by the accelerometer, since the encoder last moved */
    td_real ahead_m; /* position by the accelerometer less that by the encoder */
    td_real speed_m_s, offset_m_s2;
    int32_t still_ticks; /* since the encoder last moved */
    bool stuck; /* while a current flows, path_m is too long for a working encoder not to move */
    bool quiet; /* the accelerometer was silent while current shook the stylus */
    td_block blocks[TD_QUIET_BLOCKS];
    int32_t at, ticks, whole; /* open block, readings in it, complete blocks before it */
    td_real middle_m_s2;
} td_crosscheck;

/* Restart the window in which the accelerometer's silence is judged. */
void td_crosscheck_forget(td_crosscheck *check);

/* One tick: counts by which the encoder has moved (td_watch.c), acceleration, current, whether a transient plays. The
 * encoder is judged then and while the current is not small, the accelerometer only then: a hand balances a wall. */
void td_crosscheck_step(td_crosscheck *check, const td_config *config, int32_t moved, td_real acceleration_m_s2,
                        td_real current_A, bool playing);

#endif
