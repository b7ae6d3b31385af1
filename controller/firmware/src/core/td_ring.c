#include "td_ring.h"

#include <math.h>
#include <string.h>

#include "td_watch.h"

#define PI 3.141592653589793
#define BELOW_LIMIT_K 0.1
#ifdef TD_REAL_FLOAT
#define ROUNDING 1e-4 /* share of the current limit that exceeds the accumulated rounding of the bounds */
#else
#define ROUNDING 1e-9
#endif

static bool is_size(double value)
{
    return value > 0 && value < 1e9;
}

static bool coil_is_sound(const td_hardware *h)
{
    return is_size(h->R_ohm) && is_size(h->R_wh_K_W) && is_size(h->R_ha_K_W) && is_size(h->tau_w_s) &&
           is_size(h->tau_h_s) && h->limit_C > h->ambient_C && h->limit_C < 1e9 && h->ambient_C > -1e9;
}

/* What the guard itself may have kept, which is no colder than any coil; anything else, NaN too, is not known. */
static double known(double temperature_C, double otherwise_C)
{
    return temperature_C >= TD_COLDEST_C && temperature_C <= TD_CEILING_C ? temperature_C : otherwise_C;
}

static void start_coil(td_ring *ring, const td_hardware *h, double winding_C, double housing_C)
{
    const td_coil_numbers numbers = {
        h->R_ohm, h->R_wh_K_W, h->R_ha_K_W, h->tau_w_s, h->tau_h_s, h->limit_C, h->ambient_C, true,
    };
    const double hottest_C = h->limit_C - BELOW_LIMIT_K;
    /* In the steady state the same heat flows through both resistances. */
    const double steady_C = h->ambient_C + (hottest_C - h->ambient_C) * h->R_ha_K_W / (h->R_wh_K_W + h->R_ha_K_W);

    td_coil_derive(&ring->coil, &numbers, h->dt_s, 0);
    /* Commands before a trip act for the delay after it; then follows the energy of a current that decays with the slowest
     * amplifier, in ticks of the present current. */
    ring->coil.dying_ticks = (td_real)(TD_DELAY_TICKS + 1 / (1 - (double)ring->slow * (double)ring->slow));
    ring->coil.start_winding_C = known(winding_C, hottest_C);
    ring->coil.start_housing_C = known(housing_C, steady_C);
    td_guard_start(&ring->guard, &ring->coil);
    if (!td_coil_sound(&ring->coil))
        ring->sound = false;
}

void td_ring_start(td_ring *ring, const td_hardware *hardware, double winding_C, double housing_C)
{
    const td_hardware *h = hardware;

    memset(ring, 0, sizeof *ring);
    ring->sound = is_size(h->dt_s) && is_size(h->current_A) && is_size(h->command_A) && is_size(h->over_current_A) &&
                  is_size(h->pole_least_Hz) && is_size(h->pole_most_Hz) && h->pole_least_Hz <= h->pole_most_Hz &&
                  (!h->has_coil || coil_is_sound(h));
    if (!ring->sound)
        return;
    ring->current_A = (td_real)(h->current_A * (1 - ROUNDING));
    ring->command_A = (td_real)(h->command_A * (1 - ROUNDING));
    ring->over_current_A = (td_real)h->over_current_A;
    ring->fast = (td_real)exp(-2 * PI * h->pole_most_Hz * h->dt_s);
    ring->slow = (td_real)exp(-2 * PI * h->pole_least_Hz * h->dt_s);
    /* Single precision hardly resolves one tick of a slower pole, which no amplifier has. */
    if (!(1 - ring->slow > (td_real)1e-3))
        ring->sound = false;
    else if (h->has_coil)
        start_coil(ring, h, winding_C, housing_C);
}

uint32_t td_ring_watch(td_ring *ring, td_real measured_A)
{
    const bool finite = td_size(measured_A) < (td_real)1e30;
    /* The servo detects an invalid reading; the coil's estimate then uses the largest current that is no fault. */
    const td_real measured = finite ? td_size(measured_A) : ring->over_current_A;
    uint32_t faults = 0;

    if (td_size(measured_A) > ring->over_current_A)
        faults |= td_fault_bit(TD_WHAT_OVER_CURRENT);
    if (!ring->coil.present)
        return faults;
    td_guard_step(&ring->guard, &ring->coil, measured > ring->flowing_A ? measured : ring->flowing_A);
    if (td_guard_too_hot(&ring->guard, &ring->coil))
        faults |= td_fault_bit(TD_WHAT_OVER_TEMPERATURE);
    return faults;
}

td_real td_ring_limited(const td_ring *ring, td_real command_A)
{
    td_real high, low;

    /* Written so that NaN is caught. */
    if (!ring->sound || !(td_size(command_A) < (td_real)1e30))
        return 0;
    /* e i + (1 - e) c is closest to a limit for the fastest amplifier and the current nearest to it. */
    high = (ring->current_A - ring->fast * ring->most_A) / (1 - ring->fast);
    low = (-ring->current_A - ring->fast * ring->least_A) / (1 - ring->fast);
    return td_within(td_within(command_A, low, high), -ring->command_A, ring->command_A);
}

void td_ring_follow(td_ring *ring, td_real command_A)
{
    const td_real most = command_A > ring->most_A ? ring->fast : ring->slow;
    const td_real least = command_A < ring->least_A ? ring->fast : ring->slow;
    td_real before = ring->most_A > -ring->least_A ? ring->most_A : -ring->least_A, after;

    ring->most_A = most * ring->most_A + (1 - most) * command_A;
    ring->least_A = least * ring->least_A + (1 - least) * command_A;
    after = ring->most_A > -ring->least_A ? ring->most_A : -ring->least_A;
    ring->flowing_A = after > before ? after : before;
}
