#include "td_evidence.h"

#include <math.h>
#include <string.h>

static bool is_number(double value)
{
    return !isnan(value);
}

static bool is_within(double ratio, double least, double most)
{
    return ratio >= least && ratio <= most;
}

static bool agrees(double ratio)
{
    return is_within(ratio, TD_EVIDENCE_LEAST, TD_EVIDENCE_MOST);
}

void td_evidence_start(td_evidence *evidence)
{
    memset(evidence, 0, sizeof *evidence);
    evidence->current_ratio = evidence->acceleration_ratio = (double)NAN;
    evidence->path_ratio = evidence->speed_ratio = (double)NAN;
}

/* ------------------------------------------------------------------------------------------------ a hand's motion */

static td_wide high_pass(td_wide value, td_wide part, td_wide *low)
{
    *low += part * (value - *low);
    return value - *low;
}

static void close_block(td_motion *motion, td_wide count_m, td_wide dt_s)
{
    const td_wide part = TD_MOTION_RATE_1_S * dt_s, fading = motion->fading;
    const td_wide each = 1 / (td_wide)motion->open; /* divisions in software are long */
    const td_wide m_s2 = motion->open_m_s2 * each;
    td_wide encoder = (td_wide)motion->open_counts * each * count_m, accelerometer;
    int32_t j;

    for (j = 0; j < 3; j++)
        encoder = high_pass(encoder, part, &motion->low[j]);
    motion->way[0] += dt_s * (m_s2 - TD_MOTION_RATE_1_S * motion->way[0]);
    motion->way[1] += dt_s * (motion->way[0] - TD_MOTION_RATE_1_S * motion->way[1]);
    accelerometer = high_pass(motion->way[1], part, &motion->way_low);
    motion->by_both = fading * motion->by_both + encoder * accelerometer;
    motion->by_encoder = fading * motion->by_encoder + encoder * encoder;
    motion->by_accelerometer = fading * motion->by_accelerometer + accelerometer * accelerometer;
    motion->open = 0;
    motion->open_counts = 0;
    motion->open_m_s2 = 0;
    if (motion->blocks < INT32_MAX)
        motion->blocks++;
}

void td_evidence_see(td_evidence *evidence, const td_config *config, const td_readings *seen)
{
    const int32_t counts = seen->encoder_counts;
    td_motion *motion = &evidence->motion;

    if (!(td_size(seen->acceleration_m_s2) < (td_real)1e6) || counts > TD_ENCODER_MOST_COUNTS || counts < -TD_ENCODER_MOST_COUNTS) {
        memset(motion, 0, sizeof *motion);
        return;
    }
    if (motion->blocks == 0 && motion->open == 0) {
        motion->origin = counts;
        motion->size = (int32_t)ceil(TD_MOTION_BLOCK_S / config->dt_s);
        motion->fading = 1 - motion->size * config->dt_s / TD_MOTION_S;
    }
    motion->open_counts += counts - motion->origin;
    motion->open_m_s2 += (td_wide)seen->acceleration_m_s2;
    motion->open++;
    if (motion->open >= motion->size)
        close_block(motion, config->count_m, motion->size * config->dt_s);
}

/* Ratio of the encoder's motion to the accelerometer's; NaN before the filter has settled, without enough motion, and
 * if the two are not correlated. */
static double motion_ratio(const td_motion *motion, td_wide dt_s)
{
    const td_wide block_s = motion->size * dt_s, least = TD_MOTION_LEAST_M * TD_MOTION_LEAST_M * TD_MOTION_S;
    const td_wide product = motion->by_encoder * motion->by_accelerometer;

    if (!(motion->blocks * block_s >= TD_MOTION_SETTLED_S && motion->by_accelerometer * block_s >= least))
        return (double)NAN;
    if (!(motion->by_both * motion->by_both >= TD_MOTION_ALIKE * TD_MOTION_ALIKE * product))
        return (double)NAN;
    return motion->by_both / motion->by_accelerometer;
}

/* ------------------------------------------------------------------------------------------------ pulses */

void td_evidence_pulsing(td_evidence *evidence)
{
    evidence->bits &= (uint8_t)~TD_PULSE_SOUND;
    evidence->stage = TD_STAGE_PULSING;
    evidence->pulses = 0;
    evidence->current_ratio = evidence->acceleration_ratio = evidence->path_ratio = (double)NAN;
}

/* A column of the prediction at a grip, interpolated linearly, constant beyond its ends. */
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

bool td_evidence_is_wrong(const td_config *config, const td_pulse *pulse, td_wide grip_N)
{
    const double asked_A = (double)pulse->size_A;
    const double push_m_s2 = predicted(&config->pulse, config->pulse.acceleration, grip_N) * asked_A;

    return !is_within(pulse->last_A / asked_A, TD_WRONG_PULSE_LEAST, TD_WRONG_PULSE_MOST) ||
           (config->calibration.has_accelerometer &&
            !is_within(pulse->last_m_s2 / push_m_s2, TD_WRONG_PUSH_LEAST, TD_WRONG_PUSH_MOST));
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
    memset(&evidence->flowed, 0, sizeof evidence->flowed);
}

void td_evidence_contact(td_evidence *evidence, const td_config *config)
{
    memset(&evidence->flowed, 0, sizeof evidence->flowed);
    if (!config->calibration.has_accelerometer)
        return;
    evidence->speed_ratio = motion_ratio(&evidence->motion, config->dt_s);
    if (is_number(evidence->speed_ratio))
        evidence->agreed = agrees(evidence->speed_ratio);
}

/* The smaller of a current by the stated scale and of the same current in the hardware's units. */
static td_real by_either(td_real size, td_real scale)
{
    const td_real part = td_size(scale);

    return part > 1 ? size / part : size;
}

void td_evidence_flows(td_evidence *evidence, const td_config *config, td_real expected_A, td_real measured_A)
{
    td_flowed *flowed = &evidence->flowed;
    const td_real played = by_either(td_size(expected_A), config->calibration.amplifier_scale);
    const td_real read = by_either(td_size(measured_A), config->calibration.monitor_scale);
    const td_real both = played < read ? played : read;

    flowed->expected += (td_wide)(expected_A * expected_A);
    flowed->both += (td_wide)(expected_A * measured_A);
    flowed->least_A = both > flowed->least_A ? both : flowed->least_A;
}

void td_evidence_tried(td_evidence *evidence, const td_config *config, td_wide gain, td_wide least_A)
{
    const td_flowed *flowed = &evidence->flowed;

    evidence->stage = TD_STAGE_TRIED;
    /* A gain too small to be felt is no evidence, nor is a current that did not flow. */
    if (!(gain >= TD_TRIAL_GAIN / 2 && (td_wide)flowed->least_A >= least_A && agrees(flowed->both / flowed->expected)))
        return;
    if (config->host_starts || !config->calibration.has_accelerometer || evidence->agreed)
        evidence->bits |= TD_TRIAL_FINISHED;
}

void td_evidence_other_library(td_evidence *evidence)
{
    evidence->bits &= (uint8_t)~TD_TRIAL_FINISHED;
    if (evidence->stage > TD_STAGE_PULSED)
        evidence->stage = TD_STAGE_PULSED;
}
