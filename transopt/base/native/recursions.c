/* Linear recursions over the stages of a transient, in place: x holds what is added at every stage, and in the end
 * the states; linear systems with inputs and outputs, one that strikes something, and a spline, which is evaluated
 * from slopes that such a recursion gives. All arrays are row by row. C99 without dependencies, no global state, no
 * allocation.
 */
#include <math.h>
#include <stddef.h>
#include <string.h>

enum { MOST_STATES = 64, MOST_WIDTH = 96, WIDE = 8 };

#if defined(__GNUC__)
#define ALWAYS_INLINE static inline __attribute__((always_inline))
#else
#define ALWAYS_INLINE static inline
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

/* The largest number of states that there is room for. */
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

/* y_k = C x_k + D u_k along x_(k+1) = A x_k + B u_k, x = 0 at first, for k = 0..count-1 or, `back`, for count-1..0:
 * u (inputs, count), y (outputs, count), and S (m + inputs, width) = [A' C'; B' D'], its rows padded with zeros. */
ALWAYS_INLINE void outputs_of(const size_t count, const int m, const int inputs, const int outputs, const int width,
                              const double *restrict S, const double *restrict u, double *restrict y, const int back)
{
    double now[MOST_WIDTH] = {0}, next[MOST_WIDTH], felt[MOST_WIDTH];
    for (size_t s = 0; s < count; s++) {
        const size_t k = back ? count - 1 - s : s;
        for (int i = 0; i < inputs; i++) felt[i] = u[(size_t)i * count + k];
        memset(next, 0, (size_t)width * sizeof(double));
        add(inputs, width, S + m * width, felt, next);
        add(m, width, S, now, next);
        memcpy(now, next, (size_t)width * sizeof(double));
        for (int i = 0; i < outputs; i++) y[(size_t)i * count + k] = now[m + i];
    }
}

/* The widest row of a linear system that there is room for. */
int tr_most_width(void) { return MOST_WIDTH; }

/* As `outputs_of`; width >= m + outputs, and neither it nor the number of inputs above MOST_WIDTH. */
void tr_outputs(size_t count, int m, int inputs, int outputs, int width, const double *S, const double *u, double *y,
                int back)
{
    /* Widths that are known when compiled keep the sums in registers. */
    switch (width) {
    case 4: outputs_of(count, m, inputs, outputs, 4, S, u, y, back); break;
    case 8: outputs_of(count, m, inputs, outputs, 8, S, u, y, back); break;
    case 12: outputs_of(count, m, inputs, outputs, 12, S, u, y, back); break;
    case 16: outputs_of(count, m, inputs, outputs, 16, S, u, y, back); break;
    default: outputs_of(count, m, inputs, outputs, width, S, u, y, back);
    }
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

/* Cubic pieces between `knots` >= 2 evenly spaced ones, through y with the slopes d, (courses, knots) each and d per
 * spacing, at `count` places counted in spacings from the first knot: found (courses, count). The outermost pieces go
 * on beyond the outermost knots. */
void tr_cubic(size_t knots, size_t courses, const double *y, const double *d, size_t count, const double *places,
              double *found)
{
    for (size_t i = 0; i < count; i++) {
        const double place = places[i], last = (double)(knots - 2);
        const size_t left = place >= last ? knots - 2 : place >= 0 ? (size_t)place : 0; /* no number: the first */
        const double t = place - (double)left;
        for (size_t c = 0; c < courses; c++) {
            const double *at = y + c * knots + left, *slope = d + c * knots + left;
            const double rise = at[1] - at[0];
            const double curved = 3 * rise - 2 * slope[0] - slope[1] + t * (slope[0] + slope[1] - 2 * rise);
            found[c * count + i] = at[0] + t * (slope[0] + t * curved);
        }
    }
}

/* The force of a contact, stiffness depth^exponent (1 + damping closing), which never pulls. */
static double contact_force(const double contact[3], double depth, double closing)
{
    /* What is no number stays none. */
    const double elastic = depth > 0 ? contact[0] * pow(depth, contact[1]) : depth <= 0 ? 0 : depth;
    const double force = elastic * (1 + contact[2] * closing);
    return force < 0 ? 0 : force;
}

/* A linear system of n states and a contact's force on it by the Runge-Kutta method of fourth order, whose steps are
 *     x_(k+1) = by_state x_k + by_force F,  F_j = force(seen_j x_k + sum over i < j of earlier_ji F_i),  j = 0..3
 * with by_state (n, n), by_force (n, 4), seen (4, 2, n) and earlier (4, 2, 4): depth and closing speed at the four stages.
 * For `columns` courses: states (steps + 1, n, columns) from states_0 on, forces (steps + 1, columns) of stage 0. */
void tr_strike(size_t steps, int n, size_t columns, const double *by_state, const double *by_force, const double *seen,
               const double *earlier, const double *contact, double *states, double *forces)
{
    const size_t m = (size_t)n;
    for (size_t c = 0; c < columns; c++) {
        double now[MOST_STATES], next[MOST_STATES];
        for (size_t i = 0; i < m; i++) now[i] = states[i * columns + c];
        for (size_t k = 0; k <= steps; k++) {
            double F[4];
            for (size_t j = 0; j < 4; j++) {
                double at[2] = {0, 0};
                for (size_t o = 0; o < 2; o++) {
                    for (size_t i = 0; i < m; i++) at[o] += seen[(2 * j + o) * m + i] * now[i];
                    for (size_t i = 0; i < j; i++) at[o] += earlier[(2 * j + o) * 4 + i] * F[i];
                }
                F[j] = contact_force(contact, at[0], at[1]);
            }
            forces[k * columns + c] = F[0];
            if (k == steps) break;
            for (size_t i = 0; i < m; i++) {
                double sum = 0;
                for (size_t j = 0; j < m; j++) sum += by_state[i * m + j] * now[j];
                for (size_t j = 0; j < 4; j++) sum += by_force[i * 4 + j] * F[j];
                next[i] = sum;
            }
            for (size_t i = 0; i < m; i++) states[((k + 1) * m + i) * columns + c] = now[i] = next[i];
        }
    }
}
