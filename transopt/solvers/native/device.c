/* Stages of a device under one grip, for a tap that is solved alone: its modes, exact for a held command, and the cost of
 * the time after the window. The same numbers as those of `discretise`, `linear_stage`, `modes_of` and `tails` in Python,
 * for one plant with an amplifier and without a wall. All matrices are row by row.
 */
#include <math.h>
#include <string.h>

#include "device.h"

enum { MOST = TR_MOST_DEVICE, LANES = 4 };

static const double VANISHED = 1e-150; /* from where on a mode after the window is zero: denormals are slow */

typedef struct {
    double re, im;
} number;

/* Modes of the plant and the current: one of each complex pair, then the real ones, the current's last. The states of the
 * error filters come after the pairs, as pairs. */
typedef struct {
    int pairs, filters, count, order[MOST]; /* of pairs, of filters' states, of modes; indices of the eigenvalues */
    number grown[MOST], held[MOST];         /* over a stage: e^l, and (e^l - 1) / l for a held command */
    double ratio[MOST];                     /* of the lengths of an eigenvector's real and imaginary part */
} tr_modes;

static int place(const tr_modes *of, int k) { return k < of->pairs ? 2 * k : k + of->pairs + of->filters; }

static number times(number a, number b)
{
    return (number){a.re * b.re - a.im * b.im, a.re * b.im + a.im * b.re};
}

static number over(number a, number b)
{
    const double square = b.re * b.re + b.im * b.im;
    return (number){(a.re * b.re + a.im * b.im) / square, (a.im * b.re - a.re * b.im) / square};
}

/* Solve a x = b in place of b (n, columns), with partial pivoting; a is overwritten. Returns 0 if a is singular. */
static int solved(int n, int columns, double *a, double *b)
{
    for (int k = 0; k < n; k++) {
        int at = k;
        for (int i = k + 1; i < n; i++)
            if (fabs(a[i * n + k]) > fabs(a[at * n + k])) at = i;
        if (!(fabs(a[at * n + k]) > 0.0)) return 0;
        for (int j = 0; at != k && j < n; j++) {
            const double held = a[k * n + j];
            a[k * n + j] = a[at * n + j], a[at * n + j] = held;
        }
        for (int j = 0; at != k && j < columns; j++) {
            const double held = b[k * columns + j];
            b[k * columns + j] = b[at * columns + j], b[at * columns + j] = held;
        }
        for (int i = k + 1; i < n; i++) {
            const double by = a[i * n + k] / a[k * n + k];
            for (int j = k + 1; j < n; j++) a[i * n + j] -= by * a[k * n + j];
            for (int j = 0; j < columns; j++) b[i * columns + j] -= by * b[k * columns + j];
        }
    }
    for (int i = n - 1; i >= 0; i--)
        for (int j = 0; j < columns; j++) {
            for (int l = i + 1; l < n; l++) b[i * columns + j] -= a[i * n + l] * b[l * columns + j];
            b[i * columns + j] /= a[i * n + i];
        }
    return 1;
}

/* Sum of products, in lanes that the compiler may work on side by side. */
static double product(int count, const double *a, const double *b)
{
    double sums[LANES] = {0}, rest = 0.0;
    int k = 0;
    for (; k + LANES <= count; k += LANES)
        for (int l = 0; l < LANES; l++) sums[l] += a[k + l] * b[k + l];
    for (; k < count; k++) rest += a[k] * b[k];
    return sums[0] + sums[1] + (sums[2] + sums[3]) + rest;
}

/* The order of the modes. Returns 0 where the current is none. */
static int ordered(const tr_device *d, tr_modes *of)
{
    const int acting = d->plant + 1;
    int reals = 0, own = -1;
    double largest = 0.0;
    of->pairs = 0;
    for (int j = 0; j < acting; j++) of->pairs += d->values[2 * j + 1] > 0.0, reals += d->values[2 * j + 1] == 0.0;
    of->count = of->pairs + reals;
    if (of->pairs + of->count != acting) return 0;
    for (int j = 0, pair = 0, real = of->pairs; j < acting; j++) {
        const double part = fabs(d->vectors[2 * (d->plant * acting + j)]);
        if (d->values[2 * j + 1] > 0.0) of->order[pair++] = j;
        if (d->values[2 * j + 1] != 0.0) continue;
        if (part > largest) largest = part, own = real;
        of->order[real++] = j;
    }
    if (own < 0) return 0;
    const int other = of->order[of->count - 1];
    of->order[of->count - 1] = of->order[own], of->order[own] = other;
    return 1;
}

/* How the modes go on over a stage. */
static void flowing(const tr_device *d, tr_modes *of)
{
    for (int k = 0; k < of->count; k++) {
        const number flow = {d->values[2 * of->order[k]], d->values[2 * of->order[k] + 1]};
        const double half = sin(0.5 * flow.im);
        of->grown[k] = (number){exp(flow.re) * cos(flow.im), exp(flow.re) * sin(flow.im)};
        const number less_one = {expm1(flow.re) * cos(flow.im) - 2.0 * half * half, of->grown[k].im};
        of->held[k] = flow.re == 0.0 && flow.im == 0.0 ? (number){1.0, 0.0} : over(less_one, flow);
    }
}

