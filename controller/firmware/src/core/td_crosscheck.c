#include "td_crosscheck.h"

#include <string.h>

static td_real smaller(td_real one, td_real other)
{
    return other < one ? other : one;
}

static td_real larger(td_real one, td_real other)
{
    return other > one ? other : one;
}

void td_crosscheck_forget(td_crosscheck *check)
{
    check->quiet = check->stuck = false;
    memset(check->blocks, 0, sizeof check->blocks);
    check->at = check->ticks = check->whole = 0;
    check->middle_m_s2 = 0;
}

static void rest(td_crosscheck *check)
{
    check->path_m = check->ahead_m = check->speed_m_s = 0;
    check->still_ticks = 0;
}

/* After so long without a count the stylus counts as at rest: what the accelerometer reads on average is its offset. */
static void settle(td_crosscheck *check, const td_config *config)
{
    check->offset_m_s2 += check->speed_m_s / ((td_real)check->still_ticks * config->tick_s);
    rest(check);
}

static void follow(td_crosscheck *check, const td_config *config, int32_t moved, td_real acceleration_m_s2)
{
    const td_real dt_s = config->tick_s;
    td_real step_m, since_s, ahead_m, r;

    check->speed_m_s += dt_s * (acceleration_m_s2 - check->offset_m_s2);
    step_m = dt_s * check->speed_m_s;
    check->ahead_m += step_m;
    check->path_m += step_m;
    check->still_ticks++;
    if (moved == 0) {
        if (check->still_ticks >= config->rest_limit)
            settle(check, config);
        return;
    }
    check->ahead_m -= (td_real)moved * config->step_m;
    ahead_m = check->ahead_m;
    if (!(-(td_real)TD_FOLLOW_FAR_M <= ahead_m && ahead_m <= (td_real)TD_FOLLOW_FAR_M)) {
        check->offset_m_s2 = 0;
        rest(check);
        return;
    }
    since_s = (td_real)check->still_ticks * dt_s;
    r = smaller((td_real)TD_FOLLOW_RATE_1_S, (td_real)TD_FOLLOW_PART / since_s);
    check->speed_m_s -= 3 * r * r * since_s * ahead_m;
    check->offset_m_s2 += r * r * r * since_s * ahead_m;
    check->ahead_m -= smaller(3 * r * since_s, 1) * ahead_m;
    check->path_m = 0;
    check->still_ticks = 0;
}

/* Variance of the acceleration over the readings of the window so far. */
static td_real heard(const td_crosscheck *check, const td_config *config)
{
    const int32_t blocks = check->whole > check->at + 1 ? check->whole : check->at + 1;
    int32_t readings = check->whole * config->block_ticks, j;
    td_real sum = 0, square = 0, mean;

    for (j = 0; j < blocks; j++) {
        sum += check->blocks[j].sum;
        square += check->blocks[j].square;
    }
    /* The open block replaces the oldest one. */
    if (check->ticks > 0)
        readings += check->ticks - (check->whole == TD_QUIET_BLOCKS ? config->block_ticks : 0);
    mean = sum / (td_real)readings;
    return square / (td_real)readings - mean * mean;
}

static void judge(td_crosscheck *check, const td_config *config, bool playing)
{
    /* The response to the current of the newest block is still to come. */
    const int32_t newest = (check->at > 0 ? check->at : TD_QUIET_BLOCKS) - 1;
    const td_real variance = heard(check, config);
    td_real low_A = check->blocks[check->at].low_A, high_A = check->blocks[check->at].high_A;
    int32_t j;

    for (j = 0; j < TD_QUIET_BLOCKS; j++) {
        if (j == newest)
            continue;
        low_A = smaller(low_A, check->blocks[j].low_A);
        high_A = larger(high_A, check->blocks[j].high_A);
    }
    check->quiet = playing && variance < (td_real)TD_QUIET_M_S2 * (td_real)TD_QUIET_M_S2 && high_A - low_A >= config->swing_A;
}

static void listen(td_crosscheck *check, const td_config *config, td_real acceleration_m_s2, td_real current_A,
                   bool playing)
{
    td_block *block = &check->blocks[check->at];
    td_real a;

    /* Relative to the first reading, so that the squares of a large offset do not hide a small motion. */
    if (check->ticks == 0 && check->whole == 0 && check->at == 0)
        check->middle_m_s2 = acceleration_m_s2;
    a = acceleration_m_s2 - check->middle_m_s2;
    if (check->ticks == 0) {
        block->sum = block->square = 0;
        block->low_A = block->high_A = current_A;
    }
    block->sum += a;
    block->square += a * a;
    block->low_A = smaller(block->low_A, current_A);
    block->high_A = larger(block->high_A, current_A);
    check->ticks++;
    if (check->ticks < config->block_ticks)
        return;
    check->ticks = 0;
    check->at = check->at + 1 < TD_QUIET_BLOCKS ? check->at + 1 : 0;
    if (check->whole < TD_QUIET_BLOCKS)
        check->whole++;
    if (check->whole == TD_QUIET_BLOCKS)
        judge(check, config, playing);
}

void td_crosscheck_step(td_crosscheck *check, const td_config *config, int32_t moved, td_real acceleration_m_s2,
                        td_real current_A, bool playing)
{
    /* A comparison with NaN is false, so NaN counts as absurd. */
    if (!(-(td_real)TD_ABSURD_M_S2 <= acceleration_m_s2 && acceleration_m_s2 <= (td_real)TD_ABSURD_M_S2))
        acceleration_m_s2 = 0;
    follow(check, config, moved, acceleration_m_s2);
    if (playing || td_size(current_A) >= config->stuck_A) {
        listen(check, config, acceleration_m_s2, current_A, playing);
        /* A dead accelerometer misses the end of a motion, so its path would grow without one: it must show noise. */
        check->stuck = td_size(check->path_m) >= (playing ? 1 : (td_real)TD_STUCK_HELD) * config->stuck_m &&
                       heard(check, config) >= (td_real)TD_DEAD_M_S2 * (td_real)TD_DEAD_M_S2;
    } else if (check->whole > 0 || check->ticks > 0) {
        td_crosscheck_forget(check);
    }
}
