/* Everything the servo is told before it runs: numbers worked out by the host, so that nothing here takes an exp. */
#ifndef TD_CONFIG_H
#define TD_CONFIG_H

#include "td_messages.h"
#include "td_real.h"

/* Coil, one implicit midpoint step of its two nodes per update (controller/servo/guard.py). */
typedef struct {
    bool present;
    int32_t ticks;                             /* servo periods per update */
    td_wide by_w;                              /* half an update over the winding's capacity [K/W] */
    td_wide a11, a12, a21, a22;                /* the step's matrix without copper's feedback */
    td_wide inflow_C, cold;                    /* what the ambient gives the housing; copper at 0 C */
    td_wide R_ohm, rise_K, from_housing;       /* rise_K: of the winding per A^2 and tick, at the limit */
    td_wide limit_C, play_limit_C;             /* no transient starts above the second */
    td_wide start_winding_C, start_housing_C;
    td_wide least_scale;                       /* a transient that has to be smaller is withheld */
} td_coil;

/* Virtual wall (seed Eq. 9); absent: only transients. */
typedef struct {
    bool present;
    td_real stiffness_N_m, damping_N_s_m, force_per_current_N_A;
    int32_t latency_ticks;
    td_wide smoothing; /* of the derivative filter */
} td_wall;

/* See controller/servo/settings.py for what each is for. */
typedef struct {
    td_wide dt_s, lead_s;
    /* encoder, approach, contact */
    td_wide count_m, surface_counts;
    td_wide encoder_m_s, approach_m_s; /* one count per tick, as the faults and as the fit have it */
    int32_t encoder_limit_counts, window_ticks;
    td_wide value[3], slope[3]; /* rows of the fit, evaluated the lead ahead of the newest reading */
    td_wide least_speed_m_s, touch_height_m, rearm_height_m;
    int32_t rearm_ticks;
    /* amplifier and limits */
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
    int32_t missing_limit, still_limit; /* ticks */
    td_coil coil;
    bool host_starts; /* the one waveform plays at the host's word; contacts are not looked at */
} td_config;

/* The table of float64 that controller/protocol/configuration.py writes; whether it is one, of this version, and every whole
 * number in it fits this core. Whether its numbers make sense is asked by td_configure.h. */
bool td_config_unpack(td_config *config, const uint8_t *bytes, size_t size);

#endif
