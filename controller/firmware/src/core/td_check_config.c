#include <math.h>

#include "td_bytes.h"
#include "td_check.h"

#define AGREEMENT 1e-9 /* relative: two libraries' exp() and inverses differ by less, two sets of settings by more */
#define UPDATE_S 0.01  /* of the coil */
#define COPPER_PER_K 0.0039
#define RESISTANCE_REFERENCE_C 25.0
#define PI 3.141592653589793

static bool is_flag(int place)
{
    return place == TD_CFG_HAS_SLEW_LIMIT_A_PER_S || place == TD_CFG_HAS_ASSUMED_GRIP_N ||
           place == TD_CFG_HAS_AMPLIFIER || place == TD_CFG_HAS_WALL || place == TD_CFG_HAS_COIL ||
           place == TD_CFG_HOST_STARTS;
}

static bool is_whole(int place)
{
    return place == TD_CFG_WINDOW_TICKS || place == TD_CFG_ENCODER_LIMIT_COUNTS ||
           place == TD_CFG_WALL_LATENCY_TICKS || place == TD_CFG_COIL_NODES;
}

static bool is(double value, double other)
{
    return !(value < other || value > other);
}

/* Numbers of the settings that may be zero; the two that may be negative are asked for apart. */
static bool may_be_zero(int place)
{
    static const uint8_t places[] = {
        TD_CFG_LEAD_S,     TD_CFG_AMPLIFIER_TOLERANCE, TD_CFG_REARM_S,      TD_CFG_GRIP_FILTER_S, TD_CFG_GRIP_MARGIN_N,
        TD_CFG_GRID_SLACK, TD_CFG_GRID_SLACK_N,        TD_CFG_WITHHOLD_K,   TD_CFG_GRIP_MIN_N,    TD_CFG_ASSUMED_GRIP_N,
    };
    size_t j;

    for (j = 0; j < sizeof places; j++) {
        if (places[j] == place)
            return true;
    }
    return false;
}

/* Whole periods, at least one; halves go to the even neighbour. */
static double ticks(double duration_s, double dt_s)
{
    const double periods = duration_s / dt_s, below = floor(periods), part = periods - below;
    const double whole = part < 0.5 || (!(part > 0.5) && !(fmod(below, 2) > 0)) ? below : below + 1;

    return whole > 1 ? whole : 1;
}

/* Whether the settings themselves hold (controller/servo/settings.py and what it is made of). */
static bool holds(const double *n)
{
    int place;

    for (place = TD_CFG_DT_S; place <= TD_CFG_ASSUMED_GRIP_N; place++) {
        if (place == TD_CFG_SURFACE_COUNTS || place == TD_CFG_GRIP_OPEN_N || is_flag(place))
            continue;
        if (place == TD_CFG_SLEW_LIMIT_A_PER_S && !(n[TD_CFG_HAS_SLEW_LIMIT_A_PER_S] > 0))
            continue;
        if (place == TD_CFG_ASSUMED_GRIP_N && !(n[TD_CFG_HAS_ASSUMED_GRIP_N] > 0))
            continue;
        if (!(may_be_zero(place) ? n[place] >= 0 : n[place] > 0))
            return false;
    }
    if (!(n[TD_CFG_GRIP_OPEN_N] < n[TD_CFG_GRIP_SHORT_N] && n[TD_CFG_AMPLIFIER_TOLERANCE] < 1 &&
          n[TD_CFG_WINDOW_TICKS] >= 4))
        return false;
    if (n[TD_CFG_HOST_STARTS] > 0 && n[TD_CFG_HAS_WALL] > 0)
        return false;
    if (n[TD_CFG_HAS_AMPLIFIER] > 0 && !(n[TD_CFG_AMPLIFIER_POLE_HZ] > 0 && n[TD_CFG_AMPLIFIER_DELAY_S] >= 0 &&
                                         n[TD_CFG_AMPLIFIER_COMMAND_LIMIT_A] > 0))
        return false;
    if (n[TD_CFG_HAS_WALL] > 0 &&
        !(n[TD_CFG_WALL_STIFFNESS_N_M] >= 0 && n[TD_CFG_WALL_DAMPING_N_S_M] >= 0 &&
          n[TD_CFG_WALL_FORCE_PER_CURRENT_N_A] > 0 && n[TD_CFG_WALL_DERIVATIVE_FILTER_HZ] > 0 &&
          n[TD_CFG_WALL_LATENCY_TICKS] >= 0))
        return false;
    if (n[TD_CFG_HAS_COIL] > 0) {
        for (place = TD_CFG_COIL_R_OHM; place <= TD_CFG_COIL_TAU_H_S; place++) {
            if (!(n[place] > 0))
                return false;
        }
        return (is(n[TD_CFG_COIL_NODES], 1) || is(n[TD_CFG_COIL_NODES], 2)) &&
               n[TD_CFG_COIL_START_WINDING_C] <= n[TD_CFG_COIL_LIMIT_C];
    }
    return true;
}

