/* A primal-dual interior-point method over the stages of one transient that several motors make together.
 *
 *     minimise    1/2 sum_k w_k |C x_k + E u_k - r_k|^2 + 1/2 s |u_k|^2 + 1/2 |Z x_N - z|^2 + constant
 *     subject to  x_(k+1) = A x_k + B u_k,  x_0 = 0,  B the last m columns of A,
 *                 u_k = -(held commands) over the last stages (the hand-over),
 *                 lower_k <= G x_k + d u_k[motor] <= upper_k,  k = 0..N-1.
 *
 * The movements u of m commands are the controls; the last m states are the commands held before. Predictor and
 * corrector follow Mehrotra (SIAM J. Optim. 2, 1992); each Newton step is a Riccati recursion (Rao, Wright, Rawlings,
 * J. Optim. Theory Appl. 99, 1998) with blocks of m controls. Where the states form pairs that only the commands
 * couple to others, as the modes of a device do, products with A are taken pair by pair. As in riccati.c, which knows
 * one motor with its wall and its temperature, every iterate obeys the dynamics: states are rolled out and the reduced
 * gradient comes from the adjoint recursion, so that rounding in a factorisation costs no digits of the answer.
 *
 * C99 without dependencies, no global state, no allocation. Compile with contraction of floating-point expressions off.
 * All arrays are row by row.
 */
#if !defined(WIDTH)
#include <math.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>

enum { MOST_STATES = 64, MOST_MOTORS = 4, MOST_ROWS = 64, MOST_OUTPUTS = 32 };

typedef struct {
    int stages, free_stages, states, motors, outputs, ends, rows;
    const double *A, *C, *E;               /* (n, n), (outputs, n), (outputs, m) */
    const double *weight, *reference;      /* (N, outputs), both */
    const double *end_gain, *end_target;   /* Z (ends, n), z (ends) */
    const double *G, *d;                   /* (rows, n), (rows) */
    const int *motor;                      /* (rows) index of the motor whose movement d multiplies */
    const double *lower, *upper;           /* (N, rows), infinite where there is no limit */
    double movement_weight, command_bound, constant;
} tm_problem;

typedef struct {
    double *command;          /* (N, m) */
    double *lower, *upper;    /* (N, rows) multipliers >= 0 */
    double *gradient;         /* (N, m) of the Lagrangian by u, with the hand-over as feedback */
    int iterations;
    double objective, gap, residual;
} tm_result;

enum { TM_SOLVED, TM_ACCURACY, TM_ITERATION_LIMIT, TM_STALLED, TM_BREAKDOWN, TM_TOO_LARGE, TM_NO_BOUNDS };

/* Measures of an iterate; `stationarity` is the gradient's part of the gap. */
typedef struct {
    double objective, complementarity, residual, stationarity;
} tm_state;

static const double FIRST_GAP = 3.0;   /* gap of the first iterate, in units of its objective */
static const double NEAR = 1e3;        /* times the tolerance: once below it, the best iterate is kept as answer */
static const double FARTHEST = 5e-3;   /* largest share of a slack or multiplier that a step has to leave */
static const double SHORTEST = 1e-10;  /* shortest useful step length, as a share of the Newton step */
static const double LAST_GAP = 0.03;   /* smallest gap that is aimed at, relative to the tolerance */
static const double LEAST = 1e-290;    /* negligible positive number that avoids a division by zero */
enum { PATIENCE = 6, SYMMETRISED = 16 };

#if defined(__GNUC__)
#define ALWAYS_INLINE static inline __attribute__((always_inline))
#else
#define ALWAYS_INLINE static inline
#endif
#define PASTE(name, width) name##_##width
#define OF_WIDTH(name, width) PASTE(name, width)
#define lanes OF_WIDTH(lanes, WIDTH)
#define choice OF_WIDTH(choice, WIDTH)
#define tm_work OF_WIDTH(tm_work, WIDTH)
#define tm_side OF_WIDTH(tm_side, WIDTH)
#define take OF_WIDTH(take, WIDTH)
#define lay_out OF_WIDTH(lay_out, WIDTH)
#define workspace OF_WIDTH(workspace, WIDTH)
#define prepare OF_WIDTH(prepare, WIDTH)
#define pair_up OF_WIDTH(pair_up, WIDTH)
#define weigh OF_WIDTH(weigh, WIDTH)
#define congruence OF_WIDTH(congruence, WIDTH)
#define factor_sized OF_WIDTH(factor_sized, WIDTH)
#define backward_sized OF_WIDTH(backward_sized, WIDTH)
#define forward_sized OF_WIDTH(forward_sized, WIDTH)
#define factor OF_WIDTH(factor, WIDTH)
#define flow OF_WIDTH(flow, WIDTH)
#define flow_back OF_WIDTH(flow_back, WIDTH)
#define backward OF_WIDTH(backward, WIDTH)
#define forward OF_WIDTH(forward, WIDTH)
#define judge OF_WIDTH(judge, WIDTH)
#define begin OF_WIDTH(begin, WIDTH)
#define directions OF_WIDTH(directions, WIDTH)
#define centre OF_WIDTH(centre, WIDTH)
#define longest OF_WIDTH(longest, WIDTH)
#define keep OF_WIDTH(keep, WIDTH)
#define solve OF_WIDTH(solve, WIDTH)
#define dot OF_WIDTH(dot, WIDTH)
#define add OF_WIDTH(add, WIDTH)
#define combine OF_WIDTH(combine, WIDTH)

