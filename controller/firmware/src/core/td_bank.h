/* The waveforms of the servo: a table over (speed, grip), blended tick by tick (controller/waveforms/bank.py).
 *
 * The bank is a view of an image in memory that belongs to the caller: axes are unpacked; norms and waveforms are read
 * in place, byte by byte, so that neither the image's alignment nor the processor's byte order matters.
 */
#ifndef TD_BANK_H
#define TD_BANK_H

#include "td_messages.h"
#include "td_real.h"

typedef struct {
    int32_t speeds, grips, samples;
    td_wide speed_m_s[TD_MAX_SPEEDS], grip_N[TD_MAX_GRIPS]; /* strictly increasing */
    td_wide grip_min_N;                                     /* nothing plays below it; 0 for the free device */
    td_real scale_A;                                        /* per count of a waveform */
    td_wide root_ticks; /* sqrt(samples + 1): how long a waveform lasts, for td_guard_allowed at a contact */
    bool by_grip;                                           /* whether a grip outside the table counts as out of grid */
    bool nearest;                                           /* take the nearest node instead of a blend */
    td_wide transient_A[TD_MAX_SPEEDS * TD_MAX_GRIPS];      /* (speeds, grips) scale_A sqrt(sum count^2) */
    const uint8_t *feedback_A;                              /* (speeds, grips) norms, float64 */
    const uint8_t *counts;                                  /* (speeds, grips, samples) int16 */
    uint32_t cool_bits; /* bits per count of the cool commands, which heat less: 8 or 16, 0 without them */
    td_wide cool_A[TD_MAX_SPEEDS * TD_MAX_GRIPS];           /* their norms; this and the next two only if cool_bits > 0 */
    const uint8_t *cool_scale_A;                            /* (speeds, grips) float64 */
    const uint8_t *cool_counts;                             /* (speeds, grips, samples) int8 or int16 */
    td_wide peak_A; /* the largest command of all waveforms, set by td_check_image */
} td_bank;

/* The transient of one contact: four corners and their weights, of the first commands and of the cool ones. */
typedef struct {
    bool silent; /* nothing may be played, since speed or grip is too small; the other members are then not set */
    bool out_of_grid;
    td_real weight[4];
    const uint8_t *corner[4];
    td_wide transient_A, feedback_A; /* bounds on the norms of the currents, for td_guard_allowed */
    td_wide cool_A;                  /* the same for the cool command, infinite without one */
    td_real cooled;                  /* share of the cool command in the blend; td_bank_at sets 0 */
    td_real cool_scale_A[4];
    const uint8_t *cool_corner[4];
} td_play;

/* Open a view of an image that controller/protocol/image.py writes; returns whether it is one of this version, complete
 * and not too large. Whether it may be played is checked by td_check.h. */
bool td_bank_open(td_bank *bank, const uint8_t *image, size_t size);

/* The transient for a contact; outside the grid the nearest edge applies, and NaN gives a silent one. */
void td_bank_at(const td_bank *bank, td_wide speed_m_s, td_wide grip_N, td_play *play);

/* Read a count of `bits` bits, 8 or 16, from the image. */
int32_t td_bank_count(const uint8_t *at, uint32_t bits);

/* Sample j of a blend [A], 0 <= j < samples. */
td_real td_bank_sample(const td_bank *bank, const td_play *play, int32_t j);

#endif