/* Rows of the parabola's fit over the ages 0 .. window - 1, from the adjugate of its normal matrix. */
static void fit(double window, double ahead, double *value, double *slope)
{
    double s[5] = {0, 0, 0, 0, 0}, age, power, determinant, c[3][3];
    int j;

    for (age = 0; age < window; age++) {
        for (power = 1, j = 0; j < 5; power *= age, j++)
            s[j] += power;
    }
    c[0][0] = s[2] * s[4] - s[3] * s[3];
    c[0][1] = c[1][0] = s[2] * s[3] - s[1] * s[4];
    c[0][2] = c[2][0] = s[1] * s[3] - s[2] * s[2];
    c[1][1] = s[0] * s[4] - s[2] * s[2];
    c[1][2] = c[2][1] = s[1] * s[2] - s[0] * s[3];
    c[2][2] = s[0] * s[2] - s[1] * s[1];
    determinant = s[0] * c[0][0] + s[1] * c[0][1] + s[2] * c[0][2];
    for (j = 0; j < 3; j++) {
        value[j] = (c[0][j] - ahead * c[1][j] + ahead * ahead * c[2][j]) / determinant;
        slope[j] = (2 * ahead * c[2][j] - c[1][j]) / determinant;
    }
}

/* What follows from the settings for the coil. */
static void derive_coil(double *n)
{
    const double periods = ticks(UPDATE_S, n[TD_CFG_DT_S]), half = periods * n[TD_CFG_DT_S] / 2;
    const double winding = 1 / n[TD_CFG_COIL_R_WH_K_W], housing = 1 / n[TD_CFG_COIL_R_HA_K_W];
    const double by_w = half / (n[TD_CFG_COIL_TAU_W_S] * winding);
    const double by_h = n[TD_CFG_COIL_NODES] > 1.5 ? half / (n[TD_CFG_COIL_TAU_H_S] * housing) : 0;
    const double warm = 1 + COPPER_PER_K * (n[TD_CFG_COIL_LIMIT_C] - RESISTANCE_REFERENCE_C);

    n[TD_CFG_GUARD_TICKS] = periods;
    n[TD_CFG_GUARD_BY_W] = by_w;
    n[TD_CFG_GUARD_A11] = 1 + by_w * winding;
    n[TD_CFG_GUARD_A12] = -by_w * winding;
    n[TD_CFG_GUARD_A21] = -by_h * winding;
    n[TD_CFG_GUARD_A22] = 1 + by_h * (winding + housing);
    n[TD_CFG_GUARD_INFLOW_C] = by_h * housing * n[TD_CFG_COIL_AMBIENT_C];
    n[TD_CFG_GUARD_COLD] = 1 - COPPER_PER_K * RESISTANCE_REFERENCE_C;
    n[TD_CFG_GUARD_RISE_K] =
        n[TD_CFG_COIL_R_OHM] * warm * (n[TD_CFG_COIL_R_WH_K_W] / n[TD_CFG_COIL_TAU_W_S]) * n[TD_CFG_DT_S];
    n[TD_CFG_GUARD_FROM_HOUSING] = n[TD_CFG_DT_S] / n[TD_CFG_COIL_TAU_W_S];
    n[TD_CFG_GUARD_LIMIT_C] = n[TD_CFG_COIL_LIMIT_C];
    n[TD_CFG_GUARD_PLAY_LIMIT_C] = n[TD_CFG_COIL_LIMIT_C] - n[TD_CFG_WITHHOLD_K];
}

