/* What a device has seen of itself since it started under its configuration: sound pulses, a finished trial.
 *
 * A host cannot say that a device is wired as it should be; the device finds it out. Pulses whose current, acceleration
 * and path a model predicts show the amplifier, its monitor, the motor, the accelerometer and the encoder; a trial tap
 * shows the encoder's scale against the accelerometer's integral.
 */
#ifndef TD_EVIDENCE_H
#define TD_EVIDENCE_H

#include "td_pulse.h"

/* The stylus' motion by the encoder and by the accelerometer, through one filter, and their products over the last
 * half second: s^3 / (s + p)^3 of the position, s / (s + p)^3 of the acceleration. So neither gravity, nor an offset, nor
 * where the encoder's zero is shows, and no rest has to be waited for, which a trembling hand never gives. */
typedef struct {
    int32_t open, blocks, origin; /* readings of the block under way; whole blocks so far; counts of the first reading */
    int32_t size;                 /* of a block; it and `fading` follow from the servo period, once per block */
    int64_t open_counts;
    td_wide open_m_s2, fading;
    td_wide low[3];    /* of the position: what each stage takes off it [m] */
    td_wide way[2];    /* of the acceleration: leaky integral and double integral [m/s], [m] */
    td_wide way_low;   /* and what the third stage takes off that */
    td_wide by_both, by_encoder, by_accelerometer; /* products of the two, fading */
} td_motion;

/* What flowed in a trial: products of the current that was expected and of the one that was measured, and the largest
 * size that both of them had at once, by the scales that the host states and by the hardware's own units. */
typedef struct {
    td_wide expected, both;
    td_real least_A;
} td_flowed;

typedef struct {
    uint8_t bits, stage; /* TD_PULSE_SOUND, TD_TRIAL_FINISHED; TD_STAGE_... */
    uint16_t pulses;
    bool agreed; /* encoder and accelerometer have told of one motion, in a trial of whatever library */
    td_flowed flowed;
    double current_ratio, acceleration_ratio, path_ratio, speed_ratio; /* measured on predicted, NaN where not measured */
    td_motion motion;
} td_evidence;

/* Nothing is known. */
void td_evidence_start(td_evidence *evidence);

/* One tick's corrected readings. */
void td_evidence_see(td_evidence *evidence, const td_config *config, const td_readings *seen);

/* Pulses begin, or were cut: what was known of them is forgotten. */
void td_evidence_pulsing(td_evidence *evidence);

/* Whether the pulse that has just ended was so wrong that no other one may follow. */
bool td_evidence_is_wrong(const td_config *config, const td_pulse *pulse, td_wide grip_N);

/* Pairs of pulses have ended, at this grip. */
void td_evidence_pulsed(td_evidence *evidence, const td_config *config, const td_pulse *pulse, td_wide grip_N);

/* A trial begins. */
void td_evidence_trying(td_evidence *evidence);

/* In a trial a contact came. */
void td_evidence_contact(td_evidence *evidence, const td_config *config);

/* One tick of a trial that plays: the current that the model expects, and the corrected reading. */
void td_evidence_flows(td_evidence *evidence, const td_config *config, td_real expected_A, td_real measured_A);

/* A trial was played to its end, at this gain; `least_A`: a smaller current proves nothing. */
void td_evidence_tried(td_evidence *evidence, const td_config *config, td_wide gain, td_wide least_A);

/* Another library: its own trial is still to come. */
void td_evidence_other_library(td_evidence *evidence);

#endif
