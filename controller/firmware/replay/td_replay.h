/* A recorded run played through the servo: readings and the host's wishes in, commands and events out.
 *
 * For tests and ports: whatever runs the core, a processor's emulator too, must give these bytes. All numbers are
 * little-endian.
 *
 *     input, 40 bytes a tick     u8 wishes, u8 emergency_stop, u16 0, i32 encoder_counts,
 *                                f64 gain, f64 grip_N, f64 current_A, f64 acceleration_m_s2
 *     output, 72 bytes a tick    f64 command_A, f64 transient_A, f64 feedback_A, f64 winding_C,
 *                                f64 speed_m_s, f64 grip_N of the first event (NaN without),
 *                                u8 state, u8 answers, u8 events, u8 what[14], 7 bytes 0
 */
#ifndef TD_REPLAY_H
#define TD_REPLAY_H

#include "td_servo.h"

#define TD_REPLAY_IN 40
#define TD_REPLAY_OUT 72

/* Wishes, carried out before the tick in this order; answers holds the bits of those that were granted. */
enum {
    TD_WISH_RESET = 1,
    TD_WISH_DISARM = 2,
    TD_WISH_GAIN = 4,
    TD_WISH_ARM = 8,
    TD_WISH_EXCITE = 16,
    TD_WISH_NEGATIVE = 32 /* the excitation with the other sign */
};

typedef struct {
    td_config config;
    td_bank bank;
    td_servo servo;
    uint64_t tick;
} td_replay;

/* For callers that do not know the struct. */
size_t td_replay_size(void);

/* From nothing; whether configuration and image are sound. The image must outlive the replay. */
bool td_replay_start(
    td_replay *replay, const uint8_t *config, size_t config_size, const uint8_t *image, size_t image_size);

void td_replay_run(td_replay *replay, const uint8_t *input, size_t ticks, uint8_t *output);

/* The coil as the servo estimates it: winding and housing. */
void td_replay_coil(const td_replay *replay, double *heat_C);

/* Only the coil: `ticks` periods with |i| = size_A[0], size_A[1], ... in turn, temperature after each `every` ticks. */
void td_replay_heat(td_replay *replay, const double *size_A, size_t ticks, size_t every, double *winding_C);

#endif