/* The table as a host makes it of these settings: parts that are not there are zero, the rest follows. */
static void derive(double *n)
{
    const double dt = n[TD_CFG_DT_S], off = n[TD_CFG_AMPLIFIER_TOLERANCE];
    const bool driven = n[TD_CFG_HAS_AMPLIFIER] > 0, walled = n[TD_CFG_HAS_WALL] > 0;
    const double rate = driven ? 2 * PI * n[TD_CFG_AMPLIFIER_POLE_HZ] * dt : 0;
    int place;

    for (place = TD_CFG_COMMAND_LIMIT_A; place < TD_CFG_COUNT; place++)
        n[place] = 0;
    for (place = TD_CFG_AMPLIFIER_POLE_HZ; place < TD_CFG_HAS_WALL && !driven; place++)
        n[place] = 0;
    for (place = TD_CFG_WALL_STIFFNESS_N_M; place < TD_CFG_HAS_COIL && !walled; place++)
        n[place] = 0;
    for (place = TD_CFG_COIL_R_OHM; place <= TD_CFG_COIL_NODES && !(n[TD_CFG_HAS_COIL] > 0); place++)
        n[place] = 0;
    if (!(n[TD_CFG_HAS_SLEW_LIMIT_A_PER_S] > 0))
        n[TD_CFG_SLEW_LIMIT_A_PER_S] = 0;
    if (!(n[TD_CFG_HAS_ASSUMED_GRIP_N] > 0))
        n[TD_CFG_ASSUMED_GRIP_N] = 0;
    n[TD_CFG_COMMAND_LIMIT_A] = driven ? n[TD_CFG_AMPLIFIER_COMMAND_LIMIT_A] : n[TD_CFG_CURRENT_LIMIT_A];
    n[TD_CFG_DECAY] = driven ? exp(-rate) : 0;
    n[TD_CFG_DECAY_FAST] = driven ? exp(-rate * (1 + off)) : 0;
    n[TD_CFG_DECAY_SLOW] = driven ? exp(-rate * (1 - off)) : 0;
    n[TD_CFG_PREFILTER_NOW] = 1 / (1 - n[TD_CFG_DECAY]);
    n[TD_CFG_PREFILTER_BEFORE] = -n[TD_CFG_DECAY] / (1 - n[TD_CFG_DECAY]);
    n[TD_CFG_SLEW_A] = n[TD_CFG_SLEW_LIMIT_A_PER_S] * dt;
    n[TD_CFG_GAIN_STEP] = n[TD_CFG_GAIN_RATE_1_S] * dt;
    n[TD_CFG_VELOCITY_SMOOTHING] = walled ? exp(-2 * PI * n[TD_CFG_WALL_DERIVATIVE_FILTER_HZ] * dt) : 0;
    n[TD_CFG_REARM_TICKS] = ticks(n[TD_CFG_REARM_S], dt);
    n[TD_CFG_OVER_CURRENT_A] = n[TD_CFG_OVER_CURRENT] * n[TD_CFG_CURRENT_LIMIT_A];
    n[TD_CFG_NO_CURRENT_TICKS] = ticks(n[TD_CFG_NO_CURRENT_S], dt);
    n[TD_CFG_STUCK_TICKS] = ticks(n[TD_CFG_STUCK_S], dt);
    n[TD_CFG_ENCODER_RATE_M_S] = n[TD_CFG_APPROACH_RATE_M_S] = n[TD_CFG_COUNT_M] / dt;
    n[TD_CFG_GRIP_NEW_PART] = n[TD_CFG_GRIP_FILTER_S] > dt ? dt / n[TD_CFG_GRIP_FILTER_S] : 1;
    fit(n[TD_CFG_WINDOW_TICKS], n[TD_CFG_LEAD_S] / dt, n + TD_CFG_APPROACH_VALUE_0, n + TD_CFG_APPROACH_SLOPE_0);
    if (n[TD_CFG_HAS_COIL] > 0)
        derive_coil(n);
}

