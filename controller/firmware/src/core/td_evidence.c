#include "td_evidence.h"

#include <math.h>
#include <string.h>

static bool is_number(double value)
{
    return !isnan(value);
}

static bool agrees(double ratio)
{
    return ratio >= TD_EVIDENCE_LEAST && ratio <= TD_EVIDENCE_MOST;
}

void td_evidence_start(td_evidence *evidence)
{
    memset(evidence, 0, sizeof *evidence);
    evidence->current_ratio = evidence->acceleration_ratio = (double)NAN;
    evidence->path_ratio = evidence->speed_ratio = (double)NAN;
}

/* ------------------------------------------------------------------------------------------------ motion from rest */

static void close_block(td_motion *motion, td_wide dt_s, int32_t size)
{
    const int32_t newest = motion->next;
    int32_t least = motion->open_least, most = motion->open_most, j;
    td_wide sum = 0;

    motion->sum_m_s2[newest] = motion->open_m_s2;
    motion->least[newest] = least;
    motion->most[newest] = most;
    motion->next = (newest + 1) % TD_REST_BLOCKS;
    motion->open = 0;
    motion->open_m_s2 = 0;
    if (motion->blocks < TD_REST_BLOCKS)
        motion->blocks++;
    if (motion->blocks < TD_REST_BLOCKS)
        return;
    for (j = 0; j < TD_REST_BLOCKS; j++) {
        least = motion->least[j] < least ? motion->least[j] : least;
        most = motion->most[j] > most ? motion->most[j] : most;
        sum += j == newest ? 0 : motion->sum_m_s2[j];
    }
    if (most - least > TD_REST_COUNTS)
        return;
    /* At rest. The newest block belongs to what follows: a motion begins before it reaches a count. */
    motion->known = true;
    motion->rest_m_s2 = sum / ((TD_REST_BLOCKS - 1) * (td_wide)size);
    motion->speed_m_s = (motion->sum_m_s2[newest] - motion->rest_m_s2 * size) * dt_s;
    motion->ticks = size;
}

void td_evidence_see(td_evidence *evidence, const td_config *config, const td_readings *seen)
{
    const int32_t size = (int32_t)ceil(TD_REST_BLOCK_S / config->dt_s), counts = seen->encoder_counts;
    const td_wide acceleration = (td_wide)seen->acceleration_m_s2;
    td_motion *motion = &evidence->motion;

    if (!(fabs(acceleration) < 1e6) || counts > TD_ENCODER_MOST_COUNTS || counts < -TD_ENCODER_MOST_COUNTS) {
        memset(motion, 0, sizeof *motion);
        return;
    }
    if (motion->known) {
        motion->speed_m_s += (acceleration - motion->rest_m_s2) * config->dt_s;
        motion->ticks++;
        if (motion->ticks * config->dt_s > TD_INTEGRAL_S)
            motion->known = false;
    }
    if (motion->open == 0)
        motion->open_least = motion->open_most = counts;
    motion->open_least = counts < motion->open_least ? counts : motion->open_least;
    motion->open_most = counts > motion->open_most ? counts : motion->open_most;
    motion->open_m_s2 += acceleration;
    motion->open++;
    if (motion->open >= size)
        close_block(motion, config->dt_s, size);
}

/* ------------------------------------------------------------------------------------------------ pulses */

void td_evidence_pulsing(td_evidence *evidence)
{
    evidence->bits &= (uint8_t)~TD_PULSE_SOUND;
    evidence->stage = TD_STAGE_PULSING;
    evidence->pulses = 0;
    evidence->current_ratio = evidence->acceleration_ratio = evidence->path_ratio = (double)NAN;
}

/* Of a column of the prediction, at a grip; beyond its ends the nearest. */
static td_wide predicted(const td_pulse_plan *plan, const td_wide *column, td_wide grip_N)
{
    td_wide part;
    int32_t j;

    if (!(grip_N > plan->grip_N[0]))
        return column[0];
    for (j = 1; j < plan->nodes; j++) {
        if (grip_N < plan->grip_N[j]) {
            part = (grip_N - plan->grip_N[j - 1]) / (plan->grip_N[j] - plan->grip_N[j - 1]);
            return (1 - part) * column[j - 1] + part * column[j];
        }
    }
    return column[plan->nodes - 1];
}

void td_evidence_pulsed(td_evidence *evidence, const td_config *config, const td_pulse *pulse, td_wide grip_N)
{
    const td_pulse_plan *plan = &config->pulse;
    const double asked_A = (double)pulse->size_A * pulse->done;
    const double push_m_s2 = predicted(plan, plan->acceleration, grip_N) * asked_A;
    const double path_counts = predicted(plan, plan->path_m, grip_N) * asked_A / config->count_m;

    evidence->stage = TD_STAGE_PULSED;
    evidence->pulses = (uint16_t)pulse->done;
    evidence->current_ratio = pulse->current_A / asked_A;
    if (config->calibration.has_accelerometer)
        evidence->acceleration_ratio = pulse->acceleration_m_s2 / push_m_s2;
    if (path_counts >= TD_PATH_LEAST_COUNTS * (double)pulse->done)
        evidence->path_ratio = pulse->path_counts / path_counts;
    if (agrees(evidence->current_ratio) &&
        (config->calibration.has_accelerometer ? agrees(evidence->acceleration_ratio) : is_number(evidence->path_ratio)) &&
        (!is_number(evidence->path_ratio) || agrees(evidence->path_ratio)))
        evidence->bits |= TD_PULSE_SOUND;
}

/* ------------------------------------------------------------------------------------------------ a trial */

void td_evidence_trying(td_evidence *evidence)
{
    evidence->bits &= (uint8_t)~TD_TRIAL_FINISHED;
    evidence->stage = TD_STAGE_TRIAL;
    evidence->speed_ratio = (double)NAN;
}

void td_evidence_contact(td_evidence *evidence, const td_config *config, td_wide speed_m_s)
{
    /* Inwards is positive for the speed of a contact, outwards for the accelerometer. */
    if (config->calibration.has_accelerometer && evidence->motion.known)
        evidence->speed_ratio = speed_m_s / -evidence->motion.speed_m_s;
}

void td_evidence_tried(td_evidence *evidence, const td_config *config, td_wide gain)
{
    evidence->stage = TD_STAGE_TRIED;
    /* So small that nothing of it was felt proves nothing. */
    if (!(gain >= TD_TRIAL_GAIN / 2))
        return;
    if (config->host_starts || !config->calibration.has_accelerometer || agrees(evidence->speed_ratio))
        evidence->bits |= TD_TRIAL_FINISHED;
}
