#include <math.h>

#include "td_bytes.h"
#include "td_check.h"

static bool is_flag(int place)
{
    return place == TD_CFG_HAS_SLEW_LIMIT_A_PER_S || place == TD_CFG_HAS_ASSUMED_GRIP_N ||
           place == TD_CFG_HAS_AMPLIFIER || place == TD_CFG_HAS_WALL || place == TD_CFG_HAS_COIL ||
           place == TD_CFG_HOST_STARTS || place == TD_CFG_HAS_ACCELEROMETER;
}

static bool is_whole(int place)
{
    return place == TD_CFG_WINDOW_TICKS || place == TD_CFG_ENCODER_LIMIT_COUNTS ||
           place == TD_CFG_WALL_LATENCY_TICKS || place == TD_CFG_COIL_NODES || place == TD_CFG_ENCODER_DIRECTION ||
           place == TD_CFG_PULSE_TICKS || place == TD_CFG_PULSE_NODES;
}

static bool is(double value, double other)
{
    return !(value < other || value > other);
}

/* Numbers of the settings that may have any sign; they are checked separately. */
static bool may_be_negative(int place)
{
    static const uint8_t places[] = {
        TD_CFG_SURFACE_COUNTS,         TD_CFG_GRIP_OPEN_N, TD_CFG_ENCODER_DIRECTION, TD_CFG_ACCELERATION_SCALE,
        TD_CFG_ACCELERATION_REST_M_S2, TD_CFG_GRIP_SCALE,  TD_CFG_GRIP_ZERO_N,       TD_CFG_MONITOR_SCALE,
        TD_CFG_AMPLIFIER_SCALE,
    };
    size_t j;

    for (j = 0; j < sizeof places; j++) {
        if (places[j] == place)
            return true;
    }
    return false;
}

/* Numbers of the settings that may be zero. */
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

static bool is_scale(double value)
{
    return fabs(value) >= TD_SCALE_LEAST && fabs(value) <= TD_SCALE_MOST;
}

/* Whether the calibration of the sensors and the prediction of the test pulse are valid. */
static bool calibration_holds(const double *n)
{
    int j;

    if (!is(fabs(n[TD_CFG_ENCODER_DIRECTION]), 1) || !is_scale(n[TD_CFG_ACCELERATION_SCALE]) ||
        !is_scale(n[TD_CFG_GRIP_SCALE]) || !is_scale(n[TD_CFG_MONITOR_SCALE]) || !is_scale(n[TD_CFG_AMPLIFIER_SCALE]) ||
        !(n[TD_CFG_PULSE_NODES] >= 0 && n[TD_CFG_PULSE_NODES] <= TD_PULSE_NODES))
        return false;
    for (j = 0; j < (int)n[TD_CFG_PULSE_NODES]; j++) {
        const double grip = n[TD_CFG_PULSE_GRIP_N_0 + j];

        if (!(grip >= 0) || (j > 0 && !(grip > n[TD_CFG_PULSE_GRIP_N_0 + j - 1])) ||
            !(n[TD_CFG_PULSE_ACCELERATION_0 + j] > 0) || !(n[TD_CFG_PULSE_PATH_M_0 + j] > 0))
            return false;
    }
    return true;
}

