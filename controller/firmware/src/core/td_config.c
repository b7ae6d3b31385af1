#include "td_config.h"

#include <math.h>
#include <string.h>

#include "td_bytes.h"

#define MOST_TICKS 1e9 /* longest duration */
#define UPDATE_S 0.01  /* period of the coil's updates */
#define DYING_TICKS 4  /* ticks of the present current: until the command acts, and the energy left then */
#define COPPER_PER_K 0.0039
#define RESISTANCE_REFERENCE_C 25.0
#define PI 3.141592653589793

typedef struct {
    double n[TD_CFG_COUNT];
    bool sound;
} table;

static bool flag(const table *from, int32_t place)
{
    return from->n[place] > 0;
}

/* A number used in every tick, as td_real. */
static td_real narrow(table *from, double value)
{
    const td_real narrowed = (td_real)value;

    if (!isfinite(narrowed))
        from->sound = false;
    return narrowed;
}

static td_wide wide(table *from, double value)
{
    if (!isfinite(value))
        from->sound = false;
    return value;
}

/* A divisor, which must not be so small that quotients of ordinary numbers overflow. */
static void divides(table *from, td_real value)
{
    if (!(td_size(value) > (td_real)1e-30))
        from->sound = false;
}

static int32_t whole(table *from, double value, double least, double most)
{
    if (!(value >= least && value <= most)) {
        from->sound = false;
        return 0;
    }
    return (int32_t)value;
}

/* Whole periods, at least one; halves are rounded to even. */
static double periods(double duration_s, double dt_s)
{
    const double exact = duration_s / dt_s, below = floor(exact), part = exact - below;
    const double nearest = part < 0.5 || (!(part > 0.5) && !(fmod(below, 2) > 0)) ? below : below + 1;

    return nearest > 1 ? nearest : 1;
}

/* Duration of a deviation before it is a fault. */
static int32_t patience(table *from, double duration_s)
{
    const double ticks = periods(duration_s, from->n[TD_CFG_DT_S]);

    return whole(from, ticks > TD_FEWEST_TICKS ? ticks : TD_FEWEST_TICKS, 1, MOST_TICKS);
}

static double delay_ticks(const table *from)
{
    return flag(from, TD_CFG_HAS_AMPLIFIER) ? from->n[TD_CFG_AMPLIFIER_DELAY_S] / from->n[TD_CFG_DT_S] : 0;
}

/* The fits of the approach, over the whole window and, if it has enough readings, over its newer half. */
static void fits(td_config *config, table *from, double ahead)
{
    int j;

    config->half_ticks = config->window_ticks / 2;
    config->whole = config->half = td_parabola_fit(config->window_ticks, ahead);
    memset(config->bend, 0, sizeof config->bend);
    if (config->half_ticks >= TD_LEAST_READINGS) {
        config->half = td_parabola_fit(config->half_ticks, ahead);
        td_parabola_bend(config->window_ticks, config->bend);
    }
    for (j = 0; j < 3; j++) {
        wide(from, config->whole.value[j] + config->whole.slope[j]);
        wide(from, config->half.value[j] + config->half.slope[j]);
        wide(from, config->bend[j] + config->bend[3]);
    }
}

static void unpack_wall(td_wall *wall, table *from, double dt_s)
{
    const double *n = from->n;

    memset(wall, 0, sizeof *wall);
    wall->present = flag(from, TD_CFG_HAS_WALL);
    if (!wall->present)
        return;
    wall->stiffness_N_m = narrow(from, n[TD_CFG_WALL_STIFFNESS_N_M]);
    wall->damping_N_s_m = narrow(from, n[TD_CFG_WALL_DAMPING_N_S_M]);
    wall->force_per_current_N_A = narrow(from, n[TD_CFG_WALL_FORCE_PER_CURRENT_N_A]);
    divides(from, wall->force_per_current_N_A);
    wall->latency_ticks = whole(from, n[TD_CFG_WALL_LATENCY_TICKS], 0, TD_MAX_LATENCY_TICKS);
    wall->smoothing = wide(from, exp(-2 * PI * n[TD_CFG_WALL_DERIVATIVE_FILTER_HZ] * dt_s));
}

