#include "td_bank.h"

#include <math.h>

#include "td_bytes.h"

int32_t td_bank_count(const uint8_t *at, uint32_t bits)
{
    return bits == 8 ? td_get_i8(at) : td_get_i16(at);
}

/* sqrt(sum count^2) of one node's waveform. The current of a one-pole amplifier never has more energy than its command,
 * so this bounds the norm of the current without relying on a number from the host. */
static td_wide root_of_squares(const uint8_t *counts, uint32_t bits, uint32_t samples, size_t node)
{
    const uint32_t bytes = bits / 8;
    const uint8_t *at = counts + bytes * node * samples;
    int64_t sum = 0;

    for (; samples > 0; samples--, at += bytes) {
        const int32_t count = td_bank_count(at, bits);

        sum += (int64_t)count * count;
    }
    return sqrt((td_wide)sum);
}

bool td_bank_open(td_bank *bank, const uint8_t *image, size_t size)
{
    const uint8_t *axes = image + TD_IMAGE_BYTES;
    uint32_t flags, speeds, grips, samples, cool_bits, j;
    size_t nodes, counts, tables;

    if (size < TD_IMAGE_BYTES || td_get_u32(image + TD_IMAGE_MAGIC) != TD_IMAGE_MAGIC_VALUE ||
        td_get_u16(image + TD_IMAGE_VERSION) != TD_IMAGE_VERSION_VALUE)
        return false;
    flags = td_get_u16(image + TD_IMAGE_FLAGS);
    speeds = td_get_u16(image + TD_IMAGE_SPEEDS);
    grips = td_get_u16(image + TD_IMAGE_GRIPS);
    samples = td_get_u32(image + TD_IMAGE_SAMPLES);
    cool_bits = td_get_u32(image + TD_IMAGE_COOL_BITS);
    if (cool_bits != 0 && cool_bits != 8 && cool_bits != 16)
        return false;
    if (flags > (TD_IMAGE_BY_GRIP | TD_IMAGE_NEAREST) || speeds < 1 || speeds > TD_MAX_SPEEDS || grips < 1 ||
        grips > TD_MAX_GRIPS || samples < 1 || samples > TD_MAX_SAMPLES ||
        samples > TD_MAX_LIBRARY_SAMPLES / (speeds * grips))
        return false;
    nodes = (size_t)speeds * grips;
    counts = nodes * samples;
    tables = cool_bits == 0 ? nodes : 2 * nodes;
    /* One sample of memory holds two 8-bit counts. */
    if ((cool_bits == 8 ? (counts + 1) / 2 : cool_bits / 16 * counts) > TD_MAX_LIBRARY_SAMPLES - counts ||
        size != TD_IMAGE_BYTES + 8 * (speeds + grips + tables) + (2 + cool_bits / 8) * counts)
        return false;
    bank->speeds = (int32_t)speeds;
    bank->grips = (int32_t)grips;
    bank->samples = (int32_t)samples;
    for (j = 0; j < speeds; j++)
        bank->speed_m_s[j] = td_get_f64(axes + 8 * j);
    for (j = 0; j < grips; j++)
        bank->grip_N[j] = td_get_f64(axes + 8 * (speeds + j));
    bank->grip_min_N = td_get_f64(image + TD_IMAGE_GRIP_MIN_N);
    bank->scale_A = (td_real)td_get_f64(image + TD_IMAGE_SCALE_A);
    bank->root_ticks = sqrt((td_wide)bank->samples + 1);
    bank->by_grip = (flags & TD_IMAGE_BY_GRIP) != 0;
    bank->nearest = (flags & TD_IMAGE_NEAREST) != 0;
    bank->feedback_A = axes + 8 * ((size_t)speeds + grips);
    bank->counts = bank->feedback_A + 8 * tables;
    for (j = 0; j < nodes; j++)
        bank->transient_A[j] = td_get_f64(image + TD_IMAGE_SCALE_A) * root_of_squares(bank->counts, 16, samples, j);
    bank->cool_bits = cool_bits;
    if (cool_bits == 0)
        return true;
    bank->cool_scale_A = bank->feedback_A + 8 * nodes;
    bank->cool_counts = bank->counts + 2 * counts;
    for (j = 0; j < nodes; j++)
        bank->cool_A[j] =
            td_get_f64(bank->cool_scale_A + 8 * j) * root_of_squares(bank->cool_counts, cool_bits, samples, j);
    return true;
}

typedef struct {
    int32_t first;
    td_wide place; /* 0 to 1 between the first node and the next */
    bool outside;
} interval;

