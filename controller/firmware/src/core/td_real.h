/* Number types of the core.
 *
 * td_real is used in every tick: double, or float with -DTD_REAL_FLOAT for processors without double precision in
 * hardware. td_wide is always double, in the three places where single precision was measured to be insufficient:
 *   - the fit to the approach and the encoder counts: a phase error of 1e-3 ticks is 1e-3 A,
 *   - the coil's temperatures, whose rise per update is below a float's resolution (23-36 % low at 10 kHz),
 *   - computations once per contact: position in the grid, bound on the heat.
 * All operations have the order of the test oracle in Python, so that with doubles both give the same bits; the compiler
 * must not contract a * b + c (-ffp-contract=off).
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

/* `value` clamped to [low, high]; `low` if low > high. */
static inline td_real td_within(td_real value, td_real low, td_real high)
{
    return value < low ? low : (value > high ? high : value);
}

#endif