void td_coil_derive(td_coil *coil, const td_coil_numbers *of, double dt_s, double withhold_K)
{
    const double ticks = periods(UPDATE_S, dt_s), half = ticks * dt_s / 2;
    const double by_w = half / (of->tau_w_s / of->R_wh_K_W);
    const double by_h = of->housing_moves ? half / (of->tau_h_s / of->R_ha_K_W) : 0;
    const double g_w = 1 / of->R_wh_K_W, g_h = 1 / of->R_ha_K_W;

    coil->present = true;
    coil->ticks = ticks <= MOST_TICKS ? (int32_t)ticks : 0;
    coil->by_w = by_w;
    coil->a11 = 1 + by_w * g_w;
    coil->a12 = -by_w * g_w;
    coil->a21 = -by_h * g_w;
    coil->a22 = 1 + by_h * (g_w + g_h);
    coil->inflow_C = by_h * g_h * of->ambient_C;
    coil->cold = 1 - COPPER_PER_K * RESISTANCE_REFERENCE_C;
    coil->R_ohm = of->R_ohm;
    coil->rise_K = of->R_ohm * (1 + COPPER_PER_K * (of->limit_C - RESISTANCE_REFERENCE_C)) *
                   (of->R_wh_K_W / of->tau_w_s) * dt_s;
    coil->dying_ticks = (td_real)DYING_TICKS;
    coil->from_housing = dt_s / of->tau_w_s;
    coil->limit_C = of->limit_C;
    coil->play_limit_C = of->limit_C - withhold_K;
}

bool td_coil_sound(const td_coil *coil)
{
    return coil->ticks > 0 && isfinite(coil->by_w) && isfinite(coil->a11) && isfinite(coil->a12) &&
           isfinite(coil->a21) && isfinite(coil->a22) && isfinite(coil->inflow_C) && isfinite(coil->R_ohm) &&
           isfinite(coil->rise_K) && coil->rise_K > 0 && isfinite(coil->from_housing) && isfinite(coil->limit_C) &&
           isfinite(coil->play_limit_C) && isfinite(coil->a11 * coil->a22 - coil->a12 * coil->a21);
}

static void unpack_coil(td_coil *coil, table *from)
{
    const double *n = from->n;
    const td_coil_numbers numbers = {
        n[TD_CFG_COIL_R_OHM],   n[TD_CFG_COIL_R_WH_K_W], n[TD_CFG_COIL_R_HA_K_W],  n[TD_CFG_COIL_TAU_W_S],
        n[TD_CFG_COIL_TAU_H_S], n[TD_CFG_COIL_LIMIT_C],  n[TD_CFG_COIL_AMBIENT_C], n[TD_CFG_COIL_NODES] > 1.5,
    };

    memset(coil, 0, sizeof *coil);
    if (!flag(from, TD_CFG_HAS_COIL))
        return;
    td_coil_derive(coil, &numbers, n[TD_CFG_DT_S], n[TD_CFG_WITHHOLD_K]);
    coil->start_winding_C = wide(from, n[TD_CFG_COIL_START_WINDING_C]);
    coil->start_housing_C = wide(from, n[TD_CFG_COIL_START_HOUSING_C]);
    coil->least_scale = wide(from, n[TD_CFG_LEAST_SCALE]);
    if (!td_coil_sound(coil))
        from->sound = false;
}

static void unpack_motion(td_config *config, table *from)
{
    const double *n = from->n;

    config->count_m = wide(from, n[TD_CFG_COUNT_M]);
    config->surface_counts = wide(from, n[TD_CFG_SURFACE_COUNTS]);
    config->encoder_m_s = config->approach_m_s = wide(from, n[TD_CFG_COUNT_M] / n[TD_CFG_DT_S]);
    config->encoder_limit_counts = whole(from, n[TD_CFG_ENCODER_LIMIT_COUNTS], 1, TD_ENCODER_MOST_COUNTS);
    config->window_ticks = whole(from, n[TD_CFG_WINDOW_TICKS], 4, TD_MAX_WINDOW_TICKS);
    fits(config, from, n[TD_CFG_LEAD_S] / n[TD_CFG_DT_S]);
    config->least_speed_m_s = wide(from, n[TD_CFG_LEAST_SPEED_M_S]);
    config->touch_height_m = wide(from, n[TD_CFG_TOUCH_HEIGHT_M]);
    config->rearm_height_m = wide(from, n[TD_CFG_REARM_HEIGHT_M]);
    config->rearm_ticks = whole(from, periods(n[TD_CFG_REARM_S], n[TD_CFG_DT_S]), 1, MOST_TICKS);
}

