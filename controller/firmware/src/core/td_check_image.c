#include <math.h>

#include "td_bytes.h"
#include "td_check.h"

static bool is_size(double value)
{
    return isfinite(value) && value >= 0;
}

/* Check header and length: whether it is an image, and whether it fits into this device. */
static td_refusal check_size(const uint8_t *image, size_t size)
{
    uint64_t nodes, samples, counts, taken;
    uint32_t speeds, grips, cool_bits;
    int j;

    if (size < TD_IMAGE_BYTES)
        return td_refuse(TD_REASON_BAD_FORMAT, (double)size);
    if (td_get_u32(image + TD_IMAGE_MAGIC) != TD_IMAGE_MAGIC_VALUE ||
        td_get_u16(image + TD_IMAGE_VERSION) != TD_IMAGE_VERSION_VALUE ||
        td_get_u16(image + TD_IMAGE_FLAGS) > (TD_IMAGE_BY_GRIP | TD_IMAGE_NEAREST))
        return td_refuse(TD_REASON_BAD_FORMAT, td_get_u16(image + TD_IMAGE_VERSION));
    speeds = td_get_u16(image + TD_IMAGE_SPEEDS);
    grips = td_get_u16(image + TD_IMAGE_GRIPS);
    samples = td_get_u32(image + TD_IMAGE_SAMPLES);
    nodes = (uint64_t)speeds * grips;
    cool_bits = td_get_u32(image + TD_IMAGE_COOL_BITS);
    if (cool_bits != 0 && cool_bits != 8 && cool_bits != 16)
        return td_refuse(TD_REASON_BAD_FORMAT, cool_bits);
    /* An image has fewer nodes and samples than bytes; with this bound the products below do not overflow. */
    if (nodes < 1 || samples < 1 || nodes > size || samples > size)
        return td_refuse(TD_REASON_BAD_FORMAT, (double)size);
    counts = nodes * samples;
    if (TD_IMAGE_BYTES + 8 * (speeds + grips + (cool_bits == 0 ? 1 : 2) * nodes) + (2 + cool_bits / 8) * counts != size)
        return td_refuse(TD_REASON_BAD_FORMAT, (double)size);
    for (j = 0; j < 2; j++) {
        const double value = td_get_f64(image + (j == 0 ? TD_IMAGE_SCALE_A : TD_IMAGE_GRIP_MIN_N));

        if (!is_size(value) || !isfinite((td_real)value))
            return td_refuse(TD_REASON_BAD_VALUE, value);
    }
    if (speeds > TD_MAX_SPEEDS)
        return td_refuse(TD_REASON_TOO_LARGE, speeds);
    if (grips > TD_MAX_GRIPS)
        return td_refuse(TD_REASON_TOO_LARGE, grips);
    if (samples > TD_MAX_SAMPLES)
        return td_refuse(TD_REASON_TOO_LARGE, (double)samples);
    /* One sample of memory holds two 8-bit counts. */
    taken = counts + (cool_bits == 8 ? (counts + 1) / 2 : cool_bits / 16 * counts);
    if (taken > TD_MAX_LIBRARY_SAMPLES)
        return td_refuse(TD_REASON_TOO_LARGE, (double)taken);
    return td_granted;
}

static bool is_axis(const td_wide *nodes, int32_t count)
{
    int32_t j;

    for (j = 0; j < count; j++) {
        if (!isfinite(nodes[j]) || !(nodes[j] >= 0) || (j > 0 && !(nodes[j] > nodes[j - 1])))
            return false;
    }
    return true;
}

/* Whether the feedback's norms, which the host states and only the prediction of heat uses, and the scales of the cool
 * commands are finite, in the core's own precision too, and not negative. */
static bool are_sizes(const td_bank *bank)
{
    const int32_t nodes = bank->speeds * bank->grips;
    int32_t j;

    for (j = 0; j < nodes; j++) {
        if (!is_size(td_get_f64(bank->feedback_A + 8 * j)))
            return false;
    }
    for (j = 0; bank->cool_bits != 0 && j < nodes; j++) {
        const double scale_A = td_get_f64(bank->cool_scale_A + 8 * j);

        if (!is_size(scale_A) || !isfinite((td_real)scale_A))
            return false;
    }
    return true;
}

static double larger(double one, double other)
{
    return one > other ? one : other;
}

/* Extremes over waveforms. */
typedef struct {
    double peak_A[2]; /* largest |command|, and largest |current| by these commands from rest */
    double count_A;   /* the largest scale */
    bool ends;        /* whether each ends in zeros */
} reach;

/* Take one waveform into the extremes. In counts and in td_real, since a library has thousands of samples: rounding in
 * single precision is far below the one count that is left for it. */
