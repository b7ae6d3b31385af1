/* The servo: sensors in, command and events out, once per servo period (tests/benches/oracle/servo.py, its oracle).
 *
 *     IDLE     no command                                     arm -> ARMED
 *     ARMED    feedback                                       contact or excite -> PLAYING, disarm -> IDLE
 *     PLAYING  feedback and transient                         end -> ARMED, disarm -> IDLE
 *     FAULT    no command, from the tick on that saw it       reset -> IDLE once the cause is gone
 *
 * No allocation, no I/O, no globals: all state is in the struct, configuration and bank belong to the caller and must
 * not change between td_servo_start and the last step, the bank only while the servo is neither ARMED nor PLAYING.
 */
#ifndef TD_SERVO_H
#define TD_SERVO_H

#include "td_approach.h"
#include "td_bank.h"
#include "td_config.h"
#include "td_guard.h"
#include "td_interface.h"
#include "td_watch.h"

typedef struct {
    const td_config *config;
    const td_bank *bank; /* NULL: there is nothing to play, and no arming */
    uint8_t state;                 /* TD_STATE_... */
    uint8_t fault;                 /* the first that tripped, TD_NO_FAULT without */
    uint32_t latched;              /* all that tripped, see td_fault_bit */
    uint32_t counts[TD_NOTICES];   /* how often each notice was given, modulo 2^32 */
    td_wide gain, wanted_gain;     /* in force; it follows the wanted one, in steps that would add up their rounding */
    td_real scale;                 /* how much of the blend in `play` the heat allowed */
    td_real expected_A[TD_DELAY_TICKS + 1]; /* current of the amplifier model at the coming switching instant, and before */
    td_real least_A, most_A;       /* between these it is, for every amplifier within the tolerance */
    td_real earlier_A;             /* feedback current wanted one tick ago */
    td_real transient_A, command_A; /* of the last tick */
    td_play play;
    td_real sample_A;      /* of the blend, the one before the next */
    td_real part;          /* by which sample j is played later than its tick */
    int32_t index, last;   /* next sample; the one past the end of the waveform */
    bool engaged;          /* the stylus has been above the surface since arming, and since that was moved: the wall may push */
    bool was_saturated, read;
    bool held; /* what plays ends in a fault if the grip is lost */
    td_wide z_m, v_m_s;    /* encoder and its filtered difference, now */
    td_real ring_z[TD_MAX_LATENCY_TICKS + 1], ring_v[TD_MAX_LATENCY_TICKS + 1]; /* the law answers the oldest */
    int32_t ring_next;
    td_approach approach;
    td_trigger trigger;
    td_watch watch;
    td_guard guard;
} td_servo;

/* From nothing, in IDLE, gain 1; `bank` may be NULL. */
void td_servo_start(td_servo *servo, const td_config *config, const td_bank *bank);

/* What the host may ask for, between two ticks. */

/* From IDLE; false in FAULT or without a bank. */
bool td_servo_arm(td_servo *servo);

/* From ARMED, where the host starts the waveform: play it from the coming tick on, `negative` with the other sign;
 * false if it may not be played now. The heat allows all of it or none. */
bool td_servo_excite(td_servo *servo, bool negative);

/* To IDLE, with no command from the next tick on; a fault stays. */
void td_servo_disarm(td_servo *servo);

/* Leave FAULT for IDLE if no cause remained at the last tick; whether no fault is latched any more. */
bool td_servo_reset(td_servo *servo);

/* Scale of transient and feedback together, 0 to 1; anything else goes to the nearer end, NaN to 0. */
void td_servo_set_gain(td_servo *servo, td_wide gain);

/* Another place of the surface from here on, in the configuration that the servo runs by; the stylus stays where it is,
 * and a wall felt no motion by it. As after arming, the wall pushes and a contact plays only after the stylus has been
 * above it. */
void td_servo_set_surface(td_servo *servo, td_config *config, td_wide counts);

/* The current may already flow, somewhere in these bounds. */
void td_servo_flowing(td_servo *servo, td_real least_A, td_real most_A);

/* One servo period: the command that answers one tick's readings; behind it, what in truth went out. */
void td_servo_answer(td_servo *servo, const td_readings *readings, td_output *output);
void td_servo_applied(td_servo *servo, td_real command_A);

/* Both, where what was answered goes out. */
void td_servo_step(td_servo *servo, const td_readings *readings, td_output *output);

#endif
