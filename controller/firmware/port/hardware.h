/* RE 25 on an amplifier of +-10 V for +-10 A, ADXL321, grip sensor. The block to change: limits and scales.
 *
 * Amplifier and motor are good for this: a host may only ask for less. Current and command limits hold for every pole
 * of the amplifier between the two. */
#ifndef TRANSOPT_HARDWARE_H
#define TRANSOPT_HARDWARE_H
#include <transopt_device.h>

#define HAS_GRIP 1

/* value = (counts - zero_counts) * per_count; outside least..most counts there is no number, since a sensor at the rail
 * is a broken wire or a short. */
typedef struct {
    float per_count, zero_counts;
    int least, most;
} td_scale;

/* In the order of td_hardware: servo period [s]; current, command, test pulse [A] and its length [s]; slowest and
 * fastest pole [Hz]; over-current [A]; whether the coil is known, winding at 25 C [ohm], thermal resistances [K/W], time
 * constants [s], limit of the winding and warmest surroundings [C]. */
static const td_hardware HARDWARE = {
    1e-4, 4.5, 6.0, 0.1, 0.02, 700.0, 1600.0, 6.0, true, 2.18, 3.1, 14.0, 12.0, 612.0, 100.0, 35.0,
};
static const td_scale CURRENT_A = {0.00488f, 2048.0f, 8, 4087};
static const td_scale ACCELERATION_M_S2 = {0.1254f, 2048.0f, 8, 4087};
static const td_scale GRIP_N = {0.015f, 200.0f, 0, 4087};
/* The command: counts = OUTPUT_ZERO + A * OUTPUT_PER_A. */
static const int OUTPUT_MOST = 4095;
static const float OUTPUT_ZERO = 2048.0f;
static const float OUTPUT_PER_A = 204.8f;
#endif