/* Columns of T: an eigenvector of plant and current, which grows by `grown` from stage to stage, and the states of the
 * error filters that go with it, (grown - A_f) w = B_f y. A pair has one for the real and one for the imaginary part, of
 * unit length each; returns the ratio of their lengths before. */
static double columns(const tr_device *d, int mode, number grown, int n, int at, double *T)
{
    const int acting = d->plant + 1, pair = d->values[2 * mode + 1] > 0.0;
    number v[MOST], turned = {1.0, 0.0}, phase = {0.0, 0.0}, made = {0.0, 0.0};
    double real = 0.0, imaginary = 0.0;
    for (int i = 0; i < acting; i++) {
        memcpy(v + i, d->vectors + 2 * (i * acting + mode), sizeof(number));
        const number square = times(v[i], v[i]);
        phase.re += square.re, phase.im += square.im;
    }
    /* The phase for which real and imaginary part are orthogonal. */
    const double half = -0.5 * atan2(phase.im, phase.re);
    if (pair) turned = (number){cos(half), sin(half)};
    for (int i = 0; i < acting; i++) {
        v[i] = times(v[i], turned);
        made.re += d->output[i] * v[i].re, made.im += d->output[i] * v[i].im;
    }
    for (int t = 0, into = acting; t < d->terms; t++) {
        const double *filter = d->filter + t * TR_FILTER;
        if (filter[0] == 0.0) continue;
        const number square = times(grown, grown);
        const number by = {square.re + filter[1] * grown.re + filter[2], square.im + filter[1] * grown.im};
        v[into + 1] = over((number){made.re * filter[6], made.im * filter[6]}, by);
        v[into] = times(grown, v[into + 1]);
        into += 2;
    }
    for (int i = 0; i < n - 1; i++) real += v[i].re * v[i].re, imaginary += v[i].im * v[i].im;
    /* The current keeps its unit. */
    real = at == n - 2 ? v[d->plant].re : sqrt(real), imaginary = pair ? sqrt(imaginary) : 1.0;
    for (int i = 0; i < n - 1; i++) {
        T[i * n + at] = v[i].re / real;
        if (pair) T[i * n + at + 1] = v[i].im / imaginary;
    }
    return real / imaginary;
}

/* T of the states x = T z. */
static void coordinates(const tr_device *d, int n, tr_modes *of, double *T)
{
    memset(T, 0, (size_t)(n * n) * sizeof(double));
    for (int k = 0; k < of->count; k++) of->ratio[k] = columns(d, of->order[k], of->grown[k], n, place(of, k), T);
    for (int j = 0; j < n; j++) T[d->plant * n + j] = j == n - 2 ? 1.0 : 0.0;
    for (int i = 0; i < of->filters; i++) T[(d->plant + 1 + i) * n + 2 * of->pairs + i] = 1.0;
    T[n * n - 1] = 1.0;
}

/* A of z. The command acts on the current, by which it drives every mode; what a mode then moves in the error filters,
 * their own states take back. */
static void dynamics(const tr_device *d, int n, const tr_modes *of, const double *T, const double *inverse, double *A)
{
    const int m = n - 1, first = 2 * of->pairs;
    double *driven = A + m; /* its last column, every n-th number */
    memset(A, 0, (size_t)(n * n) * sizeof(double));
    for (int k = 0; k < of->count; k++) {
        const int at = place(of, k);
        const number grown = of->grown[k], held = of->held[k];
        const double own = d->rate * inverse[at * n + d->plant], ratio = of->ratio[k];
        A[at * n + at] = grown.re, driven[at * n] = held.re * own;
        if (k >= of->pairs) continue;
        const double other = d->rate * inverse[(at + 1) * n + d->plant];
        A[(at + 1) * n + at + 1] = grown.re;
        A[at * n + at + 1] = grown.im * ratio, A[(at + 1) * n + at] = -grown.im / ratio;
        driven[at * n] += held.im * ratio * other;
        driven[(at + 1) * n] = held.re * other - held.im / ratio * own;
    }
    for (int i = 0; i < of->filters; i++) {
        double sum = 0.0;
        for (int k = 0; k < first; k++) sum += T[(d->plant + 1 + i) * n + k] * driven[k * n];
        for (int k = first + of->filters; k < m; k++) sum += T[(d->plant + 1 + i) * n + k] * driven[k * n];
        driven[(first + i) * n] = -sum;
    }
    for (int t = 0, at = first; t < d->terms; t++) {
        const double *filter = d->filter + t * TR_FILTER;
        if (filter[0] == 0.0) continue;
        A[at * n + at] = -filter[1], A[at * n + at + 1] = -filter[2], A[(at + 1) * n + at] = 1.0;
        at += 2;
    }
    A[n * n - 1] = 1.0;
}

/* The modal coordinates z of the states, x = T z, and A in them. Returns a bound of the condition of T, infinite where the
 * device has no such coordinates; `paired` is the number of states in pairs. */
