#include "td_config.h"

#include "td_bytes.h"

#define MOST_TICKS 1e9 /* of any duration */

typedef struct {
    const uint8_t *numbers;
    bool sound;
} table;

static td_wide number(const table *from, int32_t place)
{
    return td_get_f64(from->numbers + 8 * place);
}

static td_real narrow(const table *from, int32_t place)
{
    return (td_real)number(from, place);
}

static bool flag(const table *from, int32_t place)
{
    return number(from, place) > 0;
}

static int32_t whole(table *from, int32_t place, td_wide least, td_wide most)
{
    const td_wide value = number(from, place);

    if (!(value >= least && value <= most)) {
        from->sound = false;
        return 0;
    }
    return (int32_t)value;
}

static void unpack_wall(td_wall *wall, table *from)
{
    wall->present = flag(from, TD_CFG_HAS_WALL);
    wall->stiffness_N_m = narrow(from, TD_CFG_WALL_STIFFNESS_N_M);
    wall->damping_N_s_m = narrow(from, TD_CFG_WALL_DAMPING_N_S_M);
    wall->force_per_current_N_A = narrow(from, TD_CFG_WALL_FORCE_PER_CURRENT_N_A);
    wall->latency_ticks = whole(from, TD_CFG_WALL_LATENCY_TICKS, 0, TD_MAX_LATENCY_TICKS);
    wall->smoothing = number(from, TD_CFG_VELOCITY_SMOOTHING);
}

static void unpack_coil(td_coil *coil, table *from)
{
    coil->present = flag(from, TD_CFG_HAS_COIL);
    coil->ticks = whole(from, TD_CFG_GUARD_TICKS, coil->present ? 1 : 0, MOST_TICKS);
    coil->by_w = number(from, TD_CFG_GUARD_BY_W);
    coil->a11 = number(from, TD_CFG_GUARD_A11);
    coil->a12 = number(from, TD_CFG_GUARD_A12);
    coil->a21 = number(from, TD_CFG_GUARD_A21);
    coil->a22 = number(from, TD_CFG_GUARD_A22);
    coil->inflow_C = number(from, TD_CFG_GUARD_INFLOW_C);
    coil->cold = number(from, TD_CFG_GUARD_COLD);
    coil->R_ohm = number(from, TD_CFG_COIL_R_OHM);
    coil->rise_K = number(from, TD_CFG_GUARD_RISE_K);
    coil->from_housing = number(from, TD_CFG_GUARD_FROM_HOUSING);
    coil->limit_C = number(from, TD_CFG_GUARD_LIMIT_C);
    coil->play_limit_C = number(from, TD_CFG_GUARD_PLAY_LIMIT_C);
    coil->start_winding_C = number(from, TD_CFG_COIL_START_WINDING_C);
    coil->start_housing_C = number(from, TD_CFG_COIL_START_HOUSING_C);
    coil->least_scale = number(from, TD_CFG_LEAST_SCALE);
}

static void unpack_motion(td_config *config, table *from)
{
    int32_t j;

    config->count_m = number(from, TD_CFG_COUNT_M);
    config->surface_counts = number(from, TD_CFG_SURFACE_COUNTS);
    config->encoder_m_s = number(from, TD_CFG_ENCODER_RATE_M_S);
    config->approach_m_s = number(from, TD_CFG_APPROACH_RATE_M_S);
    config->encoder_limit_counts = whole(from, TD_CFG_ENCODER_LIMIT_COUNTS, 1, TD_ENCODER_MOST_COUNTS);
    config->window_ticks = whole(from, TD_CFG_WINDOW_TICKS, 4, TD_MAX_WINDOW_TICKS);
    for (j = 0; j < 3; j++) {
        config->value[j] = number(from, TD_CFG_APPROACH_VALUE_0 + j);
        config->slope[j] = number(from, TD_CFG_APPROACH_SLOPE_0 + j);
    }
    config->least_speed_m_s = number(from, TD_CFG_LEAST_SPEED_M_S);
    config->touch_height_m = number(from, TD_CFG_TOUCH_HEIGHT_M);
    config->rearm_height_m = number(from, TD_CFG_REARM_HEIGHT_M);
    config->rearm_ticks = whole(from, TD_CFG_REARM_TICKS, 1, MOST_TICKS);
}

static void unpack_faults(td_config *config, table *from)
{
    config->fastest_m_s = narrow(from, TD_CFG_FASTEST_M_S);
    config->current_range_A = narrow(from, TD_CFG_CURRENT_RANGE_A);
    config->over_current_A = narrow(from, TD_CFG_OVER_CURRENT_A);
    config->no_current_A = narrow(from, TD_CFG_NO_CURRENT_A);
    config->no_current_part = narrow(from, TD_CFG_NO_CURRENT_PART);
    config->stuck_A = narrow(from, TD_CFG_STUCK_A);
    config->stuck_A_s = narrow(from, TD_CFG_STUCK_A_S);
    config->missing_limit = whole(from, TD_CFG_NO_CURRENT_TICKS, 1, MOST_TICKS);
    config->still_limit = whole(from, TD_CFG_STUCK_TICKS, 1, MOST_TICKS);
}

bool td_config_unpack(td_config *config, const uint8_t *bytes, size_t size)
{
    table from = {bytes + TD_CONFIGURATION_VALUES, true};

    if (size != TD_CONFIGURATION_BYTES || td_get_u32(bytes) != TD_CONFIGURATION_MAGIC ||
        td_get_u16(bytes + 4) != TD_CONFIGURATION_VERSION || td_get_u16(bytes + 6) != TD_CFG_COUNT)
        return false;
    config->dt_s = number(&from, TD_CFG_DT_S);
    config->lead_s = number(&from, TD_CFG_LEAD_S);
    config->decay = narrow(&from, TD_CFG_DECAY);
    config->fast = narrow(&from, TD_CFG_DECAY_FAST);
    config->slow = narrow(&from, TD_CFG_DECAY_SLOW);
    config->now = narrow(&from, TD_CFG_PREFILTER_NOW);
    config->before = narrow(&from, TD_CFG_PREFILTER_BEFORE);
    config->current_limit_A = narrow(&from, TD_CFG_CURRENT_LIMIT_A);
    config->command_limit_A = narrow(&from, TD_CFG_COMMAND_LIMIT_A);
    config->has_slew = flag(&from, TD_CFG_HAS_SLEW_LIMIT_A_PER_S);
    config->slew_A = narrow(&from, TD_CFG_SLEW_A);
    config->gain_step = number(&from, TD_CFG_GAIN_STEP);
    config->has_grip = !flag(&from, TD_CFG_HAS_ASSUMED_GRIP_N);
    config->assumed_grip_N = narrow(&from, TD_CFG_ASSUMED_GRIP_N);
    config->new_grip = narrow(&from, TD_CFG_GRIP_NEW_PART);
    config->grip_min_N = narrow(&from, TD_CFG_GRIP_MIN_N);
    config->grip_margin_N = narrow(&from, TD_CFG_GRIP_MARGIN_N);
    config->grip_open_N = narrow(&from, TD_CFG_GRIP_OPEN_N);
    config->grip_short_N = narrow(&from, TD_CFG_GRIP_SHORT_N);
    config->grid_slack = number(&from, TD_CFG_GRID_SLACK);
    config->grid_slack_N = number(&from, TD_CFG_GRID_SLACK_N);
    config->host_starts = flag(&from, TD_CFG_HOST_STARTS);
    unpack_motion(config, &from);
    unpack_wall(&config->wall, &from);
    unpack_faults(config, &from);
    unpack_coil(&config->coil, &from);
    return from.sound;
}
