/* RE 25 on an ESCON 50/5: written by `transopt-play device circuit escon_re25.toml`. Change that file, not this one.
 *
 * Amplifier and motor are good for this: a host may only ask for less. Current and command limits hold for every pole
 * of the amplifier between the two. */
#ifndef TRANSOPT_HARDWARE_H
#define TRANSOPT_HARDWARE_H
#include <transopt_device.h>

#ifndef COMMAND_BY_DAC
#define COMMAND_BY_DAC 1
#endif
#define HAS_GRIP 1
#define CONVERTER_BITS 12

/* value = (counts - zero_counts) * per_count; outside least..most counts there is no number, since a sensor at the
 * rail is a broken wire or a short. */
typedef struct {
    float per_count, zero_counts;
    int least, most;
} td_scale;

/* In the order of td_hardware: servo period [s]; current, command, test pulse [A] and its length [s]; slowest and
 * fastest pole [Hz]; over-current [A]; whether the coil is known, winding at 25 C [ohm], thermal resistances [K/W],
 * time constants [s], limit of the winding and warmest surroundings [C]. */
static const td_hardware HARDWARE = {
    0.0001,
    4.0,
    6.0,
    0.1,
    0.02,
    700.0,
    1575.0,
    5.2,
    true,
    2.18,
    3.1,
    14.0,
    12.0,
    612.0,
    100.0,
    35.0,
};
static const td_scale CURRENT_A = {0.005371094f, 2048.0f, 8, 4087};
static const td_scale ACCELERATION_M_S2 = {0.1260106f, 2048.0f, 8, 4087};
static const td_scale GRIP_N = {0.01500306f, 198.5939f, 0, 4087};
/* The command: counts = OUTPUT_ZERO + A * OUTPUT_PER_A. */
static const int OUTPUT_MOST = 4095;
static const float OUTPUT_ZERO = 2049.167f;
static const float OUTPUT_PER_A = 205.5591f;
static const float PWM_HZ = 36621.09f;
#endif
