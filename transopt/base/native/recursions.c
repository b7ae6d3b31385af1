/* Linear recursions over the stages of a transient, linear systems with inputs and outputs, the temperatures of a coil,
 * a linear system that strikes a contact or that a virtual wall pushes, and a spline, whose slopes satisfy such a
 * recursion. Recursions work in place: x holds the forcing of every stage at first and the states at the end. All
 * arrays are row by row. C99 without dependencies, no global state, no allocation.
 */
#include <float.h>
#include <math.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>

enum { MOST_STATES = 64, MOST_WIDTH = 96, MOST_LARGEST = 192, WIDE = 8 };
enum { MOST_FEW = 4, MOST_DENSE = MOST_LARGEST + MOST_STATES };

#if defined(__GNUC__)
#define ALWAYS_INLINE static inline __attribute__((always_inline))
#else
#define ALWAYS_INLINE static inline
#endif

/* Time series are processed side by side in a register of the widest kind; without vector extensions one by one. */
#if defined(__GNUC__)
typedef double wide __attribute__((vector_size(64)));
typedef int64_t wide_bits __attribute__((vector_size(64)));
ALWAYS_INLINE void to_magnitude(wide *x) { *x = (wide)((wide_bits)*x & INT64_MAX); }
/* Magnitudes are in the order of their bits, in which NaN is above all. */
ALWAYS_INLINE void keep_larger(const wide *x, wide *most)
{
    const wide_bits a = (wide_bits)*x, b = (wide_bits)*most, more = a > b;
    *most = (wide)((more & a) | (~more & b));
}
#else
typedef double wide;
ALWAYS_INLINE void to_magnitude(wide *x) { *x = fabs(*x); }
ALWAYS_INLINE void keep_larger(const wide *x, wide *most) { *most = (*x > *most) | (*x != *x) ? *x : *most; }
#endif
enum { ABREAST = sizeof(wide) / sizeof(double) };

/* All builds execute the same operations in the same order, on more or fewer lanes: results are equal bit by bit. */
#if defined(__GNUC__) && !defined(__clang__) && defined(__x86_64__)
#define WITH_AVX2 __attribute__((target("avx2")))
#define WITH_AVX512 __attribute__((target("avx512f,avx512dq,prefer-vector-width=512")))

