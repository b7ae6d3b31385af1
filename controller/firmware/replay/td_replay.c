#include "td_replay.h"

#include <math.h>

#include "td_bytes.h"

size_t td_replay_size(void)
{
    return sizeof(td_replay);
}

bool td_replay_start(
    td_replay *replay, const uint8_t *config, size_t config_size, const uint8_t *image, size_t image_size)
{
    if (!td_config_unpack(&replay->config, config, config_size))
        return false;
    if (!td_bank_open(&replay->bank, image, image_size))
        return false;
    td_servo_start(&replay->servo, &replay->config, &replay->bank);
    replay->tick = 0;
    return true;
}

static uint8_t grant(td_servo *servo, uint8_t wishes, td_wide gain)
{
    uint8_t answers = 0;

    if ((wishes & TD_WISH_RESET) && td_servo_reset(servo))
        answers |= TD_WISH_RESET;
    if (wishes & TD_WISH_DISARM)
        td_servo_disarm(servo);
    if (wishes & TD_WISH_GAIN)
        td_servo_set_gain(servo, gain);
    if ((wishes & TD_WISH_ARM) && td_servo_arm(servo))
        answers |= TD_WISH_ARM;
    if ((wishes & TD_WISH_EXCITE) && td_servo_excite(servo, (wishes & TD_WISH_NEGATIVE) != 0))
        answers |= TD_WISH_EXCITE;
    return answers;
}

void td_replay_run(td_replay *replay, const uint8_t *input, size_t ticks, uint8_t *output)
{
    for (; ticks > 0; ticks--, input += TD_REPLAY_IN, output += TD_REPLAY_OUT) {
        td_readings readings;
        td_output answer;
        const td_event *first = &answer.events[0];
        int32_t j;

        readings.tick = replay->tick++;
        readings.emergency_stop = input[1] != 0;
        readings.encoder_counts = td_get_i32(input + 4);
        readings.grip_N = (td_real)td_get_f64(input + 16);
        readings.current_A = (td_real)td_get_f64(input + 24);
        readings.acceleration_m_s2 = (td_real)td_get_f64(input + 32);
        readings.late = readings.host_stop = false;
        memset(output, 0, TD_REPLAY_OUT);
        output[49] = grant(&replay->servo, input[0], td_get_f64(input + 8));
        td_servo_step(&replay->servo, &readings, &answer);
        td_put_f64(output, (double)answer.command_A);
        td_put_f64(output + 8, (double)answer.transient_A);
        td_put_f64(output + 16, (double)answer.feedback_A);
        td_put_f64(output + 24, (double)answer.winding_C);
        td_put_f64(output + 32, answer.event_count > 0 ? (double)first->speed_m_s : (double)NAN);
        td_put_f64(output + 40, answer.event_count > 0 ? (double)first->grip_N : (double)NAN);
        output[48] = (uint8_t)answer.state;
        output[50] = (uint8_t)answer.event_count;
        for (j = 0; j < answer.event_count; j++)
            output[51 + j] = answer.events[j].what;
    }
}

void td_replay_coil(const td_replay *replay, double *heat_C)
{
    heat_C[0] = (double)replay->servo.guard.winding_C;
    heat_C[1] = (double)replay->servo.guard.housing_C;
}

void td_replay_heat(td_replay *replay, const double *size_A, size_t ticks, size_t every, double *winding_C)
{
    size_t k;

    for (k = 0; k < ticks; k++) {
        td_guard_step(&replay->servo.guard, &replay->config.coil, (td_real)size_A[k]);
        if ((k + 1) % every == 0)
            winding_C[k / every] = replay->servo.guard.winding_C;
    }
}
