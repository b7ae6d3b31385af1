/* Numbers of the core.
 *
 * td_real is what runs every tick: double, or float with -DTD_REAL_FLOAT for processors whose hardware has no more.
 * td_wide stays double in both, for the three places where single precision loses what matters, each measured:
 *   - the fit to the approach and what follows from encoder counts: a phase that is off by 1e-3 ticks is 1e-3 A,
 *   - the coil's temperatures, whose rise per update is below a float's resolution (23-36 % low at 10 kHz),
 *   - what is done once per contact: the place in the grid, the bound on the heat.
 * Every operation stands in the order of the Python servo, so that with doubles both give the same bits; the
 * compiler must not contract a * b + c (-ffp-contract=off).
 */
#ifndef TD_REAL_H
#define TD_REAL_H

#include "td_port.h"

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#ifdef TD_REAL_FLOAT
typedef float td_real;
#else
typedef double td_real;
#endif
typedef double td_wide;

static inline td_real td_size(td_real value)
{
    return value < 0 ? -value : value;
}

/* `value`, or the end of [low, high] that is nearer; the lower end if they cross. */
static inline td_real td_within(td_real value, td_real low, td_real high)
{
    return value < low ? low : (value > high ? high : value);
}

#endif