/* Whether it asks for more than this device has; the first such number, NaN if there is none. */
static double beyond(const double *n, const td_hardware *hardware)
{
    const bool driven = n[TD_CFG_HAS_AMPLIFIER] > 0, walled = n[TD_CFG_HAS_WALL] > 0;
    const double asked[][2] = {
        {n[TD_CFG_WINDOW_TICKS], TD_MAX_WINDOW_TICKS},
        {n[TD_CFG_ENCODER_LIMIT_COUNTS], TD_ENCODER_MOST_COUNTS},
        {walled ? n[TD_CFG_WALL_LATENCY_TICKS] : 0, TD_MAX_LATENCY_TICKS},
        {n[TD_CFG_REARM_S], TD_LONGEST_S},
        {n[TD_CFG_NO_CURRENT_S], TD_LONGEST_S},
        {n[TD_CFG_STUCK_S], TD_LONGEST_S},
        {n[TD_CFG_CURRENT_LIMIT_A], hardware->current_A},
        {driven ? n[TD_CFG_AMPLIFIER_COMMAND_LIMIT_A] : n[TD_CFG_CURRENT_LIMIT_A], hardware->command_A},
    };
    size_t j;

    for (j = 0; j < sizeof asked / sizeof asked[0]; j++) {
        if (!(asked[j][0] <= asked[j][1]))
            return asked[j][0];
    }
    return (double)NAN;
}

td_refusal td_check_config(const uint8_t *bytes, const td_hardware *hardware, td_config *config)
{
    double came[TD_CFG_COUNT], again[TD_CFG_COUNT], value;
    int j;

    if (td_get_u32(bytes) != TD_CONFIGURATION_MAGIC || td_get_u16(bytes + 4) != TD_CONFIGURATION_VERSION ||
        td_get_u16(bytes + 6) != TD_CFG_COUNT)
        return td_refuse(TD_REASON_BAD_FORMAT, TD_CONFIGURATION_BYTES);
    for (j = 0; j < TD_CFG_COUNT; j++) {
        value = came[j] = again[j] = td_get_f64(bytes + TD_CONFIGURATION_VALUES + 8 * j);
        if (!isfinite(value) || (is_flag(j) && !is(value, 0) && !is(value, 1)) ||
            (is_whole(j) && !is(value, floor(value))))
            return td_refuse(TD_REASON_BAD_VALUE, value);
    }
    if (!holds(came))
        return td_refuse(TD_REASON_BAD_CONFIGURATION, (double)NAN);
    if (!is(came[TD_CFG_DT_S], hardware->dt_s))
        return td_refuse(TD_REASON_BAD_TIMING, came[TD_CFG_DT_S]);
    value = beyond(came, hardware);
    if (!isnan(value))
        return td_refuse(TD_REASON_BEYOND_HARDWARE, value);
    derive(again);
    for (j = 0; j < TD_CFG_COUNT; j++) {
        if (!isfinite(again[j]))
            return td_refuse(TD_REASON_BAD_CONFIGURATION, (double)NAN);
    }
    for (j = 0; j < TD_CFG_COUNT; j++) {
        if (!(fabs(came[j] - again[j]) <= AGREEMENT * fabs(again[j])))
            return td_refuse(TD_REASON_BAD_CONFIGURATION, came[j]);
    }
    if (!td_config_unpack(config, bytes, TD_CONFIGURATION_BYTES))
        return td_refuse(TD_REASON_BAD_CONFIGURATION, (double)NAN);
    return td_granted;
}
