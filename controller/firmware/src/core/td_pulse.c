#include "td_pulse.h"

#include <math.h>
#include <string.h>

static void begin(td_pulse *pulse)
{
    pulse->at = 0;
    pulse->rest_A = pulse->rest_m_s2 = pulse->driven_A = pulse->pushed_m_s2 = 0;
    pulse->rests = pulse->drives = pulse->pushes = 0;
}

void td_pulse_start(td_pulse *pulse, const td_config *config, td_real current_A, int32_t ticks, int32_t pairs)
{
    const int32_t answered = config->pulse.skip_ticks + config->pulse.push_ticks;

    memset(pulse, 0, sizeof *pulse);
    pulse->judged = pairs > 0;
    pulse->left = pairs > 0 ? 2 * pairs : 1;
    pulse->size_A = td_size(current_A);
    pulse->sign = current_A < 0 ? -1 : 1;
    pulse->ticks = ticks;
    /* Also before a single pulse: pulses in succession without a rest would be a permanent current. */
    pulse->rest_ticks = (int32_t)ceil(TD_REST_BETWEEN_PULSES_S / config->dt_s);
    pulse->cycle_ticks = pulse->rest_ticks + ticks;
    if (pulse->judged) {
        /* Up to the reading after the last command, and all readings of the acceleration's mean. */
        pulse->cycle_ticks = pulse->rest_ticks + (answered > ticks + 1 ? answered : ticks + 1);
    }
    begin(pulse);
}

static void end(td_pulse *pulse)
{
    pulse->done++;
    pulse->last_A = pulse->sign * (pulse->driven_A / pulse->drives - pulse->rest_A / pulse->rests);
    pulse->last_m_s2 = pulse->sign * (pulse->pushed_m_s2 / pulse->pushes - pulse->rest_m_s2 / pulse->rests);
    pulse->current_A += pulse->last_A;
    pulse->acceleration_m_s2 += pulse->last_m_s2;
}

void td_pulse_see(td_pulse *pulse, const td_config *config, const td_readings *seen)
{
    const td_pulse_plan *plan = &config->pulse;
    const int32_t into = pulse->at - pulse->rest_ticks;

    if (!pulse->judged)
        return;
    if (into < 0) {
        if (2 * pulse->at >= pulse->rest_ticks) {
            pulse->rest_A += (td_wide)seen->current_A;
            pulse->rest_m_s2 += (td_wide)seen->acceleration_m_s2;
            pulse->rests++;
        }
        return;
    }
    if (into == 0)
        pulse->begin_counts = seen->encoder_counts;
    if (2 * into >= pulse->ticks && into < pulse->ticks) {
        pulse->driven_A += (td_wide)seen->current_A;
        pulse->drives++;
    }
    if (into >= plan->skip_ticks && into < plan->skip_ticks + plan->push_ticks) {
        pulse->pushed_m_s2 += (td_wide)seen->acceleration_m_s2;
        pulse->pushes++;
    }
    if (into == pulse->ticks)
        pulse->path_counts += pulse->sign * ((td_wide)seen->encoder_counts - pulse->begin_counts);
    if (pulse->at == pulse->cycle_ticks - 1)
        end(pulse);
}

td_real td_pulse_command(const td_pulse *pulse)
{
    const int32_t into = pulse->at - pulse->rest_ticks;

    return pulse->left > 0 && into >= 0 && into < pulse->ticks ? (td_real)pulse->sign * pulse->size_A : 0;
}

bool td_pulse_next(td_pulse *pulse)
{
    pulse->at++;
    if (pulse->at < pulse->cycle_ticks)
        return false;
    pulse->left--;
    pulse->sign = -pulse->sign;
    begin(pulse);
    return pulse->left == 0;
}
