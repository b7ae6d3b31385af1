/* Evidence that a device has gathered under its configuration since its start, and since the last of TD_EVIDENCE_FAULTS:
 * sound pulses, a finished trial.
 *
 * The device itself verifies its wiring; it does not rely on a host's word. Pulses whose current, acceleration and path a
 * model predicts verify amplifier, monitor, motor, accelerometer and encoder; a trial tap compares the encoder's scale
 * with the integral of the accelerometer.
 */
#ifndef TD_EVIDENCE_H
#define TD_EVIDENCE_H

#include "td_pulse.h"

/* Motion of the stylus by the encoder and by the accelerometer, through equal filters, and their products over the last
 * half second: s^3 / (s + p)^3 of the position, s / (s + p)^3 of the acceleration. This removes gravity, offset and the
 * encoder's zero, and requires no rest, which a trembling hand never has. */
typedef struct {
    int32_t open, blocks, origin; /* readings of the present block; complete blocks so far; counts of the first reading */
    int32_t size;                 /* readings per block; computed with `fading` from the servo period, once */
    int64_t open_counts;
    td_wide open_m_s2, fading;
    td_wide low[3];    /* position: low-pass part that each stage removes [m] */
    td_wide way[2];    /* acceleration: leaky integral and double integral [m/s], [m] */
    td_wide way_low;   /* low-pass part that the third stage removes from it */
    td_wide by_both, by_encoder, by_accelerometer; /* products of the two, exponentially weighted */
} td_motion;

/* Current in a trial: sums of the products of expected and measured current, and the largest size that both reached at
 * the same time, by the host's scales and by the hardware's own units, whichever is smaller. */
typedef struct {
    td_wide expected, both;
    td_real least_A;
} td_flowed;

typedef struct {
    uint8_t bits, stage; /* TD_PULSE_SOUND, TD_TRIAL_FINISHED; TD_STAGE_... */
    uint16_t pulses;
    bool agreed; /* encoder and accelerometer agreed on a motion, in a trial of any library */
    td_flowed flowed;
    double current_ratio, acceleration_ratio, path_ratio, speed_ratio; /* measured over predicted, NaN if not measured */
    td_motion motion;
} td_evidence;

/* Start without evidence. */
void td_evidence_start(td_evidence *evidence);

/* One tick's corrected readings. */
void td_evidence_see(td_evidence *evidence, const td_config *config, const td_readings *seen);

/* Pulses begin, or were cut: discard the evidence of earlier ones. */
void td_evidence_pulsing(td_evidence *evidence);

/* Whether the pulse that has just ended was so wrong that none may follow. */
bool td_evidence_is_wrong(const td_config *config, const td_pulse *pulse, td_wide grip_N);

/* Pairs of pulses have ended, at this grip. */
void td_evidence_pulsed(td_evidence *evidence, const td_config *config, const td_pulse *pulse, td_wide grip_N);

/* A trial begins. */
void td_evidence_trying(td_evidence *evidence);

/* A contact came during a trial. */
void td_evidence_contact(td_evidence *evidence, const td_config *config);

/* One tick of a playing trial: the current expected by the model, and the corrected reading. */
void td_evidence_flows(td_evidence *evidence, const td_config *config, td_real expected_A, td_real measured_A);

/* A trial was played to its end at this gain. `least_A`: a smaller current is no evidence. */
void td_evidence_tried(td_evidence *evidence, const td_config *config, td_wide gain, td_wide least_A);

/* Another library was activated, which requires its own trial. */
void td_evidence_other_library(td_evidence *evidence);

#endif
