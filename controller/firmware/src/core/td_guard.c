#include "td_guard.h"

#include <math.h>

#define COPPER_PER_K 0.0039 /* temperature coefficient of resistance */
#define PWM_RIPPLE_A 0.02   /* seed Eq. 7 */

void td_guard_start(td_guard *guard, const td_coil *coil)
{
    guard->winding_C = coil->start_winding_C;
    guard->housing_C = coil->start_housing_C;
    guard->sum = guard->square = 0;
    guard->count = 0;
}

void td_guard_warm(td_guard *guard, const td_guard *other)
{
    if (other->winding_C > guard->winding_C)
        guard->winding_C = other->winding_C;
    if (other->housing_C > guard->housing_C)
        guard->housing_C = other->housing_C;
}

/* Implicit midpoint: T_m = T + h/2 f(T_m) is linear in both temperatures, then T + 2 (T_m - T). */
static void update(td_guard *guard, const td_coil *coil, td_wide power_W)
{
    const td_wide a11 = coil->a11 - coil->by_w * COPPER_PER_K * power_W;
    const td_wide b1 = guard->winding_C + coil->by_w * power_W * coil->cold;
    const td_wide b2 = guard->housing_C + coil->inflow_C;
    const td_wide determinant = a11 * coil->a22 - coil->a12 * coil->a21;
    const td_wide winding = 2 * (b1 * coil->a22 - coil->a12 * b2) / determinant - guard->winding_C;
    const td_wide housing = 2 * (a11 * b2 - coil->a21 * b1) / determinant - guard->housing_C;
    /* The midpoint rule fails if copper doubles its resistance within one update, which no coil does. */
    const bool sound = a11 > 0.5;

    guard->winding_C = sound && winding <= TD_CEILING_C ? winding : TD_CEILING_C;
    guard->housing_C = sound && housing <= TD_CEILING_C ? housing : TD_CEILING_C;
}

void td_guard_step(td_guard *guard, const td_coil *coil, td_real current_A)
{
    const td_real effective = td_size(current_A) + (td_real)PWM_RIPPLE_A;

    guard->square = effective * effective;
    guard->sum += guard->square;
    guard->count++;
    if (guard->count >= coil->ticks) {
        update(guard, coil, coil->R_ohm * ((td_wide)guard->sum / guard->count));
        guard->sum = 0;
        guard->count = 0;
    }
}

bool td_guard_too_hot(const td_guard *guard, const td_coil *coil)
{
    const td_wide coming_K = coil->rise_K * (td_wide)(guard->sum + coil->dying_ticks * guard->square);

    /* Written so that a NaN is too hot. */
    return !(guard->winding_C + coming_K <= coil->limit_C);
}

td_allowed td_guard_allowed(const td_guard *guard, const td_coil *coil, td_wide transient_A, td_wide cool_A,
                            td_wide feedback_A, int32_t ticks, td_wide root_ticks)
{
    const td_wide left = coil->play_limit_C - guard->winding_C, warmer = guard->housing_C - guard->winding_C;
    const td_wide inflow_K = warmer > 0 ? (td_wide)ticks * coil->from_housing * warmer : 0;
    const td_wide ripple = PWM_RIPPLE_A * root_ticks, whole = transient_A + feedback_A + ripple;
    const bool cooler = cool_A < transient_A;
    td_allowed found = {1, 0};
    td_wide steady, without, norm_A;

    /* Bound on the winding's rise [K]: the energy of a sum of currents is at most that of the sum of their norms. */
    if (coil->rise_K * whole * whole + inflow_K <= left)
        return found;
    found.scale = 0;
    steady = feedback_A + ripple;
    without = coil->rise_K * steady * steady + inflow_K;
    if (!(without < left && transient_A > 0))
        return found;
    /* rise = a (n + m)^2 + h with a m^2 + h = `without` */
    norm_A = sqrt(steady * steady + (left - without) / coil->rise_K) - steady;
    if (cooler && norm_A >= cool_A) {
        const td_wide cooled = (transient_A - norm_A) / (transient_A - cool_A);

        found.scale = 1;
        found.cooled = cooled > 0 ? cooled : 0;
        return found;
    }
    found.scale = norm_A / (cooler ? cool_A : transient_A);
    if (!(found.scale >= coil->least_scale))
        found.scale = 0;
    else if (cooler)
        found.cooled = 1;
    return found;
}