static double modal(const tr_device *d, int n, double *T, double *A, int *paired)
{
    double inverse[MOST * MOST] = {0}, left[MOST * MOST];
    tr_modes of;
    if (!ordered(d, &of)) return INFINITY;
    of.filters = n - d->plant - 2, *paired = 2 * of.pairs + of.filters;
    flowing(d, &of);
    coordinates(d, n, &of, T);
    for (int i = 0; i < n; i++) inverse[i * n + i] = 1.0;
    memcpy(left, T, (size_t)(n * n) * sizeof(double));
    if (!solved(n, n, left, inverse)) return INFINITY;
    dynamics(d, n, &of, T, inverse, A);
    if (!(product(n * n, A, A) < INFINITY)) return INFINITY;
    return sqrt(product(n * n, T, T) * product(n * n, inverse, inverse));
}

/* Factor the outputs after the window: |O z - asked|^2 = |gain z - target|^2 + rest, O of `rows` rows, by Householder's
 * reflections. `work` holds the columns of O one after the other, and then `asked`. */
static double reduced(int rows, int n, double *work, double *gain, double *target)
{
    double *asked = work + (size_t)n * (size_t)rows;
    for (int j = 0; j < n && j < rows; j++) {
        double *column = work + (size_t)j * (size_t)rows;
        const int left = rows - j;
        const double size = sqrt(product(left, column + j, column + j)), along = column[j] > 0.0 ? -size : size;
        const double square = size * (size + fabs(column[j]));
        if (!(square > 0.0)) continue;
        column[j] -= along;
        for (int l = j + 1; l <= n; l++) {
            double *other = work + (size_t)l * (size_t)rows;
            const double by = product(left, column + j, other + j) / square;
            for (int k = j; k < rows; k++) other[k] -= by * column[k];
        }
        column[j] = along;
    }
    for (int i = 0; i < n; i++) {
        for (int j = 0; j < n; j++) gain[i * n + j] = i <= j && i < rows ? work[(size_t)j * (size_t)rows + i] : 0.0;
        target[i] = i < rows ? asked[i] : 0.0;
    }
    return rows > n ? product(rows - n, asked + n, asked + n) : 0.0;
}

static int states_of(const tr_device *d)
{
    int n = d->plant + 2;
    for (int t = 0; t < d->terms; t++) n += d->filter[t * TR_FILTER] != 0.0 ? 2 : 0;
    return n;
}

size_t tr_device_workspace(const tr_device *d)
{
    return (size_t)states_of(d) * (size_t)(d->after * d->terms);
}

double tr_device_stages(const tr_device *d, const double *asked, double unit, double *space, tr_stages *found)
{
    double T[MOST * MOST], gain[MOST * MOST];
    int rows = 0, pairs;
    found->rest = 0.0;
    const int n = states_of(d), m = n - 1;
    const double condition = n <= MOST ? modal(d, n, T, found->A, &pairs) : INFINITY;
    if (!(condition < INFINITY)) return INFINITY;
    for (int t = 0, at = d->plant + 1; t < d->terms; t++) {
        const double *filter = d->filter + t * TR_FILTER;
        const int filtered = filter[0] != 0.0;
        for (int j = 0; j < n; j++) {
            double sum = 0.0;
            for (int i = 0; i <= d->plant; i++) sum += d->output[i] * T[i * n + j];
            if (filtered) sum = filter[3] * sum + filter[4] * T[at * n + j] + filter[5] * T[(at + 1) * n + j];
            found->C[t * n + j] = sum / unit;
        }
        at += filtered ? 2 : 0;
    }
    for (int t = 0; t < d->terms; t++) rows += d->root[t] > 0.0 ? d->after : 0;
    /* From the window's end on the command is zero: each mode goes on by itself. */
    for (int j = 0; j < m; j++) {
        const int other = j < pairs ? j ^ 1 : j;
        double *column = space + (size_t)j * (size_t)rows;
        for (int t = 0; t < d->terms; t++) {
            double own = d->root[t] * found->C[t * n + j], beside = d->root[t] * found->C[t * n + other];
            for (int k = 0; d->root[t] > 0.0 && k < d->after; k++) {
                const double before = own;
                *column++ = own;
                own = before * found->A[j * n + j] + (other == j ? 0.0 : beside * found->A[other * n + j]);
                beside = before * found->A[j * n + other] + beside * found->A[other * n + other];
                if (fabs(own) < VANISHED && fabs(beside) < VANISHED) own = beside = 0.0;
            }
        }
    }
    double *after = space + (size_t)m * (size_t)rows;
    for (int t = 0; t < d->terms; t++)
        for (int k = 0; d->root[t] > 0.0 && k < d->after; k++)
            *after++ = d->root[t] * asked[(size_t)t * (size_t)d->stride + (size_t)k] / unit;
    found->rest = reduced(rows, m, space, gain, found->end_target);
    for (int i = 0; i < m; i++) {
        for (int j = 0; j < m; j++) found->end_gain[i * n + j] = d->by * gain[i * m + j];
        found->end_gain[i * n + m] = 0.0, found->end_target[i] *= d->by;
    }
    return condition;
}
