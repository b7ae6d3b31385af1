/* The configuration of the servo, with all derived numbers computed once, so that no servo period needs an exp. */
#ifndef TD_CONFIG_H
#define TD_CONFIG_H

#include "td_messages.h"
#include "td_parabola.h"
#include "td_real.h"

#define TD_LEAST_READINGS 4 /* least readings to fit a parabola to */
#define TD_ROUNDED_TICKS 1e-9 /* rounding error of a number of ticks */

/* Coil, one implicit midpoint step of its two nodes per update (tests/benches/oracle/guard.py). */
typedef struct {
    bool present;
    int32_t ticks;                             /* servo periods per update */
    td_wide by_w;                              /* half an update over the winding's capacity [K/W] */
    td_wide a11, a12, a21, a22;                /* the step's matrix without copper's feedback */
    td_wide inflow_C, cold;                    /* the ambient's term for the housing; copper's factor at 0 C */
    td_wide R_ohm, rise_K, from_housing;       /* rise_K: of the winding per A^2 and tick, at the limit */
    td_wide limit_C, play_limit_C;             /* no transient starts above play_limit_C */
    td_wide start_winding_C, start_housing_C;
    td_real dying_ticks;                       /* ticks of the present current that follow a command of zero */
    td_wide least_scale;                       /* a transient that would have to be scaled below this is withheld */
} td_coil;

/* The stated numbers of a coil. */
typedef struct {
    double R_ohm, R_wh_K_W, R_ha_K_W, tau_w_s, tau_h_s, limit_C, ambient_C;
    bool housing_moves;
} td_coil_numbers;

/* Derive the numbers of an update; no transient starts less than `withhold_K` below the limit. */
void td_coil_derive(td_coil *coil, const td_coil_numbers *of, double dt_s, double withhold_K);

bool td_coil_sound(const td_coil *coil);

/* Virtual wall (seed Eq. 9); absent: only transients. */
typedef struct {
    bool present;
    td_real stiffness_N_m, damping_N_s_m, force_per_current_N_A;
    int32_t latency_ticks;
    td_wide smoothing; /* of the derivative filter */
} td_wall;

/* Calibration from raw readings to SI, and from a command to the amplifier's input (controller/servo/settings.py). */
typedef struct {
    int32_t encoder_direction;
    bool has_accelerometer;
    td_real acceleration_scale, acceleration_rest_m_s2, grip_scale, grip_zero_N, monitor_scale, amplifier_scale;
} td_calibration;

/* The test pulse by which a device checks its wiring, and its predicted response per ampere. */
typedef struct {
    td_wide current_A;
    int32_t ticks, skip_ticks, push_ticks; /* of it; to the first reading, and over how many, of the acceleration */
    int32_t nodes;                         /* of the prediction, over grip; 0 without */
    td_wide grip_N[TD_PULSE_NODES], acceleration[TD_PULSE_NODES], path_m[TD_PULSE_NODES];
} td_pulse_plan;

/* See controller/servo/settings.py for the meaning of each member. */
typedef struct {
    td_wide dt_s, lead_s;
    /* encoder, approach, contact */
    td_wide count_m, surface_counts;
    td_wide encoder_m_s, approach_m_s; /* one count per tick, as the faults and as the fit have it */
    int32_t encoder_limit_counts, window_ticks, half_ticks;
    td_parabola whole, half; /* fits over so many ticks, evaluated the lead ahead of the newest reading */
    td_wide bend[4];         /* row that extracts the cubic part of the readings */
    td_wide least_speed_m_s, touch_height_m, rearm_height_m;
    int32_t rearm_ticks;
    /* amplifier and limits */
    int32_t late_ticks;         /* whole servo periods of the amplifier's delay */
    td_real decay, fast, slow;  /* exp(-w dt) of the amplifier as stated, and of the fastest and the slowest */
    td_real now, before;        /* prefilter of the feedback */
    td_real current_limit_A, command_limit_A;
    bool has_slew;
    td_real slew_A; /* per tick */
    td_wide gain_step;
    td_wall wall;
    /* grip */
    bool has_grip;
    td_real assumed_grip_N, new_grip, grip_min_N, grip_margin_N, grip_open_N, grip_short_N;
    td_wide grid_slack, grid_slack_N;
    /* faults */
    td_real fastest_m_s, current_range_A, over_current_A, no_current_A, no_current_part, stuck_A, stuck_A_s;
    int32_t missing_limit, still_limit, wrong_limit; /* ticks */
    /* sensors against each other: path without a count, swing of the current that must shake; infinite without an
     * accelerometer and for an excitation. Ticks of a rest, and of a block of the window that is listened to. */
    td_real stuck_m, swing_A;
    td_real tick_s, step_m; /* period and count as td_real, since converting them at every tick is costly */
    int32_t rest_limit, block_ticks;
    int32_t turns_limit; /* of an encoder that goes back and forth between two counts; none for an excitation */
    td_coil coil;
    td_calibration calibration;
    td_pulse_plan pulse;
    bool host_starts; /* the host starts the single waveform; contacts are ignored */
} td_config;

/* The table of float64 that controller/protocol/configuration.py writes, and what follows from it; whether it is one, of
 * this version, and every number of it is one in td_real too: finite, not zero where something is divided by it, and
 * whole numbers within this core's room. Whether the numbers make sense is asked by td_check.h. */
bool td_config_unpack(td_config *config, const uint8_t *bytes, size_t size);

#endif
