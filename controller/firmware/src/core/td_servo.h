/* The servo: readings in, command and events out, once per servo period (test oracle tests/benches/oracle/servo.py).
 *
 *     IDLE     no command                                     arm -> ARMED
 *     ARMED    feedback                                       contact or excite -> PLAYING, disarm -> IDLE
 *     PLAYING  feedback and transient                         end -> ARMED, disarm -> IDLE
 *     FAULT    no command, from the tick of its detection on  reset -> IDLE once the cause is gone
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
    const td_bank *bank; /* NULL if there is no library: then arming is refused */
    uint8_t state;                 /* TD_STATE_... */
    uint8_t fault;                 /* the first that tripped; TD_NO_FAULT if none did */
    uint32_t latched;              /* all that tripped, see td_fault_bit */
    uint32_t counts[TD_NOTICES];   /* how often each notice was given, modulo 2^32 */
    td_wide gain, wanted_gain;     /* present gain, and the one that it follows in small steps */
    td_real scale;                 /* factor on the blend in `play` that the coil's heat allows */
    td_real expected_A[TD_DELAY_TICKS + 1]; /* current of the amplifier model at the next switching instant, and earlier */
    td_real least_A, most_A;       /* its bounds for every amplifier within the tolerance */
    td_real earlier_A;             /* feedback current wanted one tick ago */
    td_real transient_A, command_A; /* of the last tick */
    td_play play;
    td_real sample_A;      /* previous sample of the blend */
    td_real part;          /* fraction of a tick by which sample j is played late */
    int32_t index, last;   /* next sample; end of the waveform */
    bool engaged;          /* the wall may push: the stylus was above the surface since arming and since the surface was set */
    bool was_saturated, read;
    bool held; /* losing the grip during this waveform is a fault */
    td_wide z_m, v_m_s;    /* present height and filtered velocity */
    td_real ring_z[TD_MAX_LATENCY_TICKS + 1], ring_v[TD_MAX_LATENCY_TICKS + 1]; /* the wall's law uses the oldest */
    int32_t ring_next;
    td_approach approach;
    td_trigger trigger;
    td_watch watch;
    td_guard guard;
} td_servo;

/* Initialise in IDLE with gain 1; `bank` may be NULL. */
void td_servo_start(td_servo *servo, const td_config *config, const td_bank *bank);

/* Requests of the host, between two ticks. */

/* Arm from IDLE; false in FAULT or without a bank. */
bool td_servo_arm(td_servo *servo);

/* Start the host's waveform in ARMED: it plays from the next tick on, with opposite sign if `negative`. False if it must
 * not play now; the coil's heat allows all of it or nothing. */
bool td_servo_excite(td_servo *servo, bool negative);

/* Go to IDLE, without command from the next tick on; a fault stays latched. */
void td_servo_disarm(td_servo *servo);

/* Go from FAULT to IDLE if no cause remained at the last tick; returns whether no fault is latched. */
bool td_servo_reset(td_servo *servo);

/* Set the factor on transient and feedback together, 0 to 1; other values are clamped, NaN to 0. */
void td_servo_set_gain(td_servo *servo, td_wide gain);

/* Set the surface in the servo's configuration. The stylus does not move by this, and a wall sees no velocity. As after
 * arming, neither wall nor contact acts before the stylus has been above the surface. */
void td_servo_set_surface(td_servo *servo, td_config *config, td_wide counts);

/* A current within these bounds may already flow. */
void td_servo_flowing(td_servo *servo, td_real least_A, td_real most_A);

/* One servo period: compute the command for one tick's readings; then state the command that was issued. */
void td_servo_answer(td_servo *servo, const td_readings *readings, td_output *output);
void td_servo_applied(td_servo *servo, td_real command_A);

/* Both, if the computed command is issued. */
void td_servo_step(td_servo *servo, const td_readings *readings, td_output *output);

#endif
