/* Interface between the servo and the device under it at each tick (controller/servo/interface.py). */
#ifndef TD_INTERFACE_H
#define TD_INTERFACE_H

#include "td_messages.h"
#include "td_real.h"

#define TD_NO_COUNTS TD_RECORD_NO_COUNTS /* reading of an encoder that gives no number */

/* Faults, and notices that are counted and reported but stop nothing: codes TD_WHAT_... */
#define TD_FIRST_FAULT TD_WHAT_OVER_TEMPERATURE
#define TD_FAULTS (TD_WHAT_ACCELEROMETER_DEAD - TD_FIRST_FAULT + 1)
#define TD_NO_FAULT 0
#define TD_FIRST_NOTICE TD_WHAT_CONTACT
#define TD_NOTICES (TD_WHAT_NO_GRIP - TD_FIRST_NOTICE + 1)
#define TD_MAX_EVENTS TD_FAULTS /* in one tick: every fault, or a contact with its notices */

/* Readings of the sensors at one tick. */
typedef struct {
    uint64_t tick;
    int32_t encoder_counts;    /* grow with z, out of the object; TD_NO_COUNTS if invalid */
    td_real grip_N;            /* calibrated; NaN if there is no reading */
    td_real current_A;         /* measured by the amplifier */
    td_real acceleration_m_s2; /* of the stylus; only compared with encoder and current */
    bool emergency_stop;       /* pressed */
    bool late;                 /* this tick came late, so that a command was held for too long */
    bool host_stop;            /* a stop came over the link; set by the device, not by a port */
} td_readings;

/* An event at a tick. Speed and grip are those of a contact, else NaN. For SCALED_FOR_HEAT `scale` is the factor on the
 * blend and `cooled` the share of the cool command in it, else NaN. */
typedef struct {
    uint64_t tick;
    uint8_t what; /* TD_WHAT_... */
    td_real speed_m_s;
    td_real grip_N;
    td_real scale, cooled;
} td_event;

/* Output of the servo for one tick's readings. */
typedef struct {
    td_real command_A; /* within all limits, held until the next tick */
    bool enabled;      /* whether the amplifier may be on: armed, playing or pulsing */
    uint8_t state; /* TD_STATE_... */
    td_real transient_A; /* parts of the command before the clamp */
    td_real feedback_A;
    td_real winding_C; /* estimate; NaN without coil data */
    int32_t event_count;
    td_event events[TD_MAX_EVENTS];
} td_output;

#endif