/* Interval of increasing nodes that `value` lies in. */
static interval find(const td_wide *nodes, int32_t count, td_wide value, bool nearest)
{
    interval found = {0, 0, false};
    int32_t beyond = count - 1; /* the first node known to lie after the interval's beginning */
    td_wide place;

    if (count == 1) {
        found.outside = value < nodes[0] || value > nodes[0];
        return found;
    }
    while (beyond - found.first > 1) {
        const int32_t middle = found.first + (beyond - found.first) / 2;

        if (value >= nodes[middle])
            found.first = middle;
        else
            beyond = middle;
    }
    place = (value - nodes[found.first]) / (nodes[found.first + 1] - nodes[found.first]);
    found.outside = place < 0 || place > 1;
    found.place = place < 0 ? 0 : (place > 1 ? 1 : place);
    if (nearest)
        found.place = found.place < 0.5 ? 0 : 1;
    return found;
}

/* The cool command for the same speed and grip, if there is one. */
static void cooler(const td_bank *bank, const td_wide *w, const int32_t *node, td_play *play)
{
    const size_t bytes = bank->cool_bits / 8;
    int32_t j;

    play->cooled = 0;
    play->cool_A = HUGE_VAL;
    if (bank->cool_bits == 0)
        return;
    for (j = 0; j < 4; j++) {
        play->cool_scale_A[j] = (td_real)td_get_f64(bank->cool_scale_A + 8 * node[j]);
        play->cool_corner[j] = bank->cool_counts + (size_t)node[j] * (size_t)bank->samples * bytes;
    }
    play->cool_A = w[0] * bank->cool_A[node[0]] +
                   w[1] * bank->cool_A[node[1]] +
                   w[2] * bank->cool_A[node[2]] +
                   w[3] * bank->cool_A[node[3]];
}

void td_bank_at(const td_bank *bank, td_wide speed_m_s, td_wide grip_N, td_play *play)
{
    const bool sound = speed_m_s > 0 && grip_N >= bank->grip_min_N;
    interval v, g;
    td_wide w[4], x, y;
    int32_t node[4], j, next_v, next_g;

    play->silent = !sound;
    if (play->silent)
        return;
    v = find(bank->speed_m_s, bank->speeds, speed_m_s, bank->nearest);
    g = find(bank->grip_N, bank->grips, grip_N, bank->nearest);
    y = v.place;
    x = g.place;
    next_v = v.first + 1 < bank->speeds ? v.first + 1 : v.first;
    next_g = g.first + 1 < bank->grips ? g.first + 1 : g.first;
    w[0] = (1 - y) * (1 - x);
    w[1] = (1 - y) * x;
    w[2] = y * (1 - x);
    w[3] = y * x;
    node[0] = v.first * bank->grips + g.first;
    node[1] = v.first * bank->grips + next_g;
    node[2] = next_v * bank->grips + g.first;
    node[3] = next_v * bank->grips + next_g;
    for (j = 0; j < 4; j++) {
        play->weight[j] = (td_real)w[j];
        play->corner[j] = bank->counts + (size_t)node[j] * (size_t)bank->samples * sizeof(int16_t);
    }
    play->out_of_grid = v.outside || (g.outside && bank->by_grip);
    /* Norms are convex, so the blend of the corners' norms bounds the norm of the blend. */
    play->transient_A = w[0] * bank->transient_A[node[0]] +
                        w[1] * bank->transient_A[node[1]] +
                        w[2] * bank->transient_A[node[2]] +
                        w[3] * bank->transient_A[node[3]];
    play->feedback_A = w[0] * td_get_f64(bank->feedback_A + 8 * node[0]) +
                       w[1] * td_get_f64(bank->feedback_A + 8 * node[1]) +
                       w[2] * td_get_f64(bank->feedback_A + 8 * node[2]) +
                       w[3] * td_get_f64(bank->feedback_A + 8 * node[3]);
    cooler(bank, w, node, play);
}

td_real td_bank_sample(const td_bank *bank, const td_play *play, int32_t j)
{
    td_real corner[4], first, cool;
    size_t at;
    int32_t c;

    for (c = 0; c < 4; c++)
        corner[c] = (td_real)td_get_i16(play->corner[c] + sizeof(int16_t) * (size_t)j) * bank->scale_A;
    first = play->weight[0] * corner[0] + play->weight[1] * corner[1] + play->weight[2] * corner[2] +
            play->weight[3] * corner[3];
    if (!(play->cooled > 0))
        return first;
    at = bank->cool_bits / 8 * (size_t)j;
    for (c = 0; c < 4; c++)
        corner[c] = (td_real)td_bank_count(play->cool_corner[c] + at, bank->cool_bits) * play->cool_scale_A[c];
    cool = play->weight[0] * corner[0] + play->weight[1] * corner[1] + play->weight[2] * corner[2] +
           play->weight[3] * corner[3];
    return (1 - play->cooled) * first + play->cooled * cool;
}