static void measure(reach *found, const uint8_t *at, uint32_t bits, double scale_A, const td_bank *bank,
                    const td_config *config, uint32_t tail)
{
    const int32_t first_zero = bank->samples - (int32_t)tail;
    const td_real decay = config->decay, driven = 1 - decay;
    td_real current = 0, most = 0;
    int32_t peak = 0, j;
    bool ends = true;

    for (j = 0; j < bank->samples; j++, at += bits / 8) {
        const int32_t count = td_bank_count(at, bits), size = count < 0 ? -count : count;

        current = driven * (td_real)count + decay * current;
        most = td_size(current) > most ? td_size(current) : most;
        peak = size > peak ? size : peak;
        ends = ends && (j < first_zero || count == 0);
    }
    found->count_A = larger(found->count_A, scale_A);
    found->peak_A[0] = larger(found->peak_A[0], peak * scale_A);
    found->peak_A[1] = larger(found->peak_A[1], (double)most * scale_A);
    found->ends = found->ends && (ends || !(scale_A > 0));
}

/* Check the peaks against the limits, with `room_A` for rounding; a refusal names the peak. */
static td_refusal check_peaks(const reach *found, const td_config *config, double room_A)
{
    const double walled = config->wall.present ? TD_IMAGE_WALLED_COMMAND : 1;
    const double limit_A[2] = {(double)config->command_limit_A * walled, (double)config->current_limit_A};
    int j;

    for (j = 0; j < 2; j++) {
        if (!isfinite(found->peak_A[j]) || !(found->peak_A[j] <= limit_A[j] + room_A))
            return td_refuse(TD_REASON_OVER_LIMIT, found->peak_A[j]);
    }
    return td_granted;
}

/* Check that every waveform, first and cool, ends in zeros and keeps the limits from rest. The room for rounding is one
 * count; for the cool ones, which are rounded towards zero, the finer count. */
static td_refusal check_waveforms(td_bank *bank, const td_config *config, double scale_A, uint32_t tail)
{
    const size_t samples = (size_t)bank->samples;
    reach first = {{0, 0}, 0, true}, cool = {{0, 0}, 0, true};
    td_refusal refusal;
    int32_t node;

    if (tail < 1 || tail > samples)
        return td_refuse(TD_REASON_NO_ZERO_TAIL, tail);
    for (node = 0; node < bank->speeds * bank->grips; node++) {
        const size_t begin = (size_t)node * samples;

        measure(&first, bank->counts + 2 * begin, 16, scale_A, bank, config, tail);
        if (bank->cool_bits != 0)
            measure(&cool, bank->cool_counts + bank->cool_bits / 8 * begin, bank->cool_bits,
                    td_get_f64(bank->cool_scale_A + 8 * node), bank, config, tail);
    }
    if (!first.ends || !cool.ends)
        return td_refuse(TD_REASON_NO_ZERO_TAIL, tail);
    bank->peak_A = first.peak_A[0] > cool.peak_A[0] ? first.peak_A[0] : cool.peak_A[0];
    refusal = check_peaks(&first, config, scale_A);
    return refusal.reason != 0 ? refusal : check_peaks(&cool, config, scale_A < cool.count_A ? scale_A : cool.count_A);
}

td_refusal td_check_image(const uint8_t *image, size_t size, const td_config *config, td_bank *bank)
{
    td_refusal found = check_size(image, size);
    bool playable;
    int j;

    if (found.reason != 0)
        return found;
    if (!td_bank_open(bank, image, size))
        return td_refuse(TD_REASON_BAD_FORMAT, (double)size);
    if (!is_axis(bank->speed_m_s, bank->speeds) || !is_axis(bank->grip_N, bank->grips))
        return td_refuse(TD_REASON_BAD_AXES, (double)NAN);
    if (!are_sizes(bank))
        return td_refuse(TD_REASON_BAD_VALUE, (double)NAN);
    for (j = 0; j < 2; j++) {
        const double value = td_get_f64(image + (j == 0 ? TD_IMAGE_DT_S : TD_IMAGE_LEAD_S));
        const double wanted = j == 0 ? config->dt_s : config->lead_s;

        if (!(value <= wanted && value >= wanted))
            return td_refuse(TD_REASON_BAD_TIMING, value);
    }
    playable = bank->speed_m_s[0] > 0 && bank->grip_N[0] >= bank->grip_min_N;
    if (config->host_starts && !(bank->speeds * bank->grips == 1 && playable))
        return td_refuse(TD_REASON_ONE_WAVEFORM, bank->speeds * bank->grips);
    return check_waveforms(bank, config, td_get_f64(image + TD_IMAGE_SCALE_A), td_get_u32(image + TD_IMAGE_TAIL_SAMPLES));
}
