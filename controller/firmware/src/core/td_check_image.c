#include <math.h>

#include "td_bytes.h"
#include "td_check.h"

static bool is_size(double value)
{
    return isfinite(value) && value >= 0;
}

/* Header and length: whether it is an image at all, and fits in here. */
static td_refusal check_size(const uint8_t *image, size_t size)
{
    uint64_t nodes, samples;
    uint32_t speeds, grips;
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
    if (nodes < 1 || samples < 1 || td_get_u32(image + TD_IMAGE_RESERVED) != 0 ||
        TD_IMAGE_BYTES + 8 * (speeds + grips + nodes) + 2 * nodes * samples != size)
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
    if (nodes * samples > TD_MAX_LIBRARY_SAMPLES)
        return td_refuse(TD_REASON_TOO_LARGE, (double)(nodes * samples));
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

/* The feedback's norms: finite, none negative. They are the host's word, and serve the prediction of heat alone. */
static bool are_sizes(const td_bank *bank)
{
    int32_t j;

    for (j = 0; j < bank->speeds * bank->grips; j++) {
        if (!is_size(td_get_f64(bank->feedback_A + 8 * j)))
            return false;
    }
    return true;
}

/* Largest |command| and largest |current| that commands make from rest, over all waveforms; whether each ends in
 * `tail` zeros. */
static bool measure(const td_bank *bank, double scale_A, double decay, uint32_t tail, double peak_A[2])
{
    const int32_t first_zero = bank->samples - (int32_t)tail;
    const uint8_t *at = bank->counts;
    int32_t node, j;
    bool ends = true;

    peak_A[0] = peak_A[1] = 0;
    for (node = 0; node < bank->speeds * bank->grips; node++) {
        double current = 0;

        for (j = 0; j < bank->samples; j++, at += 2) {
            const double command = td_get_i16(at) * scale_A;

            current = (1 - decay) * command + decay * current;
            peak_A[0] = fabs(command) > peak_A[0] ? fabs(command) : peak_A[0];
            peak_A[1] = fabs(current) > peak_A[1] ? fabs(current) : peak_A[1];
            ends = ends && (j < first_zero || !(fabs(command) > 0));
        }
    }
    return ends;
}

td_refusal td_check_image(const uint8_t *image, size_t size, const td_config *config, td_bank *bank)
{
    const double walled = config->wall.present ? TD_IMAGE_WALLED_COMMAND : 1;
    double scale_A, peak_A[2], limit_A[2];
    td_refusal found = check_size(image, size);
    uint32_t tail;
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
    tail = td_get_u32(image + TD_IMAGE_TAIL_SAMPLES);
    scale_A = td_get_f64(image + TD_IMAGE_SCALE_A);
    if (tail < 1 || tail > (uint32_t)bank->samples ||
        !measure(bank, scale_A, (double)config->decay, tail, peak_A))
        return td_refuse(TD_REASON_NO_ZERO_TAIL, tail);
    limit_A[0] = (double)config->command_limit_A * walled;
    limit_A[1] = (double)config->current_limit_A;
    for (j = 0; j < 2; j++) {
        /* One count of room for rounding. */
        if (!isfinite(peak_A[j]) || !(peak_A[j] <= limit_A[j] + scale_A))
            return td_refuse(TD_REASON_OVER_LIMIT, peak_A[j]);
    }
    return td_granted;
}