static void unpack_faults(td_config *config, table *from)
{
    const double *n = from->n;

    config->fastest_m_s = narrow(from, n[TD_CFG_FASTEST_M_S]);
    config->current_range_A = narrow(from, n[TD_CFG_CURRENT_RANGE_A]);
    config->over_current_A = narrow(from, n[TD_CFG_OVER_CURRENT] * n[TD_CFG_CURRENT_LIMIT_A]);
    config->no_current_A = narrow(from, n[TD_CFG_NO_CURRENT_A]);
    config->no_current_part = narrow(from, n[TD_CFG_NO_CURRENT_PART]);
    config->stuck_A = narrow(from, n[TD_CFG_STUCK_A]);
    config->stuck_A_s = narrow(from, n[TD_CFG_STUCK_A_S]);
    config->missing_limit = patience(from, n[TD_CFG_NO_CURRENT_S]);
    config->still_limit = whole(from, periods(n[TD_CFG_STUCK_S], n[TD_CFG_DT_S]), 1, MOST_TICKS);
}

/* Cross-checks of encoder, accelerometer and current (test oracle tests/benches/oracle/crosscheck.py); after the pulse. */
static void unpack_crosscheck(td_config *config, table *from)
{
    const double *n = from->n, dt = n[TD_CFG_DT_S];
    const td_pulse_plan *pulse = &config->pulse;
    double push = pulse->nodes > 0 ? pulse->acceleration[0] : TD_QUIET_PUSH_M_S2 / TD_QUIET_SWING_A;
    double stuck_m = TD_STUCK_COUNTS * n[TD_CFG_COUNT_M], swing_A;
    int32_t j;

    for (j = 1; j < pulse->nodes; j++)
        push = pulse->acceleration[j] < push ? pulse->acceleration[j] : push;
    swing_A = TD_QUIET_PUSH_M_S2 / push;
    swing_A = swing_A > TD_QUIET_SWING_A ? swing_A : TD_QUIET_SWING_A;
    stuck_m = stuck_m > TD_STUCK_LEAST_M ? stuck_m : TD_STUCK_LEAST_M;
    /* An excitation may be played on a rotor that is blocked intentionally. */
    if (!config->calibration.has_accelerometer || config->host_starts)
        stuck_m = swing_A = (double)INFINITY;
    config->turns_limit = config->host_starts ? INT32_MAX : TD_STUCK_TURNS;
    config->tick_s = (td_real)n[TD_CFG_DT_S];
    config->step_m = (td_real)n[TD_CFG_COUNT_M];
    config->stuck_m = (td_real)stuck_m;
    config->swing_A = (td_real)swing_A;
    config->rest_limit = whole(from, periods(TD_FOLLOW_STILL_S, dt), 1, MOST_TICKS);
    config->block_ticks = whole(from, periods(TD_QUIET_BLOCK_S, dt), 1, MOST_TICKS);
    config->wrong_limit = patience(from, TD_WRONG_CURRENT_S);
}

static void unpack_amplifier(td_config *config, table *from)
{
    const double *n = from->n, dt = n[TD_CFG_DT_S], off = n[TD_CFG_AMPLIFIER_TOLERANCE];
    const bool driven = flag(from, TD_CFG_HAS_AMPLIFIER);
    const double rate = driven ? 2 * PI * n[TD_CFG_AMPLIFIER_POLE_HZ] * dt : (double)INFINITY;
    const double decay = exp(-rate);

    config->decay = narrow(from, decay);
    config->fast = narrow(from, exp(-rate * (1 + off)));
    config->slow = narrow(from, exp(-rate * (1 - off)));
    divides(from, 1 - config->decay);
    divides(from, 1 - config->fast);
    config->now = narrow(from, 1 / (1 - decay));
    config->before = narrow(from, -decay / (1 - decay));
    divides(from, config->now);
    config->late_ticks = whole(from, floor(delay_ticks(from) + TD_ROUNDED_TICKS), 0, TD_DELAY_TICKS);
    config->current_limit_A = narrow(from, n[TD_CFG_CURRENT_LIMIT_A]);
    config->command_limit_A = narrow(from, driven ? n[TD_CFG_AMPLIFIER_COMMAND_LIMIT_A] : n[TD_CFG_CURRENT_LIMIT_A]);
    config->has_slew = flag(from, TD_CFG_HAS_SLEW_LIMIT_A_PER_S);
    config->slew_A = config->has_slew ? narrow(from, n[TD_CFG_SLEW_LIMIT_A_PER_S] * dt) : 0;
    config->gain_step = wide(from, n[TD_CFG_GAIN_RATE_1_S] * dt);
}