#if !defined(__GNUC__)
#define ONLY_WIDTH 1
#elif defined(__clang__) || !defined(__x86_64__)
#define ONLY_WIDTH 2
#endif
#if defined(ONLY_WIDTH)
#define WIDTH ONLY_WIDTH
#include "motors.c"
#define BY_WIDTH(name) name /* `name` is itself a macro for the function of this WIDTH */
#else
#pragma GCC push_options
#pragma GCC target("avx512f,avx512dq,avx512vl,prefer-vector-width=512")
#define WIDTH 8
#include "motors.c"
#undef WIDTH
#pragma GCC pop_options
#pragma GCC push_options
#pragma GCC target("avx2")
#define WIDTH 4
#include "motors.c"
#undef WIDTH
#pragma GCC pop_options
#define WIDTH 2
#include "motors.c"
#define BY_WIDTH(name) \
    (__builtin_cpu_supports("avx512dq") && __builtin_cpu_supports("avx512vl") ? name##_8 \
     : __builtin_cpu_supports("avx2") ? name##_4 : name##_2)
#endif

/* Version of the interface, incremented when arguments or results change. */
int tm_interface(void) { return 1; }

/* Doubles of workspace that a problem needs; 0 if its sizes are not within this method's limits. */
size_t tm_workspace(const tm_problem *q)
{
    if (q->motors < 1 || q->motors > MOST_MOTORS || q->states < q->motors || q->states > MOST_STATES) return 0;
    if (q->rows < 0 || q->rows > MOST_ROWS || q->outputs < 1 || q->outputs > MOST_OUTPUTS || q->stages < 1) return 0;
    if (q->ends < 0 || q->ends > q->states || q->free_stages < 0 || q->free_stages > q->stages) return 0;
    return BY_WIDTH(workspace)(q);
}

/* Solve; the caller certifies the answer. Near the optimum rounding eventually prevents progress: the best iterate is
 * then returned, as TM_ACCURACY if it is not within the tolerance. Far from the optimum the last iterate is returned;
 * its multipliers may prove infeasibility. */
int tm_solve(const tm_problem *q, int max_iterations, double tolerance, double *space, tm_result *r)
{
    r->iterations = 0;
    if (!tm_workspace(q)) return TM_TOO_LARGE;
    for (size_t i = 0; i < (size_t)q->stages * (size_t)q->rows; i++) {
        const double lower = q->lower[i], upper = q->upper[i];
        if (!(lower <= upper) || lower == INFINITY || upper == -INFINITY) return TM_NO_BOUNDS;
    }
    return BY_WIDTH(solve)(q, max_iterations, tolerance, space, r);
}

#else
#if WIDTH > 1
typedef double lanes __attribute__((vector_size(8 * WIDTH), may_alias));
typedef long long choice __attribute__((vector_size(8 * WIDTH), may_alias));
/* Block j of v with the neighbours 2 i and 2 i + 1 swapped. */
#undef SWAPPED
#undef PAIRS
#if WIDTH == 8
#define PAIRS 1, 0, 3, 2, 5, 4, 7, 6
#elif WIDTH == 4
#define PAIRS 1, 0, 3, 2
#else
#define PAIRS 1, 0
#endif
#if defined(__clang__)
#define SWAPPED(v, j) __builtin_shufflevector((v)[j], (v)[j], PAIRS)
#else
#define SWAPPED(v, j) __builtin_shuffle((v)[j], (choice){PAIRS})
#endif
#else
typedef double lanes;
#define SWAPPED(v, j) (v)[(j) ^ 1]
#endif
#undef WHOLE
#undef MOST_BLOCKS
#undef BLOCKS
#define WHOLE (WIDTH > 2 ? WIDTH : 2)
#define MOST_BLOCKS (MOST_STATES / WIDTH)
#define BLOCKS(n) (((n) + WHOLE - 1) / WHOLE * (WHOLE / WIDTH))
#ifndef AT
#define AT(rows, i) (((double *)(rows))[i])
#endif

/* One side of every row: slack s = sign (value - bound), multiplier l, s l -> 0. Without a bound `there` = l = 0. */
typedef struct {
    double sign;
    unsigned char *there;
    double *bound, *s, *l, *residual, *ds, *dl, *target;
} tm_side;

typedef struct {
    const tm_problem *q;
    int blocks, ld, paired;
    lanes *A, *At, *C, *G, *Z;             /* rows padded with zeros */
    lanes own[MOST_BLOCKS], from_pair[MOST_BLOCKS], to_pair[MOST_BLOCKS], push[MOST_MOTORS * MOST_BLOCKS];
    lanes *K;                              /* (N, m, n) gains */
    double *L;                             /* (N, m, m) inverse of Quu */
    double *offset, *u, *du, *gradient;    /* (N, m) */
    double *error;                         /* (N, outputs) */
    double *end_error;
    double *V, *dV, *sigma, *y;            /* (N, rows) */
    tm_side side[2];
    int from[MOST_ROWS], to[MOST_ROWS];    /* range of states with the nonzeros of a row of G */
    size_t limits;                         /* number of finite bounds */
    double *best;                          /* (N m + 2 N rows) commands and multipliers of the best iterate */
    int weighed;                           /* stage whose weights CWC was computed with */
    lanes *CWC, *EWC;                      /* (n, n), (m, n) */
    double EWE[MOST_MOTORS * MOST_MOTORS];
} tm_work;

static void *take(double *space, size_t *taken, size_t count)
{
    void *found = space ? space + *taken : NULL;
    *taken += (count + WIDTH - 1) / WIDTH * WIDTH;
    return found;
}

static size_t lay_out(tm_work *w, const tm_problem *q, double *space)
{
    const size_t N = (size_t)q->stages, m = (size_t)q->motors, R = (size_t)q->rows, ny = (size_t)q->outputs;
    const size_t ld = (size_t)(BLOCKS(q->states) * WIDTH);
    size_t taken = 0;
    w->q = q, w->ld = (int)ld, w->blocks = (int)(ld / WIDTH);
    w->A = take(space, &taken, ld * ld), w->At = take(space, &taken, ld * ld);
    w->C = take(space, &taken, ny * ld), w->G = take(space, &taken, R * ld), w->Z = take(space, &taken, (size_t)q->ends * ld);
    w->CWC = take(space, &taken, ld * ld), w->EWC = take(space, &taken, m * ld);
    w->K = take(space, &taken, N * m * ld), w->L = take(space, &taken, N * m * m);
    w->offset = take(space, &taken, N * m), w->u = take(space, &taken, N * m), w->du = take(space, &taken, N * m);
    w->gradient = take(space, &taken, N * m);
    w->error = take(space, &taken, N * ny), w->end_error = take(space, &taken, (size_t)q->ends);
    w->V = take(space, &taken, N * R), w->dV = take(space, &taken, N * R);
    w->sigma = take(space, &taken, N * R), w->y = take(space, &taken, N * R);
    for (tm_side *z = w->side; z < w->side + 2; z++) {
        z->bound = take(space, &taken, N * R), z->s = take(space, &taken, N * R), z->l = take(space, &taken, N * R);
        z->residual = take(space, &taken, N * R), z->ds = take(space, &taken, N * R), z->dl = take(space, &taken, N * R);
        z->target = take(space, &taken, N * R), z->there = take(space, &taken, N * R);
    }
    w->best = take(space, &taken, N * m + 2 * N * R);
    return taken;
}

static size_t workspace(const tm_problem *q)
{
    tm_work w;
    return lay_out(&w, q, NULL) + WIDTH;
}

/* Find out whether A couples states in pairs only, and store the coefficients; `push` are the commands' columns. */
static void pair_up(tm_work *w)
{
    const int n = w->q->states, first = n - w->q->motors;
    const double *A = w->q->A;
    w->paired = 1;
    for (int i = 0; i < n; i++)
        for (int j = 0; j < first; j++)
            if (j != i && (j != (i ^ 1) || i >= first) && A[i * n + j] != 0.0) w->paired = 0;
    for (int i = 0; i < n; i++) {
        const int other = i ^ 1;
        if (i < first) AT(w->own, i) = A[i * n + i];
        if (i < first && other < first) AT(w->from_pair, i) = A[i * n + other], AT(w->to_pair, i) = A[other * n + i];
        for (int c = 0; c < w->q->motors; c++) AT(w->push + c * w->blocks, i) = A[i * n + first + c];
    }
}

static void prepare(tm_work *w, const tm_problem *q, double *space)
{
    const size_t n = (size_t)q->states, in_one = n * sizeof(double);
    while ((uintptr_t)space % (WIDTH * sizeof(double))) space++;
    memset(w, 0, sizeof *w);
    memset(space, 0, lay_out(w, q, space) * sizeof(double));
    const size_t ld = (size_t)w->ld;
    for (size_t i = 0; i < n; i++)
        for (size_t j = 0; j < n; j++) AT(w->A, i * ld + j) = AT(w->At, j * ld + i) = q->A[i * n + j];
    for (size_t s = 0; s < (size_t)q->outputs; s++) memcpy(&AT(w->C, s * ld), q->C + s * n, in_one);
    for (size_t j = 0; j < (size_t)q->rows; j++) memcpy(&AT(w->G, j * ld), q->G + j * n, in_one);
    for (size_t j = 0; j < (size_t)q->ends; j++) memcpy(&AT(w->Z, j * ld), q->end_gain + j * n, in_one);
    for (int j = 0; j < q->rows; j++) {
        const double *c = q->G + (size_t)j * n;
        w->from[j] = 0, w->to[j] = q->states;
        while (w->to[j] > 0 && c[w->to[j] - 1] == 0.0) w->to[j]--;
        while (w->from[j] < w->to[j] && c[w->from[j]] == 0.0) w->from[j]++;
    }
    for (int side = 0; side < 2; side++) {
        tm_side *z = w->side + side;
        const double *limit = side ? q->upper : q->lower;
        z->sign = side ? -1.0 : 1.0;
        for (size_t i = 0; i < (size_t)q->stages * (size_t)q->rows; i++) {
            z->there[i] = limit[i] > -INFINITY && limit[i] < INFINITY;
            z->bound[i] = z->there[i] ? limit[i] : 0.0, z->s[i] = 1.0;
            w->limits += z->there[i];
        }
    }
    pair_up(w);
    for (int k = q->free_stages; k < q->stages; k++) /* the hand-over takes the held commands to zero */
        for (int c = 0; c < q->motors; c++) AT(w->K + (k * q->motors + c) * w->blocks, q->states - q->motors + c) = -1.0;
    w->weighed = -1;
}

ALWAYS_INLINE double dot(const int blocks, const lanes *restrict a, const lanes *restrict b)
{
    lanes sum = a[0] * b[0];
    for (int j = 1; j < blocks; j++) sum += a[j] * b[j];
    double part[WIDTH];
    for (int j = 0; j < WIDTH; j++) part[j] = AT(&sum, j);
    for (int half = WIDTH / 2; half > 0; half /= 2)
        for (int j = 0; j < half; j++) part[j] += part[j + half];
    return part[0];
}

ALWAYS_INLINE void add(const int blocks, const double by, const lanes *restrict c, lanes *restrict to)
{
    for (int j = 0; j < blocks; j++) to[j] += by * c[j];
}

/* out = M' v. */
ALWAYS_INLINE void combine(const int blocks, const lanes *restrict M, const double *restrict v, lanes *restrict out)
{
    for (int j = 0; j < blocks; j++) {
        lanes even = v[0] * M[j], odd = v[1] * M[blocks + j];
        for (int l = 2; l < blocks * WIDTH; l += 2) even += v[l] * M[l * blocks + j], odd += v[l + 1] * M[(l + 1) * blocks + j];
        out[j] = even + odd;
    }
}

/* out = A x + B u. */
ALWAYS_INLINE void flow(const int blocks, const int m, const tm_work *w, const lanes *restrict x, const double *u,
                        lanes *restrict out)
{
    const int first = w->q->states - m;
    if (w->paired) {
        for (int j = 0; j < blocks; j++) out[j] = w->own[j] * x[j] + w->from_pair[j] * SWAPPED(x, j);
        for (int c = 0; c < m; c++) add(blocks, AT(x, first + c) + u[c], w->push + c * blocks, out);
    } else {
        combine(blocks, w->At, (const double *)x, out);
        for (int c = 0; c < m; c++) add(blocks, u[c], w->push + c * blocks, out);
    }
}

/* out = A' p; its last m entries are B' p. */
ALWAYS_INLINE void flow_back(const int blocks, const int m, const tm_work *w, const lanes *restrict p, lanes *restrict out)
{
    if (w->paired) {
        for (int j = 0; j < blocks; j++) out[j] = w->own[j] * p[j] + w->to_pair[j] * SWAPPED(p, j);
        for (int c = 0; c < m; c++) AT(out, w->q->states - m + c) = dot(blocks, w->push + c * blocks, p);
    } else
        combine(blocks, w->A, (const double *)p, out);
}

/* H = A' P A of a symmetric P; PA is scratch. */
ALWAYS_INLINE void congruence(const int blocks, const int m, const tm_work *w, const lanes *restrict P,
                              lanes *restrict PA, lanes *restrict H)
{
    const int n = w->q->states, first = n - m, ld = blocks * WIDTH;
    if (!w->paired) {
        for (int i = 0; i < n; i++) combine(blocks, w->A, (const double *)(P + i * blocks), PA + i * blocks);
        for (int i = 0; i < n; i++) combine(blocks, PA, (const double *)(w->At + i * blocks), H + i * blocks);
        return;
    }
    lanes pushed[MOST_MOTORS * MOST_BLOCKS];
    memset(pushed, 0, (size_t)(m * ld) * sizeof(double));
    for (int i = 0; i < first; i += 2) { /* a pair of states, or the last one alone */
        const int other = i + 1 < first ? i + 1 : i;
        const double own[2] = {AT(w->own, i), AT(w->own, other)}, pair[2] = {AT(w->to_pair, i), AT(w->to_pair, other)};
        const lanes *p = P + i * blocks, *r = P + other * blocks;
        lanes *h = H + i * blocks, *g = H + other * blocks;
        for (int j = 0; j < blocks; j++) {
            const lanes upper = w->own[j] * p[j] + w->to_pair[j] * SWAPPED(p, j);
            const lanes lower = w->own[j] * r[j] + w->to_pair[j] * SWAPPED(r, j);
            g[j] = own[1] * lower + pair[1] * upper;
            h[j] = own[0] * upper + pair[0] * lower;
        }
        for (int c = 0; c < m; c++) {
            const lanes *push = w->push + c * blocks;
            for (int j = 0; j < blocks; j++) {
                pushed[c * blocks + j] += AT(push, i) * p[j];
                if (other > i) pushed[c * blocks + j] += AT(push, other) * r[j];
            }
        }
    }
    for (int i = first; i < n; i++)
        for (int c = 0; c < m; c++) add(blocks, AT(w->push + c * blocks, i), P + i * blocks, pushed + c * blocks);
    for (int c = 0; c < m; c++) flow_back(blocks, m, w, pushed + c * blocks, H + (first + c) * blocks);
    for (int i = 0; i < first; i++)
        for (int c = 0; c < m; c++) AT(H + i * blocks, first + c) = AT(H + (first + c) * blocks, i);
}

/* C' W C, E' W C and E' W E of a stage; reused from the previous stage if the weights are equal. */
static void weigh(tm_work *w, const int k)
{
    const tm_problem *q = w->q;
    const int ny = q->outputs, m = q->motors, blocks = w->blocks;
    if (w->weighed >= 0 && !memcmp(q->weight + w->weighed * ny, q->weight + k * ny, (size_t)ny * sizeof(double))) return;
    w->weighed = k;
    memset(w->CWC, 0, (size_t)(w->ld * w->ld) * sizeof(double));
    memset(w->EWC, 0, (size_t)(m * w->ld) * sizeof(double));
    memset(w->EWE, 0, sizeof w->EWE);
    for (int o = 0; o < ny; o++) {
        const double weight = q->weight[k * ny + o];
        for (int i = 0; i < q->states; i++) add(blocks, weight * AT(w->C + o * blocks, i), w->C + o * blocks, w->CWC + i * blocks);
        for (int c = 0; c < m; c++) {
            add(blocks, weight * q->E[o * m + c], w->C + o * blocks, w->EWC + c * blocks);
            for (int b = 0; b < m; b++) w->EWE[c * m + b] += weight * q->E[o * m + c] * q->E[o * m + b];
        }
    }
}

/* The gains of all stages from the weights `sigma` of the rows; 0 where a pivot is not positive. */
ALWAYS_INLINE int factor_sized(const int blocks, const int m, tm_work *w)
{
    const tm_problem *q = w->q;
    const int n = q->states, first = n - m, R = q->rows, ld = blocks * WIDTH;
    lanes P[MOST_STATES * MOST_BLOCKS], H[MOST_STATES * MOST_BLOCKS], PA[MOST_STATES * MOST_BLOCKS];
    memset(P, 0, (size_t)(ld * ld) * sizeof(double)), memset(H, 0, (size_t)(ld * ld) * sizeof(double));
    memset(PA, 0, (size_t)(ld * ld) * sizeof(double));
    for (int e = 0; e < q->ends; e++)
        for (int i = 0; i < n; i++) add(blocks, AT(w->Z + e * blocks, i), w->Z + e * blocks, P + i * blocks);
    for (int k = q->stages - 1; k >= 0; k--) {
        lanes Qux[MOST_MOTORS * MOST_BLOCKS];
        double Quu[MOST_MOTORS * MOST_MOTORS];
        lanes *K = w->K + k * m * blocks;
        congruence(blocks, m, w, P, PA, H);
        weigh(w, k);
        for (int c = 0; c < m; c++) {
            for (int j = 0; j < blocks; j++) Qux[c * blocks + j] = H[(first + c) * blocks + j] + w->EWC[c * blocks + j];
            for (int b = 0; b < m; b++) Quu[c * m + b] = AT(H + (first + c) * blocks, first + b) + w->EWE[c * m + b];
            Quu[c * m + c] += q->movement_weight;
        }
        for (int i = 0; i < n * blocks; i++) H[i] += w->CWC[i];
        for (int j = 0; j < R; j++) {
            const double sigma = w->sigma[k * R + j];
            if (sigma == 0.0) continue;
            const lanes *g = w->G + j * blocks;
            const int c = q->motor[j], b0 = w->from[j] / WIDTH, b1 = (w->to[j] + WIDTH - 1) / WIDTH;
            for (int i = w->from[j]; i < w->to[j]; i++) {
                const double by = sigma * AT(g, i);
                if (by != 0.0)
                    for (int b = b0; b < b1; b++) H[i * blocks + b] += by * g[b];
            }
            if (q->d[j] != 0.0) {
                for (int b = b0; b < b1; b++) Qux[c * blocks + b] += (sigma * q->d[j]) * g[b];
                Quu[c * m + c] += sigma * q->d[j] * q->d[j];
            }
        }
        if (k >= q->free_stages) { /* u = -held: H + Qux' K + K' Qux + K' Quu K, K = -I on the commands */
            for (int c = 0; c < m; c++) {
                for (int j = 0; j < blocks; j++) H[(first + c) * blocks + j] -= Qux[c * blocks + j];
                for (int i = 0; i < n; i++) AT(H + i * blocks, first + c) -= AT(Qux + c * blocks, i);
            }
            for (int c = 0; c < m; c++)
                for (int b = 0; b < m; b++) AT(H + (first + c) * blocks, first + b) += Quu[c * m + b];
            memcpy(P, H, (size_t)(n * ld) * sizeof(double));
        } else {
            double *X = w->L + k * m * m, T[MOST_MOTORS * MOST_MOTORS];
            /* T T' = Quu, X = inverse(T), then the inverse of Quu is X' X. */
            double Y[MOST_MOTORS * MOST_MOTORS] = {0};
            for (int c = 0; c < m; c++) {
                for (int b = 0; b <= c; b++) {
                    double sum = Quu[c * m + b];
                    for (int l = 0; l < b; l++) sum -= T[c * m + l] * T[b * m + l];
                    if (b < c) T[c * m + b] = sum / T[b * m + b];
                    else if (sum > 0.0 && sum < INFINITY) T[c * m + c] = sqrt(sum);
                    else return 0;
                }
                Y[c * m + c] = 1.0 / T[c * m + c];
                for (int b = 0; b < c; b++) {
                    double sum = 0.0;
                    for (int l = b; l < c; l++) sum -= T[c * m + l] * Y[l * m + b];
                    Y[c * m + b] = sum / T[c * m + c];
                }
            }
            for (int c = 0; c < m; c++)
                for (int b = 0; b < m; b++) {
                    X[c * m + b] = 0.0;
                    for (int l = c > b ? c : b; l < m; l++) X[c * m + b] += Y[l * m + c] * Y[l * m + b];
                }
            lanes half[MOST_MOTORS * MOST_BLOCKS]; /* Y Qux: P = H - half' half, symmetric by itself */
            for (int c = 0; c < m; c++)
                for (int j = 0; j < blocks; j++) {
                    lanes sum = Y[c * m] * Qux[j];
                    for (int b = 1; b <= c; b++) sum += Y[c * m + b] * Qux[b * blocks + j];
                    half[c * blocks + j] = sum;
                }
            for (int c = 0; c < m; c++)
                for (int j = 0; j < blocks; j++) {
                    lanes sum = Y[c * m + c] * half[c * blocks + j];
                    for (int l = c + 1; l < m; l++) sum += Y[l * m + c] * half[l * blocks + j];
                    K[c * blocks + j] = -sum;
                }
            for (int i = 0; i < n; i++) {
                double by[MOST_MOTORS];
                for (int c = 0; c < m; c++) by[c] = AT(half + c * blocks, i);
                for (int j = 0; j < blocks; j++) {
                    lanes sum = H[i * blocks + j];
                    for (int c = 0; c < m; c++) sum -= by[c] * half[c * blocks + j];
                    P[i * blocks + j] = sum;
                }
            }
        }
        if (k % SYMMETRISED == 0)
            for (int i = 0; i < n; i++)
                for (int j = 0; j < i; j++)
                    AT(P, i * ld + j) = AT(P, j * ld + i) = 0.5 * (AT(P, i * ld + j) + AT(P, j * ld + i));
    }
    return 1;
}

/* Costates from the gradients `y` of the rows. With `newton` the steps without feedback into `offset`; else the
 * gradient of the Lagrangian by the movements into `gradient`. */
ALWAYS_INLINE void backward_sized(const int blocks, const int m, tm_work *w, const double *restrict y, const int newton)
{
    const tm_problem *q = w->q;
    const int n = q->states, first = n - m, R = q->rows, ny = q->outputs;
    lanes p[MOST_BLOCKS], a[MOST_BLOCKS], drive[MOST_BLOCKS];
    memset(p, 0, sizeof p);
    for (int e = 0; e < q->ends; e++) add(blocks, w->end_error[e], w->Z + e * blocks, p);
    for (int k = q->stages - 1; k >= 0; k--) {
        double by[MOST_MOTORS];
        memset(drive, 0, (size_t)(blocks * WIDTH) * sizeof(double));
        for (int c = 0; c < m; c++) by[c] = q->movement_weight * w->u[k * m + c];
        for (int o = 0; o < ny; o++) {
            const double v = q->weight[k * ny + o] * w->error[k * ny + o];
            add(blocks, v, w->C + o * blocks, drive);
            for (int c = 0; c < m; c++) by[c] += q->E[o * m + c] * v;
        }
        for (int j = 0; j < R; j++) {
            const double v = y[k * R + j];
            for (int i = w->from[j]; i < w->to[j]; i++) AT(drive, i) += v * AT(w->G + j * blocks, i);
            by[q->motor[j]] += q->d[j] * v;
        }
        flow_back(blocks, m, w, p, a);
        for (int c = 0; c < m; c++) by[c] += AT(a, first + c);
        for (int j = 0; j < blocks; j++) p[j] = a[j] + drive[j];
        if (newton || k >= q->free_stages)
            for (int c = 0; c < m; c++) add(blocks, by[c], w->K + (k * m + c) * blocks, p);
        if (!newton) memcpy(w->gradient + k * m, by, (size_t)m * sizeof(double));
        else
            for (int c = 0; c < m; c++) {
                double sum = 0.0;
                if (k < q->free_stages)
                    for (int b = 0; b < m; b++) sum -= w->L[(k * m + c) * m + b] * by[b];
                w->offset[k * m + c] = sum;
            }
    }
}

/* With `newton` the step du = K dx + offset and the change of the rows; otherwise roll out u, with the hand-over as
 * feedback, and compute states, errors and rows. */
ALWAYS_INLINE void forward_sized(const int blocks, const int m, tm_work *w, const int newton)
{
    const tm_problem *q = w->q;
    const int n = q->states, first = n - m, R = q->rows, ny = q->outputs;
    lanes at[2][MOST_BLOCKS];
    double *V = newton ? w->dV : w->V, *u = newton ? w->du : w->u;
    memset(at, 0, sizeof at);
    for (int k = 0; k < q->stages; k++) {
        const lanes *x = at[k & 1];
        double *move = u + k * m;
        if (newton)
            for (int c = 0; c < m; c++) move[c] = w->offset[k * m + c] + dot(blocks, w->K + (k * m + c) * blocks, x);
        else if (k >= q->free_stages)
            for (int c = 0; c < m; c++) move[c] = -AT(x, first + c);
        for (int j = 0; j < R; j++) {
            double sum = q->d[j] * move[q->motor[j]];
            for (int i = w->from[j]; i < w->to[j]; i++) sum += AT(w->G + j * blocks, i) * AT(x, i);
            V[k * R + j] = sum;
        }
        if (!newton)
            for (int o = 0; o < ny; o++) {
                double sum = dot(blocks, w->C + o * blocks, x) - q->reference[k * ny + o];
                for (int c = 0; c < m; c++) sum += q->E[o * m + c] * move[c];
                w->error[k * ny + o] = sum;
            }
        flow(blocks, m, w, x, move, at[(k + 1) & 1]);
    }
    if (!newton)
        for (int e = 0; e < q->ends; e++) w->end_error[e] = dot(blocks, w->Z + e * blocks, at[q->stages & 1]) - q->end_target[e];
}

/* The three recursions for sizes that the compiler knows: an arm with three motors, 25 to 32 states. */
#undef USUAL
#define USUAL (WIDTH == 8 ? 4 : WIDTH == 4 ? 8 : 16)

static int factor(tm_work *w)
{
    return w->blocks == USUAL && w->q->motors == 3 ? factor_sized(USUAL, 3, w) : factor_sized(w->blocks, w->q->motors, w);
}

static void backward(tm_work *w, const double *y, const int newton)
{
    const int usual = w->blocks == USUAL && w->q->motors == 3;
    if (usual && newton) backward_sized(USUAL, 3, w, y, 1);
    else if (usual) backward_sized(USUAL, 3, w, y, 0);
    else backward_sized(w->blocks, w->q->motors, w, y, newton);
}

static void forward(tm_work *w, const int newton)
{
    const int usual = w->blocks == USUAL && w->q->motors == 3;
    if (usual && newton) forward_sized(USUAL, 3, w, 1);
    else if (usual) forward_sized(USUAL, 3, w, 0);
    else forward_sized(w->blocks, w->q->motors, w, newton);
}

static tm_state judge(tm_work *w)
{
    const tm_problem *q = w->q;
    const int m = q->motors, ny = q->outputs;
    const size_t all = (size_t)q->stages * (size_t)q->rows;
    tm_state state = {q->constant, 0.0, 0.0, 0.0};
    for (int k = 0; k < q->stages; k++) {
        for (int o = 0; o < ny; o++) state.objective += 0.5 * q->weight[k * ny + o] * w->error[k * ny + o] * w->error[k * ny + o];
        for (int c = 0; c < m; c++) state.objective += 0.5 * q->movement_weight * w->u[k * m + c] * w->u[k * m + c];
    }
    for (int e = 0; e < q->ends; e++) state.objective += 0.5 * w->end_error[e] * w->end_error[e];
    for (tm_side *z = w->side; z < w->side + 2; z++)
        for (size_t i = 0; i < all; i++) {
            if (!z->there[i]) continue;
            z->residual[i] = z->sign * (w->V[i] - z->bound[i]) - z->s[i];
            state.complementarity += z->s[i] * z->l[i];
            if (!(fabs(z->residual[i]) <= state.residual)) state.residual = fabs(z->residual[i]);
        }
    for (size_t i = 0; i < all; i++) w->y[i] = w->side[1].l[i] - w->side[0].l[i];
    backward(w, w->y, 0);
    double held[MOST_MOTORS] = {0};
    for (int k = 0; k < q->free_stages; k++)
        for (int c = 0; c < m; c++) {
            const double next = k + 1 < q->free_stages ? w->gradient[(k + 1) * m + c] : 0.0;
            held[c] += w->u[k * m + c];
            state.stationarity += fabs(w->gradient[k * m + c] - next) * (q->command_bound + fabs(held[c]));
        }
    return state;
}

static void begin(tm_work *w)
{
    const size_t all = (size_t)w->q->stages * (size_t)w->q->rows;
    forward(w, 0);
    const tm_state rest = judge(w);
    const double first = FIRST_GAP * (rest.objective > 1.0 ? rest.objective : 1.0) / (double)(w->limits ? w->limits : 1);
    for (tm_side *z = w->side; z < w->side + 2; z++)
        for (size_t i = 0; i < all; i++) {
            if (!z->there[i]) continue;
            const double s = z->sign * (w->V[i] - z->bound[i]);
            z->s[i] = s > 0.1 ? s : 0.1;
            z->l[i] = first / z->s[i];
        }
}

/* The Newton step towards s l = target. */
static void directions(tm_work *w)
{
    const size_t all = (size_t)w->q->stages * (size_t)w->q->rows;
    memset(w->y, 0, all * sizeof(double));
    for (tm_side *z = w->side; z < w->side + 2; z++)
        for (size_t i = 0; i < all; i++)
            if (z->there[i]) w->y[i] -= z->sign * (z->target[i] - z->l[i] * z->residual[i]) / z->s[i];
    backward(w, w->y, 1);
    forward(w, 1);
    for (tm_side *z = w->side; z < w->side + 2; z++)
        for (size_t i = 0; i < all; i++) {
            if (!z->there[i]) continue;
            z->ds[i] = z->sign * w->dV[i] + z->residual[i];
            z->dl[i] = (z->target[i] - z->l[i] * z->ds[i]) / z->s[i] - z->l[i];
        }
}

/* The longest step that leaves slacks and multipliers positive, at most 1. */
static double longest(const tm_work *w)
{
    const size_t all = (size_t)w->q->stages * (size_t)w->q->rows;
    double most = 1.0;
    for (const tm_side *z = w->side; z < w->side + 2; z++)
        for (size_t i = 0; i < all; i++) {
            if (!z->there[i]) continue;
            if (z->s[i] + most * z->ds[i] < 0.0) most = -z->s[i] / z->ds[i];
            if (z->l[i] + most * z->dl[i] < 0.0) most = -z->l[i] / z->dl[i];
        }
    return most;
}

/* Mehrotra's corrector: the targets, from the step length of the predictor. */
static void centre(tm_work *w, const double step, const double complementarity, const double allowed)
{
    const size_t all = (size_t)w->q->stages * (size_t)w->q->rows;
    double after = 0.0;
    for (const tm_side *z = w->side; z < w->side + 2; z++)
        for (size_t i = 0; i < all; i++)
            if (z->there[i]) after += (z->s[i] + step * z->ds[i]) * (z->l[i] + step * z->dl[i]);
    const double share = complementarity > 0.0 ? after / complementarity : 0.0, least = LAST_GAP * allowed;
    double aimed = share * share * share * complementarity;
    if (aimed < least) aimed = least < complementarity ? least : complementarity;
    for (tm_side *z = w->side; z < w->side + 2; z++)
        for (size_t i = 0; i < all; i++)
            if (z->there[i]) z->target[i] = aimed / (double)w->limits - z->ds[i] * z->dl[i];
}

/* Store the iterate; with `back` restore the stored one. */
static void keep(tm_work *w, const int back)
{
    const size_t moves = (size_t)w->q->stages * (size_t)w->q->motors, all = (size_t)w->q->stages * (size_t)w->q->rows;
    double *part[3] = {w->u, w->side[0].l, w->side[1].l}, *best = w->best;
    const size_t size[3] = {moves, all, all};
    for (int i = 0; i < 3; best += size[i], i++)
        memcpy(back ? part[i] : best, back ? best : part[i], size[i] * sizeof(double));
}

static int solve(const tm_problem *q, const int max_iterations, const double tolerance, double *space, tm_result *r)
{
    tm_work work, *w = &work;
    const size_t all = (size_t)q->stages * (size_t)q->rows, moves = (size_t)q->stages * (size_t)q->motors;
    double least = INFINITY;
    int code = TM_ITERATION_LIMIT, since = 0, steps = 0;
    prepare(w, q, space);
    begin(w);
    for (;; steps++) {
        const tm_state now = judge(w);
        const double scale = now.objective > 1.0 ? now.objective : 1.0, gap = now.complementarity + now.stationarity;
        const double off = fmax(gap / scale, now.residual) / tolerance;
        r->objective = now.objective, r->gap = gap, r->residual = now.residual;
        if (off < least) least = off, since = 0, keep(w, 0);
        else {
            /* If everything but the gradient is within the tolerance, the remaining gradient is rounding. */
            const int patience = now.complementarity <= tolerance * scale && now.residual <= tolerance ? 2 : PATIENCE;
            if (!(off >= 0.0) || (++since >= patience && least <= NEAR) || since > 3 * PATIENCE) { code = TM_STALLED; break; }
        }
        if (off <= 1.0) { code = TM_SOLVED; break; }
        if (steps >= max_iterations) break;
        memset(w->sigma, 0, all * sizeof(double));
        for (tm_side *z = w->side; z < w->side + 2; z++)
            for (size_t i = 0; i < all; i++)
                if (z->there[i]) w->sigma[i] += z->l[i] / z->s[i], z->target[i] = 0.0;
        w->weighed = -1;
        if (!factor(w)) { code = TM_BREAKDOWN; break; }
        directions(w);
        if (w->limits) {
            centre(w, longest(w), now.complementarity, tolerance * scale);
            directions(w);
        }
        const double farthest = longest(w), left = fmin(FARTHEST, fmax(now.complementarity / scale, 1e-9));
        const double step = farthest < 1.0 ? farthest * (1.0 - left) : 1.0;
        if (!(step > SHORTEST)) { code = TM_STALLED; break; }
        for (size_t i = 0; i < moves; i++) w->u[i] += step * w->du[i];
        for (tm_side *z = w->side; z < w->side + 2; z++)
            for (size_t i = 0; i < all; i++)
                if (z->there[i]) {
                    z->s[i] = fmax(z->s[i] + step * z->ds[i], LEAST);
                    z->l[i] = fmax(z->l[i] + step * z->dl[i], LEAST);
                }
        forward(w, 0);
    }
    if (code != TM_SOLVED && least <= NEAR) {
        keep(w, 1);
        forward(w, 0);
        const tm_state best = judge(w);
        r->objective = best.objective, r->gap = best.complementarity + best.stationarity;
        code = TM_ACCURACY;
    }
    double held[MOST_MOTORS] = {0};
    for (size_t i = 0; i < moves; i++) r->command[i] = held[i % (size_t)q->motors] += w->u[i];
    memcpy(r->gradient, w->gradient, moves * sizeof(double));
    memcpy(r->lower, w->side[0].l, all * sizeof(double)), memcpy(r->upper, w->side[1].l, all * sizeof(double));
    r->iterations = steps;
    return code;
}
#endif
