/* What a device has seen of itself since it started under its configuration: sound pulses, a finished trial. */
#ifndef TD_EVIDENCE_H
#define TD_EVIDENCE_H

#include "td_config.h"
#include "td_interface.h"

typedef struct {
    uint8_t bits, stage; /* TD_PULSE_SOUND, TD_TRIAL_FINISHED; TD_STAGE_... */
    uint16_t pulses;
    double current_ratio, acceleration_ratio, path_ratio, speed_ratio; /* measured on predicted, NaN where not measured */
} td_evidence;

/* Nothing is known. */
void td_evidence_start(td_evidence *evidence);

#endif