static void unpack_grip(td_config *config, table *from)
{
    const double *n = from->n, dt = n[TD_CFG_DT_S];

    config->has_grip = !flag(from, TD_CFG_HAS_ASSUMED_GRIP_N);
    config->assumed_grip_N = config->has_grip ? 0 : narrow(from, n[TD_CFG_ASSUMED_GRIP_N]);
    config->new_grip = narrow(from, n[TD_CFG_GRIP_FILTER_S] > dt ? dt / n[TD_CFG_GRIP_FILTER_S] : 1);
    config->grip_min_N = narrow(from, n[TD_CFG_GRIP_MIN_N]);
    config->grip_margin_N = narrow(from, n[TD_CFG_GRIP_MARGIN_N]);
    config->grip_open_N = narrow(from, n[TD_CFG_GRIP_OPEN_N]);
    config->grip_short_N = narrow(from, n[TD_CFG_GRIP_SHORT_N]);
    config->grid_slack = wide(from, n[TD_CFG_GRID_SLACK]);
    config->grid_slack_N = wide(from, n[TD_CFG_GRID_SLACK_N]);
}

static void unpack_calibration(td_calibration *calibration, table *from)
{
    const double *n = from->n;

    calibration->encoder_direction = n[TD_CFG_ENCODER_DIRECTION] < 0 ? -1 : 1;
    calibration->has_accelerometer = flag(from, TD_CFG_HAS_ACCELEROMETER);
    calibration->acceleration_scale = narrow(from, n[TD_CFG_ACCELERATION_SCALE]);
    calibration->acceleration_rest_m_s2 = narrow(from, n[TD_CFG_ACCELERATION_REST_M_S2]);
    calibration->grip_scale = narrow(from, n[TD_CFG_GRIP_SCALE]);
    calibration->grip_zero_N = narrow(from, n[TD_CFG_GRIP_ZERO_N]);
    calibration->monitor_scale = narrow(from, n[TD_CFG_MONITOR_SCALE]);
    calibration->amplifier_scale = narrow(from, n[TD_CFG_AMPLIFIER_SCALE]);
    divides(from, calibration->amplifier_scale);
}

static void unpack_pulse(td_pulse_plan *pulse, table *from)
{
    const double *n = from->n, dt = n[TD_CFG_DT_S];
    const double push = periods(TD_PUSH_S, dt);
    int32_t j;

    pulse->current_A = n[TD_CFG_PULSE_A];
    pulse->ticks = whole(from, n[TD_CFG_PULSE_TICKS], 1, UINT16_MAX);
    pulse->skip_ticks = whole(from, ceil(delay_ticks(from)) + 1, 1, TD_DELAY_TICKS + 2);
    pulse->push_ticks = push < pulse->ticks ? (int32_t)push : pulse->ticks;
    pulse->nodes = whole(from, n[TD_CFG_PULSE_NODES], 0, TD_PULSE_NODES);
    for (j = 0; j < TD_PULSE_NODES; j++) {
        pulse->grip_N[j] = n[TD_CFG_PULSE_GRIP_N_0 + j];
        pulse->acceleration[j] = n[TD_CFG_PULSE_ACCELERATION_0 + j];
        pulse->path_m[j] = n[TD_CFG_PULSE_PATH_M_0 + j];
    }
}

bool td_config_unpack(td_config *config, const uint8_t *bytes, size_t size)
{
    table from;
    int32_t j;

    if (size != TD_CONFIGURATION_BYTES || td_get_u32(bytes) != TD_CONFIGURATION_MAGIC ||
        td_get_u16(bytes + 4) != TD_CONFIGURATION_VERSION || td_get_u16(bytes + 6) != TD_CFG_COUNT)
        return false;
    from.sound = true;
    for (j = 0; j < TD_CFG_COUNT; j++)
        from.n[j] = wide(&from, td_get_f64(bytes + TD_CONFIGURATION_VALUES + 8 * j));
    config->dt_s = from.n[TD_CFG_DT_S];
    divides(&from, (td_real)config->dt_s);
    config->lead_s = from.n[TD_CFG_LEAD_S];
    config->host_starts = flag(&from, TD_CFG_HOST_STARTS);
    unpack_amplifier(config, &from);
    unpack_grip(config, &from);
    unpack_motion(config, &from);
    unpack_wall(&config->wall, &from, config->dt_s);
    unpack_faults(config, &from);
    unpack_coil(&config->coil, &from);
    unpack_calibration(&config->calibration, &from);
    unpack_pulse(&config->pulse, &from);
    unpack_crosscheck(config, &from);
    return from.sound;
}
