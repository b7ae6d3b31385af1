/* What a device has seen of itself since it started under its configuration: sound pulses, a finished trial.
 *
 * A host cannot say that a device is wired as it should be; the device finds it out. Pulses whose current, acceleration
 * and path a model predicts show the amplifier, its monitor, the motor, the accelerometer and the encoder; a trial tap
 * shows the encoder's scale against the accelerometer's integral.
 */
#ifndef TD_EVIDENCE_H
#define TD_EVIDENCE_H

#include "td_pulse.h"

/* Where the stylus last rested, and what the accelerometer's integral says since: blocks of readings, the newest of which
 * may already belong to a motion that has not reached a count. */
typedef struct {
    td_wide sum_m_s2[TD_REST_BLOCKS]; /* ring of the last whole blocks */
    int32_t least[TD_REST_BLOCKS], most[TD_REST_BLOCKS], blocks, next;
    td_wide open_m_s2; /* the block under way */
    int32_t open_least, open_most, open;
    bool known;       /* the stylus has rested, not too long ago */
    td_wide rest_m_s2; /* mean acceleration then */
    td_wide speed_m_s; /* since then, outwards */
    int32_t ticks;     /* since then */
} td_motion;

typedef struct {
    uint8_t bits, stage; /* TD_PULSE_SOUND, TD_TRIAL_FINISHED; TD_STAGE_... */
    uint16_t pulses;
    double current_ratio, acceleration_ratio, path_ratio, speed_ratio; /* measured on predicted, NaN where not measured */
    td_motion motion;
} td_evidence;

/* Nothing is known. */
void td_evidence_start(td_evidence *evidence);

/* One tick's corrected readings. */
void td_evidence_see(td_evidence *evidence, const td_config *config, const td_readings *seen);

/* Pulses begin, or were cut: what was known of them is forgotten. */
void td_evidence_pulsing(td_evidence *evidence);

/* Pairs of pulses have ended, at this grip. */
void td_evidence_pulsed(td_evidence *evidence, const td_config *config, const td_pulse *pulse, td_wide grip_N);

/* A trial begins. */
void td_evidence_trying(td_evidence *evidence);

/* In a trial a contact came, at this speed by the encoder. */
void td_evidence_contact(td_evidence *evidence, const td_config *config, td_wide speed_m_s);

/* A trial was played to its end, at this gain. */
void td_evidence_tried(td_evidence *evidence, const td_config *config, td_wide gain);

#endif