/* Whether the settings are valid in themselves (the checks of controller/servo/settings.py and its parts). */
static bool holds(const double *n)
{
    int place;

    for (place = TD_CFG_DT_S; place <= TD_CFG_ASSUMED_GRIP_N; place++) {
        if (may_be_negative(place) || is_flag(place) ||
            (place >= TD_CFG_PULSE_NODES && place <= TD_CFG_PULSE_PATH_M_3))
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
    if (!calibration_holds(n) || (n[TD_CFG_HOST_STARTS] > 0 && n[TD_CFG_HAS_WALL] > 0))
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

/* The larger of a stated size and of the size that the hardware gets for it through the scale. The host states the scale,
 * so both have to be within the hardware's limit. */
static double to_hardware(double size, double scale)
{
    return fabs(scale) < 1 ? size / fabs(scale) : size;
}

/* The first number that exceeds this device's limits, NaN if there is none. */
static double beyond(const double *n, const td_hardware *hardware)
{
    const double amplifier = n[TD_CFG_AMPLIFIER_SCALE], monitor = n[TD_CFG_MONITOR_SCALE];
    const bool driven = n[TD_CFG_HAS_AMPLIFIER] > 0, walled = n[TD_CFG_HAS_WALL] > 0;
    const bool heated = n[TD_CFG_HAS_COIL] > 0 && hardware->has_coil;
    const double asked[][2] = {
        {n[TD_CFG_WINDOW_TICKS], TD_MAX_WINDOW_TICKS},
        {n[TD_CFG_ENCODER_LIMIT_COUNTS], TD_ENCODER_MOST_COUNTS},
        {walled ? n[TD_CFG_WALL_LATENCY_TICKS] : 0, TD_MAX_LATENCY_TICKS},
        {driven ? n[TD_CFG_AMPLIFIER_DELAY_S] : 0, (TD_DELAY_TICKS + TD_ROUNDED_TICKS) * hardware->dt_s},
        {n[TD_CFG_REARM_S], TD_LONGEST_S},
        {n[TD_CFG_NO_CURRENT_S], TD_LONGEST_S},
        {n[TD_CFG_STUCK_S], TD_LONGEST_S},
        {to_hardware(n[TD_CFG_CURRENT_LIMIT_A], amplifier), hardware->current_A},
        {to_hardware(driven ? n[TD_CFG_AMPLIFIER_COMMAND_LIMIT_A] : n[TD_CFG_CURRENT_LIMIT_A], amplifier), hardware->command_A},
        {driven ? n[TD_CFG_AMPLIFIER_POLE_HZ] * (1 + n[TD_CFG_AMPLIFIER_TOLERANCE]) : 0, hardware->pole_most_Hz},
        {driven ? -n[TD_CFG_AMPLIFIER_POLE_HZ] * (1 - n[TD_CFG_AMPLIFIER_TOLERANCE]) : -(double)INFINITY,
         -hardware->pole_least_Hz},
        {to_hardware(n[TD_CFG_OVER_CURRENT] * n[TD_CFG_CURRENT_LIMIT_A], monitor), hardware->over_current_A},
        {heated ? n[TD_CFG_COIL_LIMIT_C] : 0, hardware->limit_C},
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
    double n[TD_CFG_COUNT], value;
    int j;

    if (td_get_u32(bytes) != TD_CONFIGURATION_MAGIC || td_get_u16(bytes + 4) != TD_CONFIGURATION_VERSION ||
        td_get_u16(bytes + 6) != TD_CFG_COUNT)
        return td_refuse(TD_REASON_BAD_FORMAT, td_get_u16(bytes + 4));
    for (j = 0; j < TD_CFG_COUNT; j++) {
        value = n[j] = td_get_f64(bytes + TD_CONFIGURATION_VALUES + 8 * j);
        if (!isfinite(value) || (is_flag(j) && !is(value, 0) && !is(value, 1)) ||
            (is_whole(j) && !is(value, floor(value))))
            return td_refuse(TD_REASON_BAD_VALUE, value);
    }
    if (!holds(n))
        return td_refuse(TD_REASON_BAD_CONFIGURATION, (double)NAN);
    if (!is(n[TD_CFG_DT_S], hardware->dt_s))
        return td_refuse(TD_REASON_BAD_TIMING, n[TD_CFG_DT_S]);
    value = beyond(n, hardware);
    if (!isnan(value))
        return td_refuse(TD_REASON_BEYOND_HARDWARE, value);
    if (!td_config_unpack(config, bytes, TD_CONFIGURATION_BYTES))
        return td_refuse(TD_REASON_BAD_CONFIGURATION, (double)NAN);
    return td_granted;
}