/* The best of three builds of one function for this processor. */
#define BEST_OF(name)                                                                                                \
    (__builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512dq")                                         \
         ? name##_avx512                                                                                             \
         : __builtin_cpu_supports("avx2") ? name##_avx2 : name##_anywhere)
#define BUILDS_OF(name, ARGUMENTS, GIVEN)                        \
    static void name##_anywhere(ARGUMENTS) { name GIVEN; }       \
    WITH_AVX2 static void name##_avx2(ARGUMENTS) { name GIVEN; } \
    WITH_AVX512 static void name##_avx512(ARGUMENTS) { name GIVEN; }
#else
#define BEST_OF(name) name##_anywhere
#define BUILDS_OF(name, ARGUMENTS, GIVEN) \
    static void name##_anywhere(ARGUMENTS) { name GIVEN; }
#endif

/* to = to + M' from, M (m, width): its rows are worked on side by side. */
ALWAYS_INLINE void add(const int m, const int width, const double *restrict M, const double *restrict from,
                       double *restrict to)
{
    for (int j = 0; j < m; j++)
        for (int i = 0; i < width; i++) to[i] += M[j * width + i] * from[j];
}

/* x_k = A x_(k-1) + x_k, k = 1..count-1, with At the transpose of A, its rows padded with zeros to `width`. */
ALWAYS_INLINE void run(const int m, const int width, const size_t count, const double *restrict At,
                       double *restrict x)
{
    double now[MOST_STATES] = {0}, next[MOST_STATES] = {0};
    if (count) memcpy(now, x, (size_t)m * sizeof(double));
    for (size_t k = 1; k < count; k++) {
        memcpy(next, x + k * (size_t)m, (size_t)m * sizeof(double));
        add(m, width, At, now, next);
        memcpy(now, next, (size_t)width * sizeof(double));
        memcpy(x + k * (size_t)m, now, (size_t)m * sizeof(double));
    }
}

/* The largest number of states that these functions take. */
int tr_most_states(void) { return MOST_STATES; }

/* x_k = A x_(k-1) + x_k for k = 1..count-1, x (count, m), A (m, m). */
void tr_run(size_t count, int m, const double *A, double *x)
{
    double At[MOST_STATES * MOST_STATES] = {0};
    const int width = m <= WIDE ? WIDE : m;
    for (int i = 0; i < m; i++)
        for (int j = 0; j < m; j++) At[j * width + i] = A[i * m + j];
    /* Sizes that are known when compiled keep their rows in registers. */
    switch (m) {
    case 4: run(4, WIDE, count, At, x); break;
    case 5: run(5, WIDE, count, At, x); break;
    case 6: run(6, WIDE, count, At, x); break;
    case 7: run(7, WIDE, count, At, x); break;
    case 8: run(8, WIDE, count, At, x); break;
    default: run(m, width, count, At, x);
    }
}

/* x_k = P_(k-1) x_(k-1) + x_k for k = 1..count-1, x (count, m), P (count - 1, m, m). */
void tr_forwards(size_t count, int m, const double *P, double *x)
{
    const size_t n = (size_t)m;
    for (size_t k = 1; k < count; k++)
        for (size_t i = 0; i < n; i++) {
            double sum = x[k * n + i];
            for (size_t j = 0; j < n; j++) sum += P[((k - 1) * n + i) * n + j] * x[(k - 1) * n + j];
            x[k * n + i] = sum;
        }
}

/* x_k = P_k' x_(k+1) + x_k for k = count-2..0. */
void tr_backwards(size_t count, int m, const double *P, double *x)
{
    const size_t n = (size_t)m;
    for (size_t k = count; k-- > 1;)
        for (size_t i = 0; i < n; i++)
            for (size_t j = 0; j < n; j++) x[(k - 1) * n + j] += P[((k - 1) * n + i) * n + j] * x[k * n + i];
}

/* The widest row of a linear system that these functions take, and the most outputs of which they keep the largest. */
int tr_most_width(void) { return MOST_WIDTH; }
int tr_most_largest(void) { return MOST_LARGEST; }

/* The most courses that are worked on one by one, rows side by side, if the rows have at most this width. */
int tr_most_few(void) { return MOST_FEW; }
int tr_most_dense(void) { return MOST_DENSE; }

/* Time series processed side by side: up to four registers of the widest kind. One alone would wait for its own results
 * most of the time. */
enum { REGISTERS = 4, LANES = REGISTERS * ABREAST, STEPS = 8 };
typedef struct {
    wide in[REGISTERS];
} lanes;

/* Sparse rows: that of number i has the entries from starts[i] to starts[i + 1], one at least. */
struct sparse {
    const int *starts, *columns;
    const double *values;
};

/* The sum of a row over the vector z in the lanes of the first registers. */
ALWAYS_INLINE void sum_of(const int registers, const struct sparse *rows, const int row, const lanes *z, lanes *to)
{
    const int end = rows->starts[row + 1];
    int at = rows->starts[row];
    wide sum[REGISTERS];
    for (int r = 0; r < registers; r++) sum[r] = rows->values[at] * z[rows->columns[at]].in[r];
    while (++at < end)
        for (int r = 0; r < registers; r++) sum[r] += rows->values[at] * z[rows->columns[at]].in[r];
    for (int r = 0; r < registers; r++) to->in[r] = sum[r];
}

/* One course: its system [D C; B A] over inputs and states by columns, S (inputs + m, width), its rows padded with zeros
 * to a multiple of eight. See `tr_courses` and, if `terms`, `tr_largest`. */
#define COURSE_ARGUMENTS                                                                                             \
    const size_t count, const int m, const int inputs, const int outputs, const int terms, const int width,          \
        const double *S, const double *u, double *y, double *state, const int back
typedef void course_of(COURSE_ARGUMENTS);

/* The sums of the first rows that fill so many registers over inputs `felt` and states `now`. */
ALWAYS_INLINE void sums_in(const int registers, const int inputs, const int m, const int width, const double *S,
                           const double *felt, const double *now, double *to)
{
    wide sum[REGISTERS] = {0}, row;
    for (int j = 0; j < inputs + m; j++, S += width) {
        const double by = j < inputs ? felt[j] : now[j - inputs];
        for (int r = 0; r < registers; r++) {
            memcpy(&row, S + r * ABREAST, sizeof row);
            sum[r] += row * by;
        }
    }
    memcpy(to, sum, (size_t)registers * sizeof *sum);
}

ALWAYS_INLINE void course(COURSE_ARGUMENTS)
{
    /* Outputs and then states, of this step and the one before. */
    double held[2][MOST_DENSE] = {{0}}, felt[MOST_WIDTH];
    wide most[MOST_LARGEST / ABREAST] = {0}, seen;
    const int kept = terms ? outputs / terms : 0;
    if (state) memcpy(held[1] + outputs, state, (size_t)m * sizeof *state);
    for (size_t s = 0; s < count; s++) {
        const size_t k = back ? count - 1 - s : s;
        const double *now = held[1 - s % 2] + outputs;
        double *to = held[s % 2];
        for (int i = 0; i < inputs; i++) felt[i] = u[(size_t)i * count + k];
        /* From the end, where the states are, for which the next step waits. */
        for (int left = width / ABREAST, used; left > 0; left -= used) {
            used = left < REGISTERS ? left : REGISTERS;
            const int at = (left - used) * ABREAST;
            switch (used) {
            case 1: sums_in(1, inputs, m, width, S + at, felt, now, to + at); break;
            case 2: sums_in(2, inputs, m, width, S + at, felt, now, to + at); break;
            case 3: sums_in(3, inputs, m, width, S + at, felt, now, to + at); break;
            default: sums_in(REGISTERS, inputs, m, width, S + at, felt, now, to + at);
            }
        }
        for (int i = 0; i < outputs && !terms; i++) y[(size_t)i * count + k] = to[i];
        for (int i = 0; i < kept && terms > 1; i++) {
            double whole = 0;
            for (int j = 0; j < terms; j++) whole += fabs(to[i * terms + j]);
            to[i] = whole;
        }
        for (int r = 0; r * ABREAST < kept; r++) {
            memcpy(&seen, to + r * ABREAST, sizeof seen);
            to_magnitude(&seen), keep_larger(&seen, most + r);
        }
    }
    if (state) memcpy(state, held[1 - count % 2] + outputs, (size_t)m * sizeof *state);
    if (terms) memcpy(y, most, (size_t)kept * sizeof *y);
}

BUILDS_OF(course, COURSE_ARGUMENTS, (count, m, inputs, outputs, terms, width, S, u, y, state, back))

#define COURSES_ARGUMENTS                                                                                            \
    const size_t count, const int m, const int inputs, const int outputs, const int terms, const struct sparse *rows, \
        const double *u, double *y, double *state, const int back, const size_t used
typedef void courses_of(COURSES_ARGUMENTS);

/* One block of up to LANES courses in this many registers, see `tr_courses` and, if `terms`, `tr_largest`. */
ALWAYS_INLINE void courses_in(const int registers, COURSES_ARGUMENTS)
{
    /* Inputs and outputs of some steps at a time: those of one course stand together in memory. */
    const int height = inputs + (terms ? 0 : outputs), fit = 2 * MOST_WIDTH / height, block = fit < STEPS ? fit : STEPS;
    lanes z[MOST_WIDTH + MOST_STATES], next[MOST_STATES], held[2 * MOST_WIDTH], most[MOST_LARGEST], sum, whole;
    double column[LANES] = {0}, columns[STEPS][LANES] = {{0}};
    const ptrdiff_t ahead = back ? -1 : 1;
    memset(z, 0, (size_t)(inputs + m) * sizeof *z);
    if (terms) memset(most, 0, (size_t)(outputs / terms) * sizeof *most);
    for (int i = 0; i < m && state; i++) {
        for (size_t c = 0; c < used; c++) column[c] = state[c * (size_t)m + (size_t)i];
        memcpy(z + inputs + i, column, sizeof column);
    }
    for (size_t s = 0; s < count; s++) {
        const int t = (int)(s % (size_t)block), left = count - s < (size_t)block ? (int)(count - s) : block;
        for (int i = 0; i < inputs && t == 0; i++) {
            for (size_t c = 0; c < used; c++) {
                const double *from = u + (c * (size_t)inputs + (size_t)i) * count + (back ? count - 1 - s : s);
                for (int j = 0; j < left; j++) columns[j][c] = from[j * ahead];
            }
            for (int j = 0; j < left; j++) memcpy(held + j * height + i, columns[j], sizeof *held);
        }
        memcpy(z, held + t * height, (size_t)inputs * sizeof *z);
        int row = 0;
        for (int i = 0; i < outputs && !terms; i++, row++)
            sum_of(registers, rows, row, z, held + t * height + inputs + i);
        for (int i = 0; i < outputs && !terms && (t == block - 1 || s == count - 1); i++) {
            for (int j = 0; j <= t; j++) memcpy(columns[j], held + j * height + inputs + i, sizeof *held);
            for (size_t c = 0; c < used; c++) {
                const size_t first = back ? count - 1 - s + (size_t)t : s - (size_t)t;
                double *to = y + (c * (size_t)outputs + (size_t)i) * count + first;
                for (int j = 0; j <= t; j++) to[j * ahead] = columns[j][c];
            }
        }
        for (int i = 0; terms && i < outputs / terms; i++) {
            sum_of(registers, rows, row++, z, &whole);
            for (int r = 0; r < registers; r++) to_magnitude(whole.in + r);
            for (int j = 1; j < terms; j++) {
                sum_of(registers, rows, row++, z, &sum);
                for (int r = 0; r < registers; r++) to_magnitude(sum.in + r), whole.in[r] += sum.in[r];
            }
            for (int r = 0; r < registers; r++) keep_larger(whole.in + r, most[i].in + r);
        }
        for (int i = 0; i < m; i++, row++) sum_of(registers, rows, row, z, next + i);
        for (int i = 0; i < m; i++)
            for (int r = 0; r < registers; r++) z[inputs + i].in[r] = next[i].in[r];
    }
    for (int i = 0; i < m && state; i++) {
        memcpy(column, z + inputs + i, sizeof column);
        for (size_t c = 0; c < used; c++) state[c * (size_t)m + (size_t)i] = column[c];
    }
    for (int i = 0; terms && i < outputs / terms; i++) {
        memcpy(column, most + i, sizeof column);
        for (size_t c = 0; c < used; c++) y[c * (size_t)(outputs / terms) + (size_t)i] = column[c];
    }
}

ALWAYS_INLINE void courses(COURSES_ARGUMENTS)
{
    switch ((used + ABREAST - 1) / ABREAST) {
    case 1: courses_in(1, count, m, inputs, outputs, terms, rows, u, y, state, back, used); break;
    case 2: courses_in(2, count, m, inputs, outputs, terms, rows, u, y, state, back, used); break;
    case 3: courses_in(3, count, m, inputs, outputs, terms, rows, u, y, state, back, used); break;
    default: courses_in(REGISTERS, count, m, inputs, outputs, terms, rows, u, y, state, back, used);
    }
}

BUILDS_OF(courses, COURSES_ARGUMENTS, (count, m, inputs, outputs, terms, rows, u, y, state, back, used))

/* Of any number of courses, a few one by one and more of them side by side. */
ALWAYS_INLINE void any_courses(size_t number, const size_t count, const int m, const int inputs, const int outputs,
                               const int terms, const int width, const double *S, const struct sparse *rows,
                               const double *u, double *y, double *state, const int back)
{
    courses_of *const side_by_side = BEST_OF(courses);
    course_of *const alone = BEST_OF(course);
    const size_t found = terms ? (size_t)(outputs / terms) : (size_t)outputs * count;
    for (size_t used; number > 0; number -= used) {
        const int few = !rows->starts || (number <= MOST_FEW && width <= MOST_DENSE);
        used = few ? 1 : number < LANES ? number : LANES;
        if (few) alone(count, m, inputs, outputs, terms, width, S, u, y, state, back);
        else side_by_side(count, m, inputs, outputs, terms, rows, u, y, state, back, used);
        u += used * (size_t)inputs * count, y += used * found;
        if (state) state += used * (size_t)m;
    }
}

/* y_k = C x_k + D u_k along x_(k+1) = A x_k + B u_k, x = 0 at first, for k = 0..count-1 or, `back`, for count-1..0, of
 * any number of courses: u (courses, inputs, count), y (courses, outputs, count). The system is [D C; B A] over inputs
 * and states, by columns in S (inputs + m, width) and as sparse rows, without which (NULL) width <= MOST_DENSE. Neither
 * outputs + m nor the number of inputs is above MOST_WIDTH. */
void tr_courses(size_t number, size_t count, int m, int inputs, int outputs, int width, const double *S,
                const int *starts, const int *columns, const double *values, const double *u, double *y, int back)
{
    const struct sparse rows = {starts, columns, values};
    any_courses(number, count, m, inputs, outputs, 0, width, S, &rows, u, y, NULL, back);
}

/* The largest |y| of every output along the same system, or of the sums of so many |y| one after the other, of any
 * number of courses: found (courses, outputs / terms), at most MOST_LARGEST of them; u (courses, inputs, count). The
 * state (courses, m) at first becomes that after all steps. The largest with a NaN is NaN. */
void tr_largest(size_t number, size_t count, int m, int inputs, int outputs, int terms, int width, const double *S,
                const int *starts, const int *columns, const double *values, const double *u, double *state,
                double *found)
{
    const struct sparse rows = {starts, columns, values};
    any_courses(number, count, m, inputs, outputs, terms, width, S, &rows, u, found, state, 0);
}

/* x_(k+1) = M x_k + b (gain_k + by_first x_k[0]) h_k for k = 0..count-1, from x_0 on: x (count + 1, m), M (m, m). */
void tr_bilinear(size_t count, int m, const double *M, const double *b, const double *gain, double by_first,
                 const double *h, double *x)
{
    const size_t n = (size_t)m;
    for (size_t k = 0; k < count; k++) {
        const double *from = x + k * n;
        const double pushed = (gain[k] + by_first * from[0]) * h[k];
        for (size_t i = 0; i < n; i++) {
            double sum = b[i] * pushed;
            for (size_t j = 0; j < n; j++) sum += M[i * n + j] * from[j];
            x[(k + 1) * n + i] = sum;
        }
    }
}

enum { HEATED = 16, BESIDE = 4 }; /* steps that are computed together, in vector registers, and courses in turns */

/* Means of (|i| + ripple)^2 over steps in which i follows a held command through one pole, i = c + (i_0 - c) e^(-w t),
 * for courses (courses, count) of i_0 and c. Of a step of w times its length x, factors (4, count) are x, e^(-x),
 * (1 - e^(-x)) / x and (1 - e^(-2x)) / (2x). */
void tr_square_means(size_t courses, size_t count, const double *factors, double ripple, const double *before,
                     const double *command, double *found)
{
    const double *x = factors, *left = x + count, *of_mean = left + count, *of_square = of_mean + count;
    for (; courses > 0; courses--, before += count, command += count, found += count)
        for (size_t first = 0; first < count; first += HEATED) {
            const size_t last = count - first < HEATED ? count : first + HEATED;
            int turns = 0;
            for (size_t k = first; k < last; k++) {
                const double c = command[k], away = before[k] - c, mean = c + away * of_mean[k];
                const double square = c * (2 * mean - c) + away * away * of_square[k];
                found[k] = square + 2 * ripple * fabs(mean) + ripple * ripple;
                turns |= before[k] * (c + away * left[k]) < 0;
            }
            for (size_t k = first; k < last && turns; k++) {
                const double c = command[k], away = before[k] - c, mean = c + away * of_mean[k];
                if (!(before[k] * (c + away * left[k]) < 0)) continue;
                /* i is zero where e^(-w t) = -c / (i_0 - c); before that it has the other sign. */
                const double share = -c / away, until = (-c * log(share) + away * (1 - share)) / x[k];
                found[k] += 2 * ripple * (fabs(until) + fabs(mean - until) - fabs(mean));
            }
        }
}

/* (e^x - 1) / x near zero by its series, of which |x| < NEAR neglects less than the rounding. */
#define NEAR 0.0625
ALWAYS_INLINE double near_growth(double x)
{
    static const double inverse_factorial[] = {1. / 2, 1. / 6, 1. / 24, 1. / 120, 1. / 720, 1. / 5040, 1. / 40320,
                                               1. / 362880, 1. / 3628800};
    double sum = inverse_factorial[8];
    for (int k = 7; k >= 0; k--) sum = sum * x + inverse_factorial[k];
    return 1 + sum * x;
}

/* Increments T+ - T = p T + s of both temperatures over up to HEATED steps, p by rows and then s; see `tr_heated`. */
ALWAYS_INLINE void heat_maps(const size_t used, const double *heat, const double *q, const double *steps,
                             double (*restrict map)[HEATED])
{
    const double m12 = heat[1], m21 = heat[2], m22 = heat[3], c2 = heat[5];
    double high[HEATED], low[HEATED], fast[HEATED], slow[HEATED], half[HEATED], distance[HEATED];
    double m11[HEATED], heating[HEATED], h[HEATED];
    int away = 0;
    for (size_t j = 0; j < HEATED; j++) heating[j] = j < used ? q[j] : 0, h[j] = j < used ? steps[j] : 0;
    for (int j = 0; j < HEATED; j++) {
        m11[j] = heat[0] * heating[j] - m12;
        half[j] = (m11[j] - m22) / 2;
        const double mean = (m11[j] + m22) / 2, root = sqrt(half[j] * half[j] + m12 * m21);
        distance[j] = root < DBL_MIN ? DBL_MIN : root;
        high[j] = (mean + distance[j]) * h[j], low[j] = (mean - distance[j]) * h[j];
        fast[j] = near_growth(low[j]), slow[j] = near_growth(high[j]);
        away |= !(fabs(low[j]) < NEAR) | !(fabs(high[j]) < NEAR);
    }
    for (int j = 0; j < HEATED && away; j++) {
        if (!(fabs(low[j]) < NEAR)) fast[j] = expm1(low[j]) / low[j];
        if (!(fabs(high[j]) < NEAR)) slow[j] = expm1(high[j]) / high[j];
    }
    for (int j = 0; j < HEATED; j++) {
        const double level = h[j] * (slow[j] + fast[j]) / 2, slope = h[j] * (slow[j] - fast[j]) / (2 * distance[j]);
        const double f11 = level + slope * half[j], f22 = level - slope * half[j], c1 = heat[4] * heating[j];
        const double f12 = slope * m12, f21 = slope * m21;
        map[0][j] = f11 * m11[j] + f12 * m21, map[1][j] = f11 * m12 + f12 * m22;
        map[2][j] = f21 * m11[j] + f22 * m21, map[3][j] = f21 * m12 + f22 * m22;
        map[4][j] = f11 * c1 + f12 * c2, map[5][j] = f21 * c1 + f22 * c2;
    }
}

#define HEAT_ARGUMENTS const size_t used, const double *heat, const double *q, const double *steps, double (*map)[HEATED]
typedef void heat_maps_of(HEAT_ARGUMENTS);

BUILDS_OF(heat_maps, HEAT_ARGUMENTS, (used, heat, q, steps, map))

/* So many courses of `tr_heated` in turns: the steps of one do not wait for those of the others. */
ALWAYS_INLINE void heated_in(const size_t beside, heat_maps_of *maps, const size_t count, const double *heat,
                             const double *q, const double *steps, double *winding, double *housing)
{
    double map[BESIDE][6][HEATED], rise[BESIDE] = {0}, rise_h[BESIDE] = {0};
    for (size_t first = 0; first < count; first += HEATED) {
        const size_t used = count - first < HEATED ? count - first : HEATED;
        for (size_t c = 0; c < beside; c++) maps(used, heat, q + c * count + first, steps + first, map[c]);
        for (size_t j = 0; j < used; j++)
            for (size_t c = 0; c < beside; c++) {
                double *warm = winding + c * (count + 1), *warm_h = housing + c * (count + 1);
                const double p11 = map[c][0][j], p12 = map[c][1][j], p21 = map[c][2][j], p22 = map[c][3][j];
                const double s1 = p11 * warm[0] + p12 * warm_h[0] + map[c][4][j];
                const double s2 = p21 * warm[0] + p22 * warm_h[0] + map[c][5][j];
                const double next = (1 + p11) * rise[c] + p12 * rise_h[c] + s1;
                rise_h[c] = p21 * rise[c] + (1 + p22) * rise_h[c] + s2;
                rise[c] = next;
                warm[first + j + 1] = isfinite(next) ? warm[0] + next : INFINITY;
                warm_h[first + j + 1] = isfinite(rise_h[c]) ? warm_h[0] + rise_h[c] : INFINITY;
            }
    }
}

/* Temperatures T of a coil's winding and housing, dT/dt = m T + c, exact for steps of constant heating q = i_eff^2:
 * m = (heat[0] q - heat[1], heat[1]; heat[2], heat[3]) and c = (heat[4] q, heat[5]). The eigenvalues of m are real.
 * A step is T+ = T + f (m T + c) with f the step times the mean growth (e^x - 1) / x of m, a function of a 2 x 2 matrix:
 * with the eigenvalues a +- d it is the mean of its values at a + d and a - d, plus their difference over 2 d times
 * (m - a). The rise above the start has a recursion of its own, so that small rises keep their digits.
 * q (courses, count), steps (count); winding, housing (courses, count + 1) with the start in their first column. What
 * is not finite becomes infinite. */
void tr_heated(size_t courses, size_t count, const double *heat, const double *q, const double *steps, double *winding,
               double *housing)
{
    heat_maps_of *const maps = BEST_OF(heat_maps);
    for (size_t used; courses > 0; courses -= used) {
        used = courses < BESIDE ? 1 : BESIDE;
        if (used == 1) heated_in(1, maps, count, heat, q, steps, winding, housing);
        else heated_in(BESIDE, maps, count, heat, q, steps, winding, housing);
        q += used * count, winding += used * (count + 1), housing += used * (count + 1);
    }
}

/* Slopes d per spacing of the not-a-knot spline through y at `knots` >= 4 evenly spaced ones, courses side by side:
 * both (knots, courses). They obey d_(k-1) + 4 d_k + d_(k+1) = 3 (y_(k+1) - y_(k-1)). With d_(k-1) eliminated that is
 * d_k + above_k d_(k+1) = slopes_k, which is solved from the last knot back. */
ALWAYS_INLINE void slopes_of(const size_t knots, const size_t courses, const double *restrict y,
                             double *restrict above, double *restrict slopes)
{
    const size_t last = knots - 1;
    above[0] = 2;
    for (size_t c = 0; c < courses; c++)
        slopes[c] = 0.5 * (4 * y[courses + c] + y[2 * courses + c] - 5 * y[c]);
    for (size_t k = 1; k < last; k++) {
        /* The pivots converge to a constant; reusing it avoids a division at every further knot. */
        const double pivot = k > 2 && above[k - 1] == above[k - 2] ? above[k - 1] : 1 / (4 - above[k - 1]);
        const double *next = y + (k + 1) * courses, *before = y + (k - 1) * courses;
        double *at = slopes + k * courses, *last_d = at - courses;
        above[k] = pivot;
        for (size_t c = 0; c < courses; c++) at[c] = (3 * (next[c] - before[c]) - last_d[c]) * pivot;
    }
    const double pivot = 1 / (1 - 2 * above[last - 1]);
    for (size_t c = 0; c < courses; c++) {
        const double *at = y + last * courses + c;
        const double right = 0.5 * (5 * at[0] - 4 * at[-(ptrdiff_t)courses] - at[-2 * (ptrdiff_t)courses]);
        slopes[last * courses + c] = (right - 2 * slopes[(last - 1) * courses + c]) * pivot;
    }
    for (size_t k = last; k-- > 0;)
        for (size_t c = 0; c < courses; c++)
            slopes[k * courses + c] -= above[k] * slopes[(k + 1) * courses + c];
}

/* The not-a-knot spline through y at `knots` >= 4 evenly spaced ones, (knots, courses), at `count` places counted in
 * spacings from the first knot: found (count, courses). The outermost pieces go on beyond the outermost knots.
 * work (knots, courses + 1). */
void tr_spline(size_t knots, size_t courses, const double *y, size_t count, const double *places, double *work,
               double *found)
{
    double *slopes = work + knots;
    if (courses == 1) slopes_of(knots, 1, y, work, slopes);
    else if (courses == 4) slopes_of(knots, 4, y, work, slopes);
    else slopes_of(knots, courses, y, work, slopes);
    for (size_t i = 0; i < count; i++) {
        const double place = places[i], last = (double)(knots - 2);
        const size_t left = place >= last ? knots - 2 : place >= 0 ? (size_t)place : 0; /* NaN: the first piece */
        const double t = place - (double)left;
        const double *at = y + left * courses, *slope = slopes + left * courses;
        for (size_t c = 0; c < courses; c++) {
            const double rise = at[courses + c] - at[c], after = slope[courses + c];
            const double curved = 3 * rise - 2 * slope[c] - after + t * (slope[c] + after - 2 * rise);
            found[i * courses + c] = at[c] + t * (slope[c] + t * curved);
        }
    }
}

/* As `tr_spline` for one course at `count` evenly spaced places first, first + step, ..., step > 0. */
void tr_spline_even(size_t knots, const double *y, size_t count, double first, double step, double *work, double *found)
{
    double *slopes = work + knots;
    slopes_of(knots, 1, y, work, slopes);
    for (size_t i = 0; i < count;) {
        const double place = first + (double)i * step, last = (double)(knots - 2);
        const size_t left = place >= last ? knots - 2 : place >= 0 ? (size_t)place : 0;
        const double from = y[left], slope = slopes[left], rise = y[left + 1] - from, after = slopes[left + 1];
        const double curved = 3 * rise - 2 * slope - after, more = slope + after - 2 * rise;
        const double length = left == knots - 2 ? INFINITY : 1; /* the last piece goes on */
        double t = place - (double)left;
        do {
            found[i++] = from + t * (slope + t * (curved + t * more));
            t = first + (double)i * step - (double)left;
        } while (i < count && t < length);
    }
}

/* Runge-Kutta stages of a step of a strike, and the most outputs along it. */
enum { MOST_OUTPUTS = 4, STAGES = 4 };

ALWAYS_INLINE uint64_t bits_of(double x)
{
    uint64_t bits;
    memcpy(&bits, &x, sizeof bits);
    return bits;
}

ALWAYS_INLINE double of_bits(uint64_t bits)
{
    double x;
    memcpy(&x, &bits, sizeof x);
    return x;
}

/* x^exponent for x > 0 to a few units of the last place. A library's pow has branches; without any, lanes go side by
 * side. x = 2^k m with m within a factor sqrt(2) of 1; ln m = 2 artanh s; the exponential by its series. */
ALWAYS_INLINE double power(double x, double exponent)
{
    const double whole = 4503599627370496.0, nearest = 6755399441055744.0; /* 2^52 and 1.5 2^52 */
    const double ln2 = 0.69314718055994531, ln2_high = 0.693147180369123816490, ln2_low = 1.90821492927058770002e-10;
    const uint64_t shifted = bits_of(x) + 0x95F619980C433ULL; /* sqrt(2) to 2: k is one more from sqrt(2) on */
    const double k = of_bits((shifted >> 52) | 0x4330000000000000ULL) - (whole + 1023.0);
    const double m = of_bits((shifted & 0xFFFFFFFFFFFFFULL) + 0x3FE6A09E667F3BCDULL);
    const double s = (m - 1) / (m + 1), q = s * s;
    /* Even and odd terms of both series apart: half as many operations wait for each other. */
    const double p = q * q, even = 1 + p * (1. / 5 + p * (1. / 9 + p * (1. / 13 + p * (1. / 17 + p * (1. / 21)))));
    const double odd = 1. / 3 + p * (1. / 7 + p * (1. / 11 + p * (1. / 15 + p * (1. / 19))));
    const double y = exponent * (k * ln2 + 2 * s * (even + q * odd));
    const double up = y * (1 / ln2) + nearest, n = up - nearest, r = (y - n * ln2_high) - n * ln2_low, t = r * r;
    double symmetric = 1. / 479001600, skew = 1. / 6227020800; /* 1 / 12! and 1 / 13! */
    symmetric = 1 + t * (1. / 2 + t * (1. / 24 + t * (1. / 720 + t * (1. / 40320 + t * (1. / 3628800 + t * symmetric)))));
    skew = 1 + t * (1. / 6 + t * (1. / 120 + t * (1. / 5040 + t * (1. / 362880 + t * (1. / 39916800 + t * skew)))));
    const double e = of_bits(bits_of(symmetric + r * skew) + (bits_of(up) << 52));
    return y > 700 ? INFINITY : y < -700 ? 0 : e;
}

/* One block of up to LANES courses in this many registers, see `tr_struck`. */
ALWAYS_INLINE void strike_in(const int registers, const size_t steps, const int n, const int outputs,
                             const size_t columns, const struct sparse *rows, const double *contact,
                             lanes *restrict z, double *found, const size_t used)
{
    lanes seen[2], next[MOST_OUTPUTS + MOST_STATES];
    double depth[LANES], closing[LANES], force[LANES];
    const int count = registers * ABREAST;
    for (size_t k = 0; k <= steps; k++) {
        int row = 0;
        for (int j = 0; j < STAGES; j++) {
            for (int o = 0; o < 2; o++, row++) sum_of(registers, rows, row, z, seen + o);
            memcpy(depth, seen, (size_t)count * sizeof *depth);
            memcpy(closing, seen + 1, (size_t)count * sizeof *closing);
            for (int c = 0; c < count; c++) {
                const double risen = contact[0] * power(depth[c], contact[1]);
                /* NaN stays NaN. */
                const double elastic = depth[c] > 0 ? risen : depth[c] <= 0 ? 0 : depth[c];
                const double whole = elastic * (1 + contact[2] * closing[c]);
                force[c] = whole < 0 ? 0 : whole;
            }
            memcpy(z + n + j, force, (size_t)count * sizeof *force);
        }
        for (int i = 0; i < outputs + n; i++, row++)
            sum_of(registers, rows, row, z, next + i);
        for (int i = 0; i < outputs; i++)
            memcpy(found + (k * (size_t)outputs + (size_t)i) * columns, next + i, used * sizeof(double));
        if (k < steps)
            for (int i = 0; i < n; i++)
                for (int r = 0; r < registers; r++) z[i].in[r] = next[outputs + i].in[r];
    }
}

#define STRIKE_ARGUMENTS                                                                                             \
    size_t steps, int n, int outputs, size_t columns, const struct sparse *rows, const double *contact, lanes *z,   \
        double *found, size_t used
typedef void strike_of(STRIKE_ARGUMENTS);

ALWAYS_INLINE void strike(STRIKE_ARGUMENTS)
{
    switch ((used + ABREAST - 1) / ABREAST) {
    case 1: strike_in(1, steps, n, outputs, columns, rows, contact, z, found, used); break;
    case 2: strike_in(2, steps, n, outputs, columns, rows, contact, z, found, used); break;
    case 3: strike_in(3, steps, n, outputs, columns, rows, contact, z, found, used); break;
    default: strike_in(REGISTERS, steps, n, outputs, columns, rows, contact, z, found, used);
    }
}

BUILDS_OF(strike, STRIKE_ARGUMENTS, (steps, n, outputs, columns, rows, contact, z, found, used))

/* A linear system of n states x and a contact's force on it by the Runge-Kutta method of fourth order. Its rows,
 * (8 + outputs + n, n + 4), are sums over x and the forces F_0 to F_3 of the four stages: depth and closing speed at
 * each stage, of which F_j = stiffness depth^exponent (1 + damping closing), never below 0, follows; outputs; x after
 * the step; `where` are their columns.
 * For `columns` courses: state (n, columns), in the end that after all steps; found (steps + 1, outputs, columns). */
void tr_struck(size_t steps, int n, int outputs, size_t columns, const int *starts, const int *where,
               const double *values, const double *contact, double *state, double *found)
{
    const struct sparse rows = {starts, where, values};
    strike_of *const go = BEST_OF(strike);
    for (size_t first = 0; first < columns; first += LANES) {
        const size_t used = columns - first < LANES ? columns - first : LANES;
        lanes z[MOST_STATES + STAGES];
        memset(z, 0, sizeof z);
        for (int i = 0; i < n; i++) memcpy(z + i, state + (size_t)i * columns + first, used * sizeof(double));
        go(steps, n, outputs, columns, &rows, contact, z, found + first, used);
        for (int i = 0; i < n; i++) memcpy(state + (size_t)i * columns + first, z + i, used * sizeof(double));
    }
}

/* The numbers of a virtual wall's law: the coefficient of its derivative filter, the servo period, stiffness, damping,
 * force per current, the largest current, the two coefficients of the amplifier's prefilter, the encoder's count. */
enum { SMOOTHING, PERIOD, STIFFNESS, DAMPING, FORCE, LARGEST, NOW, BEFORE, COUNT };

/* Courses of x_(k+1) = A x_k + B u_k from rest, to whose commands a virtual wall adds its feedback tick by tick.
 * At tick k the `inputs` commands from number k on act, and the feedback is added to that of number behind + k; S
 * (inputs + m, width) holds the columns of [B A], padded with zeros. The encoder reads nominal_k + encoder (u_k; x_k),
 * with those deviations kept in read; nominal and read (courses, count), command (courses, behind + count). A reading
 * counts `late` ticks later: current (courses, late + count) has the wall's current of the readings before the first
 * tick at first. State (courses, 2) is the encoder's position and filtered velocity before the first tick. */
void tr_walled(size_t courses, size_t count, int m, int inputs, int width, size_t behind, size_t late, const double *S,
               const double *encoder, const double *law, const double *nominal, const double *state, double *current,
               double *command, double *read)
{
    for (size_t c = 0; c < courses; c++) {
        double x[MOST_STATES] = {0}, next[MOST_STATES], position = state[2 * c], velocity = state[2 * c + 1];
        for (size_t k = 0; k < count; k++) {
            double off = 0;
            for (int i = 0; i < inputs; i++) off += encoder[i] * command[k + (size_t)i];
            for (int i = 0; i < m; i++) off += encoder[inputs + i] * x[i];
            double z = nominal[k] + off;
            if (law[COUNT] > 0) z = rint(z / law[COUNT]) * law[COUNT];
            velocity = law[SMOOTHING] * velocity + (1 - law[SMOOTHING]) * (z - position) / law[PERIOD];
            position = z;
            const double wanted = -(law[STIFFNESS] * z + law[DAMPING] * velocity) / law[FORCE];
            current[late + k] = z < 0 ? (wanted < 0 ? 0 : wanted > law[LARGEST] ? law[LARGEST] : wanted) : 0;
            command[behind + k] += law[NOW] * current[k] + (k ? law[BEFORE] * current[k - 1] : 0);
            read[k] = off;
            memset(next, 0, (size_t)width * sizeof *next);
            add(inputs, width, S, command + k, next);
            add(m, width, S + inputs * width, x, next);
            memcpy(x, next, (size_t)width * sizeof *next);
        }
        nominal += count, read += count, current += late + count, command += behind + count;
    }
}
