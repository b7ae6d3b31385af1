/* Linear recursions over the stages of a transient, in place: x holds what is added at every stage, and in the end
 * the states. All arrays are row by row. C99 without dependencies, no global state, no allocation.
 */
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
