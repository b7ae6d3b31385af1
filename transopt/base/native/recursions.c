/* Linear recursions over the stages of a transient, in place: x holds what is added at every stage, and in the end
 * the states; and a linear system that strikes something. All arrays are row by row. C99 without dependencies, no
 * global state, no allocation.
 */
#include <math.h>
#include <stddef.h>
#include <string.h>

enum { MOST_STATES = 64, WIDE = 8 };

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
