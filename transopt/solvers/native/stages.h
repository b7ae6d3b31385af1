/* A primal-dual interior-point method over the stages of one transient.
 *
 *     minimise    1/2 sum_k w_k |C x_k + E u_k - r_k|^2 + 1/2 s |u_k|^2 + 1/2 |Z x_N - z|^2 + constant
 *     subject to  x_(k+1) = A x_k + B u_k,  x_0 = 0,  B the last m columns of A,
 *                 th_(k+1) = M th_k + b (gain_k + copper th_w,k) h_k,  th_0 = 0 or th_0 = F th_N + f,
 *                 h_k = quadratic in (current, command) + 2 ripple e_k + ripple^2,
 *                 u_k = f_k' x_k + g_k over the last stages (the hand-over),
 *                 lower_k <= G x_k + d u_k + d_size e_k <= upper_k,  the winding th_w,k being the first row,
 *
 * k = 0..N-1 but for the rows and the temperatures, which are bounded at N as well, where u_N = e_N = 0.
 *
 * The movements u of m motors and, with a temperature, which only a single motor has, the size e of its mean current are
 * the controls; the last m states are the commands held before. Predictor and corrector follow Mehrotra (SIAM J. Optim.
 * 2, 1992); each Newton step is a Riccati recursion (Rao, Wright, Rawlings, J. Optim. Theory Appl. 99, 1998), in which
 * the controls are eliminated one by one: the size first, then the movements from the last motor to the first. The gain of
 * a control is therefore one by the states and by the controls that are eliminated after it. Where the states form pairs
 * that only the held commands couple to others, as the modes of a device do, products with A are computed pair by pair.
 * Every iterate obeys the dynamics exactly: states are rolled out, and the reduced gradient comes from the adjoint
 * recursion. Rounding in a factorisation therefore affects the quality of a step, but not the accuracy of the answer.
 *
 * Problems of equal sizes are solved side by side: each register then holds the same number of several problems, and an
 * answer does not depend, to the last bit, on the problems beside it. A problem alone has its rows of states in
 * registers instead, as have problems whose states do not form pairs.
 *
 * C99 without dependencies, no global state, no allocation: the caller gives the workspace. Compile with contraction of
 * floating-point expressions off. All arrays are row by row. The method polls the caller for signals (`tr_host`).
 */
#include <math.h>
#include <stdint.h>
#include <string.h>

#include "riccati.h"

#if HAS_WIDTH(WIDTH)
#if !defined(ONLY_WIDTH) && WIDTH == 8
#pragma GCC target("avx512f,avx512dq,avx512vl,prefer-vector-width=512")
#elif !defined(ONLY_WIDTH) && WIDTH == 4
#pragma GCC target("avx2")
#endif

/* Constants of the method. */
static const double NEAR = 1e3;       /* times the tolerance: once below it, the best iterate is kept */
static const double SHORTEST = 1e-12; /* shortest useful step length, as a share of the Newton step */
static const double FARTHEST = 5e-3;  /* share of slacks and multipliers that a step leaves */
static const double NEAREST = 1e-9, NEARNESS = 0.1;
static const double FIRST_GAP = 3.0;  /* gap of the first iterate, in units of its objective */
static const double LAST_GAP = 0.03;  /* that is aimed at, of what is allowed: less only costs digits elsewhere */
static const double UNSEEN = 1e-7;    /* gap that may be left by a search before the cut; a tenth of a certificate's */
static const double NO_PIVOT = 1e-14; /* of a Cholesky factor, as a share of the largest diagonal entry */
static const double LEAST = 1e-290;   /* negligible positive number that avoids a division by zero */
enum {
    PATIENCE = 6,    /* iterations without a better iterate near the optimum */
    LOST = 25,       /* and elsewhere: a search that converges improves within 16, one without a feasible command diverges */
    STRIDE = 256,    /* stages of a factorisation after which the host may be asked */
    SYMMETRISED = 4, /* stages after which the cost to go is made symmetric again */
    REFINEMENTS = 4  /* of a linear pass, each one more step with the same gains */
};

/* Solve the closure's equations in place, by elimination with row pivoting; they are at most four. */
static void eliminate(int count, const double *matrix, double *right)
{
    double A[4 * MOST_NODES * MOST_NODES];
    memcpy(A, matrix, (size_t)(count * count) * sizeof(double));
    for (int c = 0; c < count; c++) {
        int best = c;
        for (int i = c + 1; i < count; i++)
            if (fabs(A[i * count + c]) > fabs(A[best * count + c])) best = i;
        for (int j = 0; j < count; j++) {
            const double swap = A[c * count + j];
            A[c * count + j] = A[best * count + j], A[best * count + j] = swap;
        }
        const double swap = right[c];
        right[c] = right[best], right[best] = swap;
        for (int i = c + 1; i < count; i++) {
            const double by = A[i * count + c] / A[c * count + c];
            for (int j = c; j < count; j++) A[i * count + j] -= by * A[c * count + j];
            right[i] -= by * right[c];
        }
    }
    for (int i = count - 1; i >= 0; i--) {
        for (int j = i + 1; j < count; j++) right[i] -= A[i * count + j] * right[j];
        right[i] /= A[i * count + i];
    }
}

#if defined(__GNUC__)
#define ALWAYS_INLINE static inline __attribute__((always_inline))
#define NEVER_INLINE static __attribute__((noinline))
#else
#define ALWAYS_INLINE static inline
#define NEVER_INLINE static
#endif
#define AT(rows, i) (((number *)(rows))[i])        /* one number of a row */
#define EACH(what, e) (((double *)&(what))[e])     /* a number's double of entry e */
#define PER (WIDTH / ENTRIES)                      /* numbers in a register */
/* Temperatures are solved for one problem at a time. */
#define NODES(q) (ENTRIES > 1 ? 0 : (q)->nodes)
#define REPEATED(q) (ENTRIES > 1 ? 0 : (q)->repeated)
#define MOST_BLOCKS (ENTRIES > 1 ? MOST_STATES_BESIDE : MOST_STATES / WIDTH)
#define WHOLE (ENTRIES > 1 ? 2 : WIDTH > 4 ? WIDTH : 4) /* a row of states has whole pairs or fours, and registers */

/* A register of doubles: neighbouring rows or states of one problem, or the same number of several problems. Every
 * array of the workspace is aligned to a whole register. */
#if WIDTH > 1
typedef double lanes __attribute__((vector_size(8 * WIDTH), may_alias));
typedef long long choice __attribute__((vector_size(8 * WIDTH), may_alias));
#else
typedef double lanes;
#endif

/* One number of every problem that is solved. */
#if ENTRIES > 1
typedef lanes number;
#else
typedef double number;
#endif

/* One of two values, chosen number by number and, of registers, lane by lane. */
#if WIDTH > 1
#define CHOSEN_LANES(test, one, other) \
    ((lanes)(((choice)(test) & (choice)(one)) | (~(choice)(test) & (choice)(other))))
#else
#define CHOSEN_LANES(test, one, other) ((test) ? (one) : (other))
#endif
#if ENTRIES > 1
#define CHOSEN CHOSEN_LANES
#else
#define CHOSEN(test, one, other) ((test) ? (one) : (other))
#endif

/* The larger, lane by lane; NaN in `than` is ignored. */
ALWAYS_INLINE void raise_to(lanes *most, const lanes than)
{
    *most = CHOSEN_LANES(than > *most, than, *most);
}

/* Block j of v with neighbours 2 i and 2 i + 1 in each other's place. */
#if PER == 8
#define PAIRS 1, 0, 3, 2, 5, 4, 7, 6
#elif PER == 4
#define PAIRS 1, 0, 3, 2
#elif PER == 2
#define PAIRS 1, 0
#endif
#if PER == 1
#define SWAPPED(v, j) (v)[(j) ^ 1]
#elif defined(__clang__)
#define SWAPPED(v, j) __builtin_shufflevector((v)[j], (v)[j], PAIRS)
#else
#define SWAPPED(v, j) __builtin_shuffle((v)[j], (choice){PAIRS})
#endif

/* A row of states; the whole array would be many times as long. */
ALWAYS_INLINE void copy(const int blocks, const lanes *from, lanes *to)
{
    for (int j = 0; j < blocks; j++) to[j] = from[j];
}

ALWAYS_INLINE number total(const lanes *of)
{
    number sum[PER];
    for (int j = 0; j < PER; j++) sum[j] = AT(of, j);
    for (int half = PER / 2; half > 0; half /= 2)
        for (int j = 0; j < half; j++) sum[j] += sum[j + half];
    return sum[0];
}

#if ENTRIES > 1
ALWAYS_INLINE number absolute(const number of) { return (number)((choice)of & INT64_MAX); }
#else
#define absolute fabs
#endif

/* The larger; the second if the first is NaN. */
ALWAYS_INLINE number at_least(const number of, const number least) { return CHOSEN(of > least, of, least); }

ALWAYS_INLINE number largest(const lanes *of)
{
    number most = AT(of, 0);
    for (int j = 1; j < PER; j++) most = at_least(AT(of, j), most);
    return most;
}

/* One side of every row: slack s = sign (value - bound), multiplier l, s l -> 0. Without a bound `there` = l = 0. */
typedef struct {
    double sign;
    lanes *there, *bound, *s, *l, *inverse, *residual, *cross; /* 1 / s, residual of s, product of the predictor's steps */
} tr_side;

/* Working data of one solve. Changes by a Newton step have the prefix d. */
typedef struct {
    const tr_problem *q; /* the first of all */
    const tr_problem *const *all;
    tr_watch *watch;
    int ld;                              /* length of a row of states, padded with zeros */
    int blocks;                          /* registers for the values of all rows */
    /* Data of the problems; each number holds the values of all of them. */
    const number *E, *weight, *reference, *rule_gain, *rule_offset, *end_target, *d, *d_size;
    const number *M, *b, *gain, *square, *F, *f;
    number movement_weight, decay, ripple, copper, command_bound, constant;
    lanes *A, *At, *C, *G, *Z;          /* padded A, its transpose, C, G and Z */
    int paired;                          /* A couples states 2 i and 2 i + 1, and the held command to all */
    int pairs_end;                       /* index of the first state that is not coupled in a pair */
    lanes own[MOST_BLOCKS], from_pair[MOST_BLOCKS], to_pair[MOST_BLOCKS]; /* its diagonal, A[j][j ^ 1] and A[j ^ 1][j] */
    /* Its last columns; one at each held command. */
    lanes push[MOST_MOTORS * MOST_BLOCKS], held[MOST_MOTORS * MOST_BLOCKS];
    unsigned char *tracked; /* (N, outputs) whether a weight is other than zero */
    lanes *K, *Ke;
    number *Kth, *pivot;             /* gains of u by states and by nodes; (N, m, m) inverse pivots and, left of them, gains by u */
    number *Keth, *Ke_u, *pivot_e;  /* the same of e, its gain by u */
    number *offset, *offset_e;           /* Newton step without feedback */
    number *u, *e, *du, *de;
    number *error, *d_error, *end_error, *d_end_error;
    number *current, *command, *d_current, *d_command; /* i_k, c_k, where they heat */
    number *heat;                        /* (N, 4): dh/di, dh/dc, times resistance; resistance; copper h */
    number *theta;                       /* (N + 1, nodes) */
    number *by_heat;                     /* (N) b' costate of th_(k+1) */
    lanes *V, *dV, *sigma, *y;           /* rows: values, weights, gradients */
    tr_side side[2];                     /* their lower and their upper limits */
    number *unit_offset, *unit_offset_e; /* (nodes, N) response to the closure's multiplier */
    number *still;                       /* (N) zeros */
    number *kept_movement, *kept_gradient, *kept_size; /* of the best iterate so far */
    lanes *kept_lower, *kept_upper;
    number kept_start[MOST_NODES], kept_objective, kept_gap, kept_residual;
    number sound;                        /* 0 where a factorisation has broken down */
    int limited;                         /* whether there is any limit */
    int cut;                             /* stage whose cost to go and costate are kept below, where these are not NULL */
    lanes *cost_at_cut, *costate_at_cut;
    /* At the ends of the horizon: cost to go in th_0, its gradient, th_N of a step; the closure's multiplier. */
    number P0[MOST_NODES * MOST_NODES], p0[MOST_NODES], th_end[MOST_NODES];
    number eta[MOST_NODES], d_eta[MOST_NODES], d_start[MOST_NODES];
    number closing[4 * MOST_NODES * MOST_NODES]; /* matrix of the closure's equations */
    /* Whether E, d and d_size are other than zero. */
    int direct[MOST_MOTORS * MOST_ROWS], moves[MOST_MOTORS * MOST_ROWS], sizes[MOST_ROWS];
    int from[MOST_ROWS], to[MOST_ROWS];          /* range of states with the nonzeros of a row of G */
} tr_work;

/* Measures of an iterate: the parts of its gap, and its objective. */
typedef struct {
    number complementarity, residual, stationarity, objective;
} tr_state;

/* Number of registers of a row of n states, padded with zeros; number of those computed in row i of a symmetric matrix. */
#define BLOCKS(n) (((n) + WHOLE - 1) / WHOLE * WHOLE / PER)
#define LOWER(i, blocks) (ENTRIES > 1 ? (i) + 1 : (blocks))

/* The next `count` numbers of the workspace; NULL while only its size is counted. */
static void *take(double *space, size_t *taken, size_t count)
{
    void *found = space ? space + *taken : NULL;
    *taken += (count * ENTRIES + WIDTH - 1) / WIDTH * WIDTH;
    return found;
}

/* An array of the problems, interleaved number by number; with one problem its own array. NULL without workspace. */
static const number *of_each(const void *const *all, size_t field, size_t count, double *space, size_t *taken)
{
#if ENTRIES > 1
    static const double zero;
    const double *from[ENTRIES];
    size_t step[ENTRIES];
    int one = 1; /* whether all problems have the same array */
    number *found = take(space, taken, count);
    if (!space) return NULL;
    for (int e = 0; e < ENTRIES; e++) {
        from[e] = *(const double *const *)((const char *)all[e] + field);
        step[e] = from[e] != NULL;
        if (!from[e]) from[e] = &zero;
        one = one && from[e] == from[0];
    }
    for (size_t i = 0; i < count && one; i++)
        for (int e = 0; e < ENTRIES; e++) EACH(found[i], e) = from[0][i * step[0]];
    for (size_t i = 0; i < count && !one; i++)
        for (int e = 0; e < ENTRIES; e++) EACH(found[i], e) = from[e][i * step[e]];
    return found;
#else
    (void)count, (void)space, (void)taken;
    return *(const double *const *)((const char *)all[0] + field);
#endif
}

/* One scalar field of all problems. */
static number each(const tr_problem *const *all, size_t field)
{
    number found;
    for (int e = 0; e < ENTRIES; e++) EACH(found, e) = *(const double *)((const char *)all[e] + field);
    return found;
}

/* Arrays in the workspace. Returns the doubles that are taken. */
static size_t lay_out(tr_work *w, const tr_problem *const *all, double *space)
{
    const tr_problem *q = w->q = all[0];
    const size_t N = (size_t)q->stages, m = (N + 1) * (size_t)q->rows, ny = (size_t)q->outputs, t = (size_t)NODES(q);
    const size_t n = (size_t)q->states, ld = BLOCKS(n) * PER, ruled = N - (size_t)q->free_stages;
    const size_t motors = (size_t)q->motors, moves = N * motors;
    size_t taken = 0;
    w->all = all;
    w->ld = (int)ld;
    w->blocks = (int)((m + PER - 1) / PER);
    const size_t warm = t ? N : 0; /* what only temperatures need */
    w->A = take(space, &taken, ld * ld), w->At = take(space, &taken, ld * ld);
    w->C = take(space, &taken, ny * ld), w->G = take(space, &taken, (size_t)q->rows * ld);
    w->Z = take(space, &taken, (size_t)q->ends * ld), w->end_error = take(space, &taken, (size_t)q->ends);
    w->K = take(space, &taken, moves * ld), w->u = take(space, &taken, moves), w->error = take(space, &taken, N * ny);
    w->d_error = take(space, &taken, N * ny), w->offset = take(space, &taken, moves), w->V = take(space, &taken, m);
    for (tr_side *z = w->side; z < w->side + 2; z++) {
        z->there = take(space, &taken, m), z->bound = take(space, &taken, m);
        z->inverse = take(space, &taken, m), z->residual = take(space, &taken, m);
        z->cross = take(space, &taken, m);
    }
    w->Kth = take(space, &taken, N * t), w->Keth = take(space, &taken, N * t);
    w->Ke = take(space, &taken, warm * ld), w->Ke_u = take(space, &taken, warm), w->pivot_e = take(space, &taken, warm);
    w->offset_e = take(space, &taken, warm), w->e = take(space, &taken, warm), w->de = take(space, &taken, warm);
    w->heat = take(space, &taken, 4 * warm), w->by_heat = take(space, &taken, warm);
    w->unit_offset = take(space, &taken, N * t), w->unit_offset_e = take(space, &taken, N * t);
    w->current = take(space, &taken, warm), w->command = take(space, &taken, warm);
    w->d_current = take(space, &taken, warm), w->d_command = take(space, &taken, warm);
    w->still = take(space, &taken, warm), w->theta = take(space, &taken, (N + 1) * t);
    w->pivot = take(space, &taken, moves * motors), w->dV = take(space, &taken, m);
    w->kept_movement = take(space, &taken, moves), w->kept_gradient = take(space, &taken, moves);
    w->kept_size = take(space, &taken, warm);
    w->kept_lower = take(space, &taken, m), w->kept_upper = take(space, &taken, m);
    /* The arrays from here on are written before they are read and need no zeros. */
    w->du = take(space, &taken, moves), w->d_end_error = take(space, &taken, (size_t)q->ends);
    w->sigma = take(space, &taken, m), w->y = take(space, &taken, m);
    for (tr_side *z = w->side; z < w->side + 2; z++) {
        z->s = take(space, &taken, m), z->l = take(space, &taken, m);
    }
    w->tracked = take(space, &taken, N * ny); /* more than enough */
#define OF_EACH(field, count) of_each((const void *const *)all, offsetof(tr_problem, field), count, space, &taken)
    w->E = OF_EACH(E, ny * motors), w->weight = OF_EACH(weight, N * ny), w->reference = OF_EACH(reference, N * ny);
    w->rule_gain = OF_EACH(rule_gain, ruled * motors * n), w->rule_offset = OF_EACH(rule_offset, ruled * motors);
    w->end_target = OF_EACH(end_target, (size_t)q->ends);
    w->d = OF_EACH(d, (size_t)q->rows * motors), w->d_size = OF_EACH(d_size, (size_t)q->rows);
    w->M = OF_EACH(M, t * t), w->b = OF_EACH(b, t), w->gain = OF_EACH(gain, warm), w->square = OF_EACH(square, t ? 3 : 0);
    w->F = OF_EACH(F, t * t), w->f = OF_EACH(f, t);
    return taken;
}

/* Doubles that this kernel needs, wherever they begin. */
static size_t workspace(const tr_problem *q)
{
    tr_work w;
    const tr_problem *all[MOST_ENTRIES];
    for (int e = 0; e < MOST_ENTRIES; e++) all[e] = q;
    return lay_out(&w, all, NULL) + WIDTH - 1;
}

/* Find out whether A couples states in pairs only, and store the coefficients. */
static void pair_up(tr_work *w)
{
    const int n = w->q->states, motors = w->q->motors, first = n - motors, blocks = w->ld / PER;
    w->paired = tr_paired(w->q);
    for (int e = 0; e < ENTRIES; e++) {
        const double *A = w->all[e]->A;
        for (int i = 0; i < first; i++) {
            const int other = i ^ 1;
            EACH(AT(w->own, i), e) = A[i * n + i];
            if (other >= first) continue;
            EACH(AT(w->from_pair, i), e) = A[i * n + other], EACH(AT(w->to_pair, i), e) = A[other * n + i];
            if (A[i * n + other] != 0.0 && w->pairs_end < (i | 1) + 1) w->pairs_end = (i | 1) + 1;
        }
        for (int c = 0; c < motors; c++) {
            for (int i = 0; i < n; i++) EACH(AT(w->push + c * blocks, i), e) = A[i * n + first + c];
            EACH(AT(w->held + c * blocks, first + c), e) = 1.0;
        }
    }
}

/* The matrices, their rows padded with zeros. */
static void pad(tr_work *w)
{
    const tr_problem *q = w->q;
    const size_t n = (size_t)q->states, ld = (size_t)w->ld;
    memset(w->A, 0, (size_t)((char *)w->end_error - (char *)w->A));
    for (int e = 0; e < ENTRIES; e++) {
        q = w->all[e];
        for (size_t j = 0; j < n; j++) {
            for (size_t i = 0; i < n && !w->paired; i++)
                EACH(AT(w->A, i * ld + j), e) = EACH(AT(w->At, j * ld + i), e) = q->A[i * n + j];
            for (size_t s = 0; s < (size_t)q->outputs; s++) EACH(AT(w->C, s * ld + j), e) = q->C[s * n + j];
            for (size_t s = 0; s < (size_t)q->rows; s++) EACH(AT(w->G, s * ld + j), e) = q->G[s * n + j];
            for (size_t s = 0; s < (size_t)q->ends; s++) EACH(AT(w->Z, s * ld + j), e) = q->end_gain[s * n + j];
        }
        for (int j = 0; j < q->rows; j++) {
            const double *c = q->G + (size_t)j * n;
            int from = 0, to = q->states;
            while (to > 0 && c[to - 1] == 0.0) to--;
            while (from < to && c[from] == 0.0) from++;
            if (e == 0 || from < w->from[j]) w->from[j] = from;
            if (e == 0 || to > w->to[j]) w->to[j] = to;
        }
    }
}

/* Whether a number is other than zero in any problem. */
static int any(const number of)
{
    int found = 0;
    for (int e = 0; e < ENTRIES; e++) found = found || EACH(of, e) != 0.0;
    return found;
}

/* The numbers of all problems. */
static void state(tr_work *w)
{
    w->movement_weight = each(w->all, offsetof(tr_problem, movement_weight));
    w->decay = each(w->all, offsetof(tr_problem, decay));
    w->ripple = each(w->all, offsetof(tr_problem, ripple));
    w->copper = each(w->all, offsetof(tr_problem, copper));
    w->command_bound = each(w->all, offsetof(tr_problem, command_bound));
    w->constant = each(w->all, offsetof(tr_problem, constant));
    for (int o = 0; o < w->q->outputs * w->q->motors; o++) w->direct[o] = any(w->E[o]);
    for (int i = 0; i < w->q->rows * w->q->motors; i++) w->moves[i] = any(w->d[i]);
    for (int i = 0; i < w->q->rows; i++) w->sizes[i] = any(w->d_size[i]);
    for (int i = 0; i < w->q->stages * w->q->outputs; i++) w->tracked[i] = (unsigned char)any(w->weight[i]);
    pair_up(w);
    pad(w);
}

/* Lay out the workspace: zeros, and the data of the problems. */
static void prepare(tr_work *w, const tr_problem *const *all, double *space, tr_watch *watch)
{
    const size_t n = (size_t)all[0]->states, ld = BLOCKS(n) * PER, stages = (size_t)all[0]->stages;
    const size_t rows = (stages + 1) * (size_t)all[0]->rows, free = (size_t)all[0]->free_stages;
    while ((uintptr_t)space % (WIDTH * sizeof(double))) space++;
    memset(w, 0, sizeof *w);
    w->watch = watch;
    lay_out(w, all, space);
    memset(space, 0, (size_t)((char *)w->du - (char *)space));
    for (int side = 0; side < 2; side++) {
        tr_side *z = w->side + side;
        z->sign = side ? -1.0 : 1.0;
        for (int i = 0; i < w->blocks; i++) z->s[i] = z->there[i] + 1.0, z->l[i] = z->there[i];
        for (int e = 0; e < ENTRIES; e++) {
            const double *limit = side ? all[e]->upper : all[e]->lower;
            for (size_t i = 0; i < rows; i++)
                if (limit[i] > -INFINITY && limit[i] < INFINITY)
                    EACH(AT(z->there, i), e) = 1.0, EACH(AT(z->bound, i), e) = limit[i];
        }
    }
    state(w);
    const size_t motors = (size_t)all[0]->motors;
    for (size_t at = free * motors; at < stages * motors; at++)
        for (size_t j = 0; j < n; j++) AT(w->K, at * ld + j) = w->rule_gain[(at - free * motors) * n + j];
}

/* out = M' v, four rows of M at a time: short chains of additions. */
ALWAYS_INLINE void combine(const int blocks, const lanes *restrict M, const number *restrict v, lanes *restrict out)
{
    for (int j = 0; j < blocks; j++) {
        const lanes *m = M + j;
        lanes sum = (v[0] * m[0] + v[1] * m[blocks]) + (v[2] * m[2 * blocks] + v[3] * m[3 * blocks]);
        for (int l = 4; l < blocks * PER; l += 4) {
            m += 4 * blocks;
            sum += (v[l] * m[0] + v[l + 1] * m[blocks]) + (v[l + 2] * m[2 * blocks] + v[l + 3] * m[3 * blocks]);
        }
        out[j] = sum;
    }
}

ALWAYS_INLINE number dot(const int blocks, const lanes *restrict a, const lanes *restrict b)
{
    lanes sum = a[0] * b[0];
    if (ENTRIES > 1) { /* whole pairs */
        lanes other = a[1] * b[1];
        for (int j = 2; j < blocks; j += 2) sum += a[j] * b[j], other += a[j + 1] * b[j + 1];
        sum += other;
        return AT(&sum, 0);
    }
    for (int j = 1; j < blocks; j++) sum += a[j] * b[j];
    return total(&sum);
}

ALWAYS_INLINE void add(const int blocks, const number by, const lanes *restrict c, lanes *restrict to)
{
    for (int j = 0; j < blocks; j++) to[j] += by * c[j];
}

/* Add a multiple of a row c that is zero but between two of its states. */
ALWAYS_INLINE void add_part(const int blocks, const number by, const lanes *restrict c, const int from, const int to,
                            lanes *restrict out)
{
    for (int j = ENTRIES > 1 ? from : 0; j < (ENTRIES > 1 ? to : blocks); j++) out[j] += by * c[j];
}

/* out = A x + B u. */
ALWAYS_INLINE void flow(const int first, const int motors, const int blocks, const tr_work *w, const lanes *restrict x,
                        const number *u, lanes *restrict out)
{
    if (ENTRIES == 1 && !w->paired) {
        combine(blocks, w->At, (const number *)x, out);
        for (int c = 0; c < motors; c++) add(blocks, u[c], w->At + (first + c) * blocks, out);
        return;
    }
    const int coupled = ENTRIES > 1 ? w->pairs_end : blocks;
    number command[MOST_MOTORS];
    for (int c = 0; c < motors; c++) command[c] = AT(x, first + c) + u[c];
    for (int j = 0; j < blocks; j++) {
        lanes sum = w->own[j] * x[j];
        if (j < coupled) sum += w->from_pair[j] * SWAPPED(x, j);
        for (int c = 0; c < motors; c++) sum += command[c] * w->push[c * blocks + j];
        out[j] = sum;
    }
}

/* out = A' p. */
ALWAYS_INLINE void flow_back(const int first, const int motors, const int blocks, const tr_work *w,
                             const lanes *restrict p, lanes *restrict out)
{
    if (ENTRIES == 1 && !w->paired) {
        combine(blocks, w->A, (const number *)p, out);
        return;
    }
    const int coupled = ENTRIES > 1 ? w->pairs_end : blocks;
    number command[MOST_MOTORS];
    for (int c = 0; c < motors; c++) command[c] = dot(blocks, w->push + c * blocks, p);
    for (int j = 0; j < blocks; j++) {
        lanes sum = w->own[j] * p[j];
        if (j < coupled) sum += w->to_pair[j] * SWAPPED(p, j);
        for (int c = 0; ENTRIES == 1 && c < motors; c++) sum += command[c] * w->held[c * blocks + j];
        out[j] = sum;
    }
    for (int c = 0; ENTRIES > 1 && c < motors; c++) AT(out, first + c) += command[c];
}

/* pushed_c = P b_c of the columns of B. */
ALWAYS_INLINE void push_back(const int n, const int motors, const int blocks, const tr_work *w, const lanes *restrict P,
                             lanes *restrict pushed)
{
    const int rows = ENTRIES > 1 ? n : blocks * PER; /* those of the padding are zero, and their number is known */
    memset(pushed, 0, (size_t)(motors * blocks) * sizeof(lanes));
    for (int i = 0; i < rows; i++) {
        number by[MOST_MOTORS], rest[MOST_MOTORS] = {0}; /* of the row, which is not computed beyond its diagonal */
        const lanes *row = P + i * blocks;
        for (int c = 0; c < motors; c++) by[c] = AT(w->push + c * blocks, i);
        for (int j = 0; j < LOWER(i, blocks); j++)
            for (int c = 0; c < motors; c++) {
                pushed[c * blocks + j] += by[c] * row[j];
                if (ENTRIES > 1 && j < i) rest[c] += AT(w->push + c * blocks, j) * AT(row, j);
            }
        for (int c = 0; ENTRIES > 1 && c < motors; c++) AT(pushed + c * blocks, i) += rest[c];
    }
}

/* H = A' P A of a symmetric P; PA is scratch. */
ALWAYS_INLINE void congruence(const int n, const int motors, const int blocks, const tr_work *w, const lanes *restrict P,
                              lanes *restrict PA, lanes *restrict H)
{
    const int first = n - motors, ld = blocks * PER, coupled = ENTRIES > 1 ? w->pairs_end : blocks;
    if (ENTRIES == 1 && !w->paired) {
        for (int i = 0; i < ld; i++) combine(blocks, w->A, (const number *)(P + i * blocks), PA + i * blocks);
        for (int i = 0; i < ld; i++) combine(blocks, PA, (const number *)(w->At + i * blocks), H + i * blocks);
        return;
    }
    lanes pushed[MOST_MOTORS * MOST_BLOCKS];
    push_back(n, motors, blocks, w, P, pushed);
    for (int c = 0; c < motors; c++) flow_back(first, motors, blocks, w, pushed + c * blocks, H + (first + c) * blocks);
    for (int i = 0; i < first; i += 2) { /* a pair of rows; of the last columns only the last rows are needed */
        const int end = ENTRIES > 1 ? i + 2 : blocks, pairs = coupled < end ? coupled : end;
        const int count = i + 1 < first ? 2 : 1;
        for (int s = 0; s < count; s++) {
            const lanes *row = P + (i + s) * blocks;
            lanes *of = PA + s * blocks;
            for (int j = 0; j < pairs; j++) of[j] = w->own[j] * row[j] + w->to_pair[j] * SWAPPED(row, j);
            for (int j = pairs; j < end; j++) of[j] = w->own[j] * row[j];
        }
        for (int s = 0; s < count; s++) {
            const lanes *of = PA + s * blocks, *other = PA + (count - 1 - s) * blocks;
            const number own = AT(w->own, i + s), pair = AT(w->to_pair, i + s);
            lanes *row = H + (i + s) * blocks;
            if (ENTRIES > 1 && i >= coupled) {
                for (int j = 0; j < LOWER(i + s, blocks); j++) row[j] = own * of[j];
                continue;
            }
            for (int j = 0; j < LOWER(i + s, blocks); j++) {
                row[j] = own * of[j] + pair * other[j];
                for (int c = 0; ENTRIES == 1 && c < motors; c++)
                    row[j] += AT(H + (first + c) * blocks, i + s) * w->held[c * blocks + j];
            }
        }
    }
}

/* Add c d' to H. */
ALWAYS_INLINE void add_product(const int blocks, const lanes *restrict c, const lanes *restrict d, lanes *restrict H)
{
    for (int i = 0; i < blocks * PER; i++) add(LOWER(i, blocks), AT(c, i), d, H + i * blocks);
}

/* Add weight c c' to H, of a row c that is zero but between two of its states. */
ALWAYS_INLINE void add_square(const int blocks, const number weight, const lanes *restrict c, const int from,
                              const int to, lanes *restrict H)
{
    for (int i = from; i < to; i++) {
        const number by = weight * AT(c, i);
        for (int j = ENTRIES > 1 ? from : 0; j < LOWER(i, blocks); j++) H[i * blocks + j] += by * c[j];
    }
}

/* Add what a squared row c x + d u of a weight says about the movements: to `hu`, by states and movements, and to the
 * lower triangle of `r`, by movements alone. */
ALWAYS_INLINE void add_controls(const int motors, const int blocks, const number weight, const number *d,
                                const int *moves, const int row, const lanes *restrict c, const int from,
                                const int to, lanes *restrict hu, number *restrict r)
{
    for (int i = 0; i < motors; i++) {
        const number by = weight * d[row * motors + i];
        if (!moves[row * motors + i]) continue;
        add_part(blocks, by, c, from, to, hu + i * blocks);
        for (int j = 0; j <= i; j++) r[i * motors + j] += by * d[row * motors + j];
    }
}

/* Whether a factorisation may go on: a pivot is positive, in one of the problems at least. */
ALWAYS_INLINE int keeps(tr_work *w, const number *pivot)
{
#if ENTRIES > 1
    w->sound = (number)((choice)w->sound & (*pivot > 0.0));
    return 1;
#else
    if (!(*pivot > 0.0)) w->sound = 0.0;
    return w->sound != 0.0;
#endif
}

/* Add the nodes' part to H = A' P A of the states. The nodes' flow is B x + M th with B = b g', where g = `by_x`.
 *
 * Cost to go P (states), Q (nodes, states), R (nodes, nodes). Out: H; HQ and HR; f = sum_i b_i U_i and fR = b' R M,
 * where [U R M] are the nodes' rows of P times the flow. Returns b' R b.
 */
ALWAYS_INLINE number add_nodes(const int t, const int blocks, const tr_work *w, const number *heat,
                               const lanes *restrict by_x, const lanes *restrict Q, const number *restrict R,
                               lanes *restrict H, lanes *restrict HQ, number *restrict HR, lanes *restrict f,
                               number *restrict fR)
{
    const number nothing = {0};
    number M[MOST_NODES * MOST_NODES], RM[MOST_NODES * MOST_NODES], bRb = {0};
    lanes U[MOST_NODES * MOST_BLOCKS], half[MOST_BLOCKS];
    for (int i = 0; i < t; i++)
        for (int j = 0; j < t; j++) M[i * t + j] = w->M[i * t + j] + (j == 0 ? w->b[i] * heat[3] : w->b[i] * 0.0);
    for (int i = 0; i < t; i++) {
        number Rb = {0};
        for (int j = 0; j < t; j++) Rb += R[i * t + j] * w->b[j];
        bRb += w->b[i] * Rb;
        flow_back(w->q->states - 1, 1, blocks, w, Q + i * blocks, U + i * blocks);
        add(blocks, Rb, by_x, U + i * blocks);
        for (int j = 0; j < t; j++) {
            RM[i * t + j] = nothing;
            for (int l = 0; l < t; l++) RM[i * t + j] += R[i * t + l] * M[l * t + j];
        }
    }
    for (int j = 0; j < blocks; j++) f[j] = w->b[0] * U[j];
    for (int i = 1; i < t; i++) add(blocks, w->b[i], U + i * blocks, f);
    for (int j = 0; j < blocks; j++) half[j] = f[j] - 0.5 * bRb * by_x[j];
    for (int i = 0; i < blocks * PER; i++)
        for (int j = 0; j < LOWER(i, blocks); j++) H[i * blocks + j] += AT(half, i) * by_x[j] + AT(by_x, i) * half[j];
    for (int i = 0; i < t; i++) {
        for (int j = 0; j < blocks; j++) HQ[i * blocks + j] = M[i] * U[j];
        for (int l = 1; l < t; l++) add(blocks, M[l * t + i], U + l * blocks, HQ + i * blocks);
        fR[i] = nothing;
        for (int l = 0; l < t; l++) fR[i] += w->b[l] * RM[l * t + i];
        for (int j = 0; j < t; j++) {
            HR[i * t + j] = nothing;
            for (int l = 0; l < t; l++) HR[i * t + j] += M[l * t + i] * RM[l * t + j];
        }
    }
    return bRb;
}

/* A costate on its way backward. */
typedef struct {
    lanes p[MOST_BLOCKS], by_x[MOST_BLOCKS];
    number th[MOST_NODES];
} tr_costate;

/* Gradient by a row: of the Newton step, or of the Lagrangian. */
ALWAYS_INLINE number by_row(const tr_work *w, const int newton, const int at)
{
    if (newton) return AT(w->y, at);
    return AT(w->side[1].l, at) - AT(w->side[0].l, at);
}

/* The costate at N. `own` is 0 for the response to the closure's multiplier alone. */
ALWAYS_INLINE void backward_begin(const int blocks, const tr_work *w, const int t, const number *end, const int own,
                                  const int newton, tr_costate *c)
{
    const tr_problem *q = w->q;
    const int N = q->stages, m = q->rows;
    memset(c, 0, sizeof *c);
    for (int i = 0; i < t; i++) c->th[i] = end[i];
    if (t && own) c->th[0] += by_row(w, newton, N * m);
    for (int j = 0; own && j < q->ends; j++) add(blocks, w->end_error[j], w->Z + j * blocks, c->p);
    for (int j = t ? 1 : 0; own && j < m; j++) {
        add(blocks, by_row(w, newton, N * m + j), w->G + j * blocks, c->p);
    }
}

/* From k + 1 to k with the gains: steps without feedback into `offset`; without them, as not `newton`: the gradient
 * into `offset`, and the heat's prices. */
ALWAYS_INLINE void backward_stage(const int n, const int motors, const int blocks, tr_work *w, const int t, const int k,
                                  const int own, number *restrict offset, number *restrict offset_e, const int newton,
                                  tr_costate *c)
{
    const tr_problem *q = w->q;
    const int m = q->rows, first = n - motors;
    const lanes nothing = {0};
    lanes a[MOST_BLOCKS], drive[MOST_BLOCKS];
    number by_size = {0}, th_before[MOST_NODES] = {0}, by_movement[MOST_MOTORS] = {0};
    /* Terms that do not depend on later stages are computed first, off the critical path. */
    for (int j = 0; j < blocks; j++) drive[j] = nothing;
    if (own) {
        for (int i = 0; i < motors; i++) by_movement[i] = w->movement_weight * w->u[k * motors + i];
        for (int o = 0; o < q->outputs; o++) {
            if (!w->tracked[k * q->outputs + o]) continue;
            const number v = w->weight[k * q->outputs + o] * w->error[k * q->outputs + o];
            for (int i = 0; i < motors; i++) by_movement[i] += w->E[o * motors + i] * v;
            add(blocks, v, w->C + o * blocks, drive);
        }
        if (t) th_before[0] = by_row(w, newton, k * m);
        for (int j = t ? 1 : 0; j < m; j++) {
            const number y = by_row(w, newton, k * m + j);
            for (int i = 0; i < motors; i++) by_movement[i] += w->d[j * motors + i] * y;
            by_size += w->d_size[j] * y;
            add_part(blocks, y, w->G + j * blocks, w->from[j], w->to[j], drive);
        }
    }
    flow_back(first, motors, blocks, w, c->p, a);
    if (t) {
        const number *heat = w->heat + 4 * k;
        number beta = {0};
        for (int i = 0; i < t; i++) beta += w->b[i] * c->th[i];
        if (q->current >= 0) AT(c->by_x, q->current) = heat[0];
        AT(c->by_x, first) = heat[1];
        add(blocks, beta, c->by_x, a);
        by_size += 2.0 * w->ripple * heat[2] * beta;
        for (int j = 0; j < t; j++)
            for (int i = 0; i < t; i++) th_before[j] += w->M[i * t + j] * c->th[i];
        th_before[0] += heat[3] * beta;
        if (!newton) w->by_heat[k] = beta;
    }
    for (int i = 0; i < motors; i++) by_movement[i] += AT(a, first + i);
    for (int j = 0; j < blocks; j++) a[j] += drive[j];
    const lanes *gains = w->K + k * motors * blocks;
    if (newton) {
        if (t) {
            offset_e[k] = -by_size * w->pivot_e[k];
            by_movement[0] += w->Ke_u[k] * by_size;
            add(blocks, by_size, w->Ke + k * blocks, a);
            for (int j = 0; j < t; j++) th_before[j] += w->Keth[k * t + j] * by_size;
        }
        for (int i = motors - 1; i >= 0; i--) {
            const number *pivot = w->pivot + (k * motors + i) * motors;
            offset[k * motors + i] = -by_movement[i] * pivot[i];
            for (int j = 0; j < i; j++) by_movement[j] += pivot[j] * by_movement[i];
            add(blocks, by_movement[i], gains + i * blocks, a);
        }
        for (int j = 0; j < t; j++) c->th[j] = th_before[j] + w->Kth[k * t + j] * by_movement[0];
    } else {
        for (int i = 0; i < motors; i++) {
            offset[k * motors + i] = by_movement[i];
            if (k >= q->free_stages) add(blocks, by_movement[i], gains + i * blocks, a);
        }
        if (t) offset_e[k] = by_size;
        for (int j = 0; j < t; j++) c->th[j] = th_before[j];
    }
    for (int j = 0; j < blocks; j++) c->p[j] = a[j];
}

ALWAYS_INLINE void backward_sized(const int n, const int motors, const int t, const int blocks, tr_work *w,
                                  const number *end, const int own, number *restrict offset, number *restrict offset_e,
                                  const int newton)
{
    tr_costate costate;
    backward_begin(blocks, w, t, end, own, newton, &costate);
    for (int k = w->q->stages - 1; k >= 0; k--) {
        backward_stage(n, motors, blocks, w, t, k, own, offset, offset_e, newton, &costate);
        if (w->costate_at_cut && k == w->cut) memcpy(w->costate_at_cut, costate.p, (size_t)blocks * sizeof(lanes));
    }
    memcpy(w->p0, costate.th, (size_t)t * sizeof(number));
}

/* Backward: gains of u and e from the weights `sigma` of the rows. With `curved` the copper's bilinear terms are in.
 * With `end`, the heat's price at N, the Newton step's costate goes along, as in `backward`: its chain of short sums
 * then waits while the products of the factorisation keep the processor busy. Returns 0, or the code of what has ended
 * it. */
ALWAYS_INLINE int factor_sized(const int n, const int motors, const int t, const int blocks, tr_work *w,
                               const int curved, const number *end)
{
    const tr_problem *q = w->q;
    const int N = q->stages, m = q->rows, first = n - motors, a = q->current, ld = blocks * PER;
    const int of_current = t && a >= 0;
    lanes P[PER * MOST_BLOCKS * MOST_BLOCKS], PA[(ENTRIES > 1 ? 2 : PER * MOST_BLOCKS) * MOST_BLOCKS];
    lanes H[PER * MOST_BLOCKS * MOST_BLOCKS], squares[PER * MOST_BLOCKS * MOST_BLOCKS];
    int squared = -1; /* the stage whose outputs' part of H `squares` is: of several motors, whose outputs are many */
    lanes hu[MOST_MOTORS * MOST_BLOCKS], he[MOST_BLOCKS], by_x[MOST_BLOCKS], bend_a[MOST_BLOCKS], bend_c[MOST_BLOCKS];
    lanes Q[MOST_NODES * MOST_BLOCKS], HQ[MOST_NODES * MOST_BLOCKS];
    number R[MOST_NODES * MOST_NODES], HR[MOST_NODES * MOST_NODES], hu_th[MOST_NODES], he_th[MOST_NODES];
    const number e1 = w->decay, e2 = 1.0 - e1, *s = w->square;
    tr_costate costate;
    if (end) backward_begin(blocks, w, t, end, 1, 1, &costate);
    memset(P, 0, (size_t)(ld * blocks) * sizeof(lanes));
    memset(H, 0, (size_t)(ld * blocks) * sizeof(lanes));
    for (int e = 0; e < ENTRIES; e++) EACH(w->sound, e) = 1.0;
    memset(by_x, 0, sizeof by_x);
    memset(bend_a, 0, sizeof bend_a);
    memset(bend_c, 0, sizeof bend_c);
    memset(Q, 0, sizeof Q);
    memset(R, 0, sizeof R);
    for (int j = 0; j < q->ends; j++) add_product(blocks, w->Z + j * blocks, w->Z + j * blocks, P);
    for (int j = t ? 1 : 0; j < m; j++) {
        add_square(blocks, AT(w->sigma, N * m + j), w->G + j * blocks, w->from[j], w->to[j], P);
    }
    for (int i = 1; ENTRIES > 1 && i < n; i += 2) P[(i - 1) * blocks + i] = P[i * blocks + i - 1];
    if (t) R[0] = AT(w->sigma, N * m), AT(bend_c, first) = 2.0 * s[2] * e2 * e2;
    if (of_current) {
        AT(bend_a, a) = 2.0 * (s[0] + s[1] * e1 + s[2] * e1 * e1);
        AT(bend_a, first) = AT(bend_c, a) = (s[1] + 2.0 * s[2] * e1) * e2;
    }
    for (int k = N - 1; k >= 0; k--) {
        if (k % STRIDE == 0 && tr_interrupted(w->watch)) return TR_INTERRUPTED;
        const number *heat = w->heat + 4 * k, *sigma = &AT(w->sigma, k * m);
        number r[MOST_MOTORS * MOST_MOTORS], hee = {0}, heu = {0};
        lanes *gains = w->K + k * motors * blocks;
        congruence(n, motors, blocks, w, P, PA, H);
        if (t) {
            /* e moves the nodes only: column 2 ripple resistance b. */
            const number by = 2.0 * w->ripple * heat[2];
            if (of_current) AT(by_x, a) = heat[0];
            AT(by_x, first) = heat[1];
            hee = by * by * add_nodes(t, blocks, w, heat, by_x, Q, R, H, HQ, HR, he, he_th);
            for (int j = 0; j < blocks; j++) he[j] *= by;
            for (int j = 0; j < t; j++) he_th[j] *= by;
            heu = AT(he, first);
            /* Curvature of the heat, weighed by what a kelvin at the next instant costs. */
            const number price = w->by_heat[k], bend = price * heat[2];
            if (of_current) add(blocks, bend, bend_a, H + a * blocks);
            add(blocks, bend, bend_c, H + first * blocks);
            if (ENTRIES == 1 && curved && EACH(heat[2], 0) > 0.0) {
                add(blocks, price * w->copper / heat[2], by_x, HQ);
                he_th[0] += price * w->copper * 2.0 * w->ripple;
            }
            HR[0] += sigma[0];
            for (int j = 0; j < t; j++) hu_th[j] = AT(HQ + j * blocks, first);
        }
        for (int j = 0; j < motors * blocks; j++) hu[j] = H[first * blocks + j];
        for (int c = 0; c < motors; c++)
            for (int i = 0; i <= c; i++) r[c * motors + i] = AT(hu + c * blocks, first + i);
        for (int c = 0; c < motors; c++) r[c * motors + c] += w->movement_weight;
        const number *weights = w->weight + k * q->outputs;
        const size_t in_one = (size_t)q->outputs * sizeof(number);
        if (motors > 1 && (squared < 0 || memcmp(weights, w->weight + squared * q->outputs, in_one))) {
            memset(squares, 0, (size_t)(ld * blocks) * sizeof(lanes));
            for (int o = 0; o < q->outputs; o++) add_square(blocks, weights[o], w->C + o * blocks, 0, n, squares);
            squared = k;
        }
        for (int o = 0; o < q->outputs; o++) {
            if (!w->tracked[k * q->outputs + o]) continue;
            const number weight = weights[o];
            if (motors == 1) add_square(blocks, weight, w->C + o * blocks, 0, n, H);
            add_controls(motors, blocks, weight, w->E, w->direct, o, w->C + o * blocks, 0, n, hu, r);
        }
        for (int j = t ? 1 : 0; j < m; j++) {
            const number size = sigma[j] * w->d_size[j];
            const lanes *c = w->G + j * blocks;
            add_square(blocks, sigma[j], c, w->from[j], w->to[j], H);
            add_controls(motors, blocks, sigma[j], w->d, w->moves, j, c, w->from[j], w->to[j], hu, r);
            if (t && w->moves[j]) heu += size * w->d[j];
            if (t && w->sizes[j]) {
                add(blocks, size, c, he);
                hee += size * w->d_size[j];
            }
        }
        if (t) {
            lanes *gain_e = w->Ke + k * blocks;
            number *gain_e_th = w->Keth + k * t;
            if (!keeps(w, &hee)) return TR_BREAKDOWN;
            const number inverse = 1.0 / hee, Ke_u = -heu * inverse;
            w->pivot_e[k] = inverse;
            w->Ke_u[k] = Ke_u;
            for (int j = 0; j < blocks; j++) gain_e[j] = -inverse * he[j];
            for (int j = 0; j < t; j++) gain_e_th[j] = -he_th[j] * inverse;
            add(blocks, Ke_u, he, hu);
            add_product(blocks, he, gain_e, H);
            for (int j = 0; j < t; j++) {
                hu_th[j] += Ke_u * he_th[j];
                add(blocks, gain_e_th[j], he, HQ + j * blocks);
                for (int i = 0; i < t; i++) HR[i * t + j] += he_th[i] * gain_e_th[j];
            }
            r[0] += heu * Ke_u;
        }
        if (k >= q->free_stages) {
            for (int c = 0; c < motors; c++)
                for (int i = c + 1; i < motors; i++) r[c * motors + i] = r[i * motors + c];
            for (int i = 0; i < ld; i++) {
                number f[MOST_MOTORS], g[MOST_MOTORS];
                for (int c = 0; c < motors; c++) f[c] = AT(gains + c * blocks, i);
                for (int c = 0; c < motors; c++) {
                    g[c] = AT(hu + c * blocks, i);
                    for (int l = 0; l < motors; l++) g[c] += f[l] * r[c * motors + l];
                }
                for (int j = 0; j < LOWER(i, blocks); j++) {
                    lanes sum = H[i * blocks + j];
                    if (motors > 1) sum += squares[i * blocks + j];
                    for (int c = 0; c < motors; c++) sum += f[c] * hu[c * blocks + j] + g[c] * gains[c * blocks + j];
                    P[i * blocks + j] = sum;
                }
            }
            for (int j = 0; j < t; j++) add(blocks, hu_th[j], gains, HQ + j * blocks);
        } else {
            for (int c = motors - 1; c >= 0; c--) {
                number *pivot = w->pivot + (k * motors + c) * motors;
                if (!keeps(w, &r[c * motors + c])) return TR_BREAKDOWN;
                pivot[c] = 1.0 / r[c * motors + c];
                for (int j = 0; j < blocks; j++) gains[c * blocks + j] = -pivot[c] * hu[c * blocks + j];
                for (int i = 0; i < c; i++) {
                    pivot[i] = -pivot[c] * r[c * motors + i];
                    add(blocks, pivot[i], hu + c * blocks, hu + i * blocks);
                    for (int l = 0; l <= i; l++) r[i * motors + l] += pivot[i] * r[c * motors + l];
                }
            }
            for (int i = 0; i < ld; i++)
                for (int j = 0; j < LOWER(i, blocks); j++) {
                    lanes sum = H[i * blocks + j];
                    if (motors > 1) sum += squares[i * blocks + j];
                    for (int c = 0; c < motors; c++) sum += AT(hu + c * blocks, i) * gains[c * blocks + j];
                    P[i * blocks + j] = sum;
                }
            for (int j = 0; j < t; j++) {
                w->Kth[k * t + j] = -hu_th[j] * w->pivot[k];
                add(blocks, hu_th[j], gains, HQ + j * blocks);
            }
            for (int i = 0; i < t; i++)
                for (int j = 0; j < t; j++) HR[i * t + j] += hu_th[i] * w->Kth[k * t + j];
        }
        if (ENTRIES > 1) { /* a pair's own two */
            for (int i = 1; i < n; i += 2) P[(i - 1) * blocks + i] = P[i * blocks + i - 1];
        } else if (k % SYMMETRISED == 0) {
            for (int i = 1; i < n; i++)
                for (int j = 0; j < i; j++) AT(P, i * ld + j) = AT(P, j * ld + i);
        }
        for (int j = 0; j < t; j++) {
            for (int i = 0; i < blocks; i++) Q[j * blocks + i] = HQ[j * blocks + i];
            for (int i = 0; i <= j; i++) R[i * t + j] = R[j * t + i] = HR[i * t + j];
        }
        if (w->cost_at_cut && k == w->cut) memcpy(w->cost_at_cut, P, (size_t)(ld * blocks) * sizeof(lanes));
        if (end) backward_stage(n, motors, blocks, w, t, k, 1, w->offset, w->offset_e, 1, &costate);
    }
    if (end) memcpy(w->p0, costate.th, (size_t)t * sizeof(number));
    memcpy(w->P0, R, (size_t)(t * t) * sizeof(number));
    return 0;
}

/* One row of d u. */
ALWAYS_INLINE number by_controls(const int motors, const number *d, const int row, const number *u)
{
    number sum = d[row * motors] * u[0];
    for (int i = 1; i < motors; i++) sum += d[row * motors + i] * u[i];
    return sum;
}

/* Forward by the gains from x_0 = 0 and th_0 = `th`: what a step changes, to first order. */
ALWAYS_INLINE void forward_sized(const int n, const int motors, const int t, const int blocks, tr_work *w,
                                 const number *start, const number *restrict offset, const number *restrict offset_e,
                                 const int full)
{
    const tr_problem *q = w->q;
    const int N = q->stages, m = q->rows, first = n - motors;
    lanes x[MOST_BLOCKS], next[MOST_BLOCKS];
    number th[MOST_NODES] = {0};
    memset(x, 0, sizeof x);
    for (int i = 0; i < t; i++) th[i] = start[i];
    for (int k = 0; k < N; k++) {
        number u[MOST_MOTORS] = {0}, e = {0};
        for (int c = 0; c < motors; c++) {
            const int at = k * motors + c;
            u[c] = offset[at];
            for (int j = 0; j < t; j++) u[c] += w->Kth[k * t + j] * th[j];
            u[c] += dot(blocks, w->K + at * blocks, x);
            for (int j = 0; j < c; j++) u[c] += w->pivot[at * motors + j] * u[j];
        }
        if (t) {
            e = offset_e[k] + w->Ke_u[k] * u[0];
            for (int j = 0; j < t; j++) e += w->Keth[k * t + j] * th[j];
            e += dot(blocks, w->Ke + k * blocks, x);
        }
        const number command = AT(x, first) + u[0];
        number current = {0};
        if (q->current >= 0) current = AT(x, q->current);
        if (full) {
            for (int c = 0; c < motors; c++) w->du[k * motors + c] = u[c];
            if (t) w->de[k] = e, w->d_current[k] = current, w->d_command[k] = command;
            for (int o = 0; o < q->outputs; o++)
                if (w->tracked[k * q->outputs + o])
                    w->d_error[k * q->outputs + o] = by_controls(motors, w->E, o, u) + dot(blocks, w->C + o * blocks, x);
            if (t) AT(w->dV, k * m) = th[0];
            for (int i = t ? 1 : 0; i < m; i++) {
                number v = by_controls(motors, w->d, i, u) + w->d_size[i] * e;
                for (int j = w->from[i]; j < w->to[i]; j++) v += AT(w->G + i * blocks, j) * AT(x, j);
                AT(w->dV, k * m + i) = v;
            }
        }
        if (t) {
            const number *heat = w->heat + 4 * k;
            const number h = heat[0] * current + heat[1] * command + heat[3] * th[0] + 2.0 * w->ripple * heat[2] * e;
            number th_next[MOST_NODES];
            for (int i = 0; i < t; i++) {
                th_next[i] = w->b[i] * h;
                for (int j = 0; j < t; j++) th_next[i] += w->M[i * t + j] * th[j];
            }
            for (int i = 0; i < t; i++) th[i] = th_next[i];
        }
        flow(first, motors, blocks, w, x, u, next);
        for (int j = 0; j < blocks; j++) x[j] = next[j];
    }
    for (int j = 0; full && j < q->ends; j++) w->d_end_error[j] = dot(blocks, w->Z + j * blocks, x);
    if (full && t) AT(w->dV, N * m) = th[0];
    for (int i = t ? 1 : 0; full && i < m; i++) {
        number v = {0};
        for (int j = w->from[i]; j < w->to[i]; j++) v += AT(w->G + i * blocks, j) * AT(x, j);
        AT(w->dV, N * m + i) = v;
    }
    for (int i = 0; i < t; i++) w->th_end[i] = th[i];
}

/* Where the length of a row of states is known when compiled, rows stay in registers: few lengths serve all numbers of
 * states. Side by side a row has no padding, and the number is known with it. Registers of eight are for the lengths
 * that fill them. A program that solves few problems, such as one for sanitizers, may say which lengths it SOLVES: the
 * others are then left to the code for any.
 */
#if !defined(SOLVES)
#define SOLVES(ld, motors, t) 1
#endif
#define KNOWN_STATES(ld) (ENTRIES > 1 ? (ld) : w->q->states)
#define OF_LENGTH(ld, motors, t, call)                               \
    if (SOLVES(ld, motors, t) && KNOWN_STATES(ld) == w->q->states) { \
        call(KNOWN_STATES(ld), motors, t, (ld) / PER);               \
    }                                                                \
    break
#if ENTRIES > 1
#define KNOWN_LENGTHS(call)               \
    case 1006: OF_LENGTH(6, 1, 0, call);  \
    case 1008: OF_LENGTH(8, 1, 0, call);  \
    case 1010: OF_LENGTH(10, 1, 0, call); \
    case 3030: OF_LENGTH(30, 3, 0, call)
#elif WIDTH > 4
#define KNOWN_LENGTHS(call)               \
    case 1008: OF_LENGTH(8, 1, 0, call);  \
    case 1108: OF_LENGTH(8, 1, 1, call);  \
    case 1208: OF_LENGTH(8, 1, 2, call);  \
    case 1216: OF_LENGTH(16, 1, 2, call)
#else
#define KNOWN_LENGTHS(call)               \
    case 1004: OF_LENGTH(4, 1, 0, call);  \
    case 1008: OF_LENGTH(8, 1, 0, call);  \
    case 1012: OF_LENGTH(12, 1, 0, call); \
    case 1108: OF_LENGTH(8, 1, 1, call);  \
    case 1112: OF_LENGTH(12, 1, 1, call); \
    case 1208: OF_LENGTH(8, 1, 2, call);  \
    case 1212: OF_LENGTH(12, 1, 2, call); \
    case 1216: OF_LENGTH(16, 1, 2, call)
#endif
#define BY_LENGTH(call)                                              \
    switch (w->q->motors * 1000 + NODES(w->q) * 100 + w->ld) {       \
    KNOWN_LENGTHS(call);                                             \
    }
/* Each for any number of states is a function of its own, whose registers the compiler assigns without regard to others. */
#define OF_ANY_SIZE(type, name, parameters, call)                                                           \
    NEVER_INLINE type name##_of_one parameters { call(w->q->states, 1, NODES(w->q), w->ld / PER); }         \
    NEVER_INLINE type name##_of_three parameters { call(w->q->states, 3, 0, w->ld / PER); }                 \
    NEVER_INLINE type name##_of_any parameters { call(w->q->states, w->q->motors, 0, w->ld / PER); }
#define ANY_SIZE(name) (w->q->motors == 1 ? name##_of_one : w->q->motors == 3 ? name##_of_three : name##_of_any)
#define FACTOR(n, motors, t, blocks) return factor_sized(n, motors, t, blocks, w, curved, end)
#define BACKWARD(n, motors, t, blocks) \
    backward_sized(n, motors, t, blocks, w, end, own, offset, offset_e, newton); return
#define FORWARD(n, motors, t, blocks) forward_sized(n, motors, t, blocks, w, start, offset, offset_e, full); return

OF_ANY_SIZE(int, factor, (tr_work *w, int curved, const number *end), FACTOR)

static int factor(tr_work *w, int curved, const number *end)
{
    BY_LENGTH(FACTOR)
    return ANY_SIZE(factor)(w, curved, end);
}

OF_ANY_SIZE(void, backward,
            (tr_work *w, const number *end, int own, number *offset, number *offset_e, int newton), BACKWARD)

static void backward(tr_work *w, const number *end, int own, number *offset, number *offset_e, int newton)
{
    BY_LENGTH(BACKWARD)
    ANY_SIZE(backward)(w, end, own, offset, offset_e, newton);
}

OF_ANY_SIZE(void, forward,
            (tr_work *w, const number *start, const number *offset, const number *offset_e, int full), FORWARD)

static void forward(tr_work *w, const number *start, const number *offset, const number *offset_e, int full)
{
    BY_LENGTH(FORWARD)
    ANY_SIZE(forward)(w, start, offset, offset_e, full);
}

/* Temperatures and their derivatives along the horizon, from currents, commands, sizes and th_0. */
static void roll_heat(tr_work *w)
{
    const tr_problem *q = w->q;
    const int t = NODES(q);
    if (!t) return;
    const number e1 = w->decay, e2 = 1.0 - e1, *s = w->square;
    for (int k = 0; k < q->stages; k++) {
        const number *th = w->theta + k * t, a = w->current[k], b = e1 * a + e2 * w->command[k];
        number *heat = w->heat + 4 * k, *after = w->theta + (k + 1) * t;
        const number by_a = 2.0 * s[0] * a + s[1] * b, by_b = s[1] * a + 2.0 * s[2] * b;
        const number h = s[0] * a * a + s[1] * a * b + s[2] * b * b + w->ripple * (2.0 * w->e[k] + w->ripple);
        const number resistance = w->gain[k] + w->copper * th[0];
        heat[0] = resistance * (by_a + e1 * by_b);
        heat[1] = resistance * e2 * by_b;
        heat[2] = resistance;
        heat[3] = w->copper * h;
        for (int i = 0; i < t; i++) {
            after[i] = w->b[i] * resistance * h;
            for (int j = 0; j < t; j++) after[i] += w->M[i * t + j] * th[j];
        }
    }
    for (int k = 0; k <= q->stages; k++) AT(w->V, k * q->rows) = w->theta[k * t];
}

/* th_0 - F th_N - f. */
static void closure_residual(const tr_work *w, number *residual)
{
    const tr_problem *q = w->q;
    const int t = NODES(q);
    for (int i = 0; i < t; i++) {
        residual[i] = w->theta[i] - w->f[i];
        for (int j = 0; j < t; j++) residual[i] -= w->F[i * t + j] * w->theta[q->stages * t + j];
    }
}

/* Gradient of the closure's term by th_N. */
static void closure_price(const tr_work *w, const number *eta, number *end)
{
    const tr_problem *q = w->q;
    const number nothing = {0};
    for (int j = 0; j < NODES(q); j++) {
        end[j] = nothing;
        for (int i = 0; REPEATED(q) && i < NODES(q); i++) end[j] -= w->F[i * NODES(q) + j] * eta[i];
    }
}

/* What one unit of th_0 and of the closure's multiplier does, with the gains of the last factorisation. */
static void close_course(tr_work *w)
{
    const tr_problem *q = w->q;
    const int t = NODES(q), N = q->stages, c = 2 * t;
    static const number nothing[MOST_NODES];
    number end[MOST_NODES], unit[MOST_NODES], *E = w->closing;
    for (int j = 0; j < t; j++) {
        for (int i = 0; i < t; i++) unit[i] = nothing[0] + (i == j ? 1.0 : 0.0);
        closure_price(w, unit, end);
        backward(w, end, 0, w->unit_offset + j * N, w->unit_offset_e + j * N, 1);
        for (int i = 0; i < t; i++) E[i * c + t + j] = w->p0[i] + unit[i];
        forward(w, nothing, w->unit_offset + j * N, w->unit_offset_e + j * N, 0);
        for (int i = 0; i < t; i++) {
            E[(t + i) * c + t + j] = nothing[0];
            for (int l = 0; l < t; l++) E[(t + i) * c + t + j] -= w->F[i * t + l] * w->th_end[l];
        }
        forward(w, unit, w->still, w->still, 0);
        for (int i = 0; i < t; i++) {
            E[i * c + j] = w->P0[i * t + j];
            E[(t + i) * c + j] = unit[i];
            for (int l = 0; l < t; l++) E[(t + i) * c + j] -= w->F[i * t + l] * w->th_end[l];
        }
    }
}

/* One Newton step for the gradients in `y`; `begun`, where the factorisation has taken its costate along. */
static void newton(tr_work *w, int begun)
{
    const tr_problem *q = w->q;
    const int t = NODES(q), N = q->stages;
    number end[MOST_NODES] = {0}, right[2 * MOST_NODES];
    static const number nothing[MOST_NODES];
    if (!begun) {
        closure_price(w, w->eta, end);
        backward(w, end, 1, w->offset, w->offset_e, 1);
    }
    if (!REPEATED(q)) {
        forward(w, nothing, w->offset, w->offset_e, 1);
        return;
    }
    for (int i = 0; i < t; i++) right[i] = -w->p0[i] - w->eta[i];
    forward(w, nothing, w->offset, w->offset_e, 0);
    closure_residual(w, right + t);
    for (int i = 0; i < t; i++) {
        right[t + i] = -right[t + i];
        for (int j = 0; j < t; j++) right[t + i] += w->F[i * t + j] * w->th_end[j];
    }
    eliminate(2 * t, (const double *)w->closing, (double *)right); /* of one problem */
    for (int j = 0; j < t; j++) {
        w->d_start[j] = right[j], w->d_eta[j] = right[t + j];
        for (int k = 0; k < N; k++) {
            w->offset[k] += right[t + j] * w->unit_offset[j * N + k];
            w->offset_e[k] += right[t + j] * w->unit_offset_e[j * N + k];
        }
    }
    forward(w, w->d_start, w->offset, w->offset_e, 1);
}

static number cost(const tr_work *w)
{
    const tr_problem *q = w->q;
    number twice = {0};
    for (int k = 0; k < q->stages; k++) {
        for (int c = k * q->motors; c < (k + 1) * q->motors; c++) twice += w->movement_weight * w->u[c] * w->u[c];
        for (int o = 0; o < q->outputs; o++) {
            const number e = w->error[k * q->outputs + o];
            twice += w->weight[k * q->outputs + o] * e * e;
        }
    }
    for (int j = 0; j < q->ends; j++) twice += w->end_error[j] * w->end_error[j];
    return 0.5 * twice + w->constant;
}

static void move(int count, const number step, const number *restrict by, number *restrict what)
{
    for (int i = 0; i < count; i++) what[i] += step * by[i];
}

/* Move everything but slacks and multipliers by a part of the Newton step. */
static void advance(tr_work *w, const number step)
{
    const tr_problem *q = w->q;
    const int N = q->stages;
    move(N * q->motors, step, w->du, w->u);
    if (NODES(q)) {
        move(N, step, w->de, w->e);
        move(N, step, w->d_current, w->current), move(N, step, w->d_command, w->command);
    }
    move(N * q->outputs, step, w->d_error, w->error);
    move(q->ends, step, w->d_end_error, w->end_error);
    for (int i = 0; i < w->blocks; i++) w->V[i] += step * w->dV[i];
    if (REPEATED(q))
        for (int i = 0; i < NODES(q); i++) w->theta[i] += step * w->d_start[i], w->eta[i] += step * w->d_eta[i];
    roll_heat(w);
}

/* Start at rest, where symmetric limits have all their room, slacks and multipliers well inside. Returns the number of
 * limits. */
static number begin(tr_work *w)
{
    const tr_problem *q = w->q;
    const int N = q->stages, rows = (N + 1) * q->rows;
    static const number nothing[MOST_NODES];
    int moves = NODES(q) > 0;
    for (int at = q->free_stages * q->motors, from = at; at < N * q->motors; at++) {
        w->offset[at] = w->rule_offset[at - from];
        for (int e = 0; e < ENTRIES; e++) moves = moves || EACH(w->offset[at], e) != 0.0;
    }
    if (NODES(q))
        for (int k = 0; k < N; k++) w->offset_e[k] = nothing[0] + 1.0;
    if (moves) {
        forward(w, nothing, w->offset, w->offset_e, 1);
        advance(w, nothing[0] + 1.0);
    }
    for (int i = 0; i < N * q->outputs; i++) w->error[i] -= w->reference[i];
    for (int j = 0; j < q->ends; j++) w->end_error[j] -= w->end_target[j];
    number count = {0};
    for (tr_side *z = w->side; z < w->side + 2; z++)
        for (int i = 0; i < rows; i++) count += AT(z->there, i);
    const number product = FIRST_GAP * at_least(cost(w), nothing[0] + 1.0) / at_least(count, nothing[0] + 1.0);
    for (tr_side *z = w->side; z < w->side + 2; z++)
        for (int i = 0; i < rows; i++) {
            const number there = AT(z->there, i), room = z->sign * (AT(w->V, i) - AT(z->bound, i));
            AT(z->s, i) = there * at_least(room, nothing[0] + 0.1) + (1.0 - there);
            AT(z->l, i) = there * product / AT(z->s, i);
        }
    return count;
}

/* Steps of a slack and of its multiplier that belong to the Newton step; the predictor's are those to `aim` = 0. */
#define SLACK_STEP(z, i) ((z)->there[i] * ((z)->sign * w->dV[i] + (z)->residual[i]))
#define TARGET(z, i) ((z)->there[i] * (level - (z)->cross[i]))

/* Move slacks and multipliers by a part of the step whose corrector aimed at `level`. Residuals and inverses of the slacks; weights and
 * gradients of the rows for the next predictor, which aims at s l = 0. */
static void move_slacks(tr_work *w, const number level, const number step, tr_state *found)
{
    lanes sum = {0}, most = {0};
    for (int i = 0; i < w->blocks; i++) {
        lanes sigma = {0}, y = {0};
        for (const tr_side *z = w->side; z < w->side + 2; z++) {
            const lanes ds = SLACK_STEP(z, i), dl = z->l[i] * (-ds * z->inverse[i] - 1.0) + TARGET(z, i) * z->inverse[i];
            const lanes s = z->s[i] + step * ds, l = z->l[i] + step * dl, inverse = 1.0 / s, weight = l * inverse;
            const lanes residual = z->there[i] * (z->sign * (w->V[i] - z->bound[i]) - s);
            z->s[i] = s, z->l[i] = l, z->inverse[i] = inverse, z->residual[i] = residual;
            sum += s * l;
            raise_to(&most, residual);
            raise_to(&most, -residual);
            sigma += weight;
            y += z->sign * (weight * residual);
        }
        w->sigma[i] = sigma;
        w->y[i] = y;
    }
    found->complementarity = total(&sum);
    found->residual = largest(&most);
}

/* Where the iterate stands, its slacks and multipliers moved by `step`; leaves the gradient by the movements in `offset` and the heat's prices. */
static tr_state judge(tr_work *w, const number level, const number step)
{
    const tr_problem *q = w->q;
    const int N = q->stages;
    const number nothing = {0};
    tr_state found = {nothing, nothing, nothing, cost(w)};
    number end[MOST_NODES] = {0}, closure[MOST_NODES], command[MOST_MOTORS] = {0};
    lanes sum = {0};
    move_slacks(w, level, step, &found);
    closure_price(w, w->eta, end);
    backward(w, end, 1, w->offset, w->offset_e, 0);
    for (int at = 0, free = q->free_stages * q->motors; at < free; at++) {
        const number after = at + q->motors < free ? w->offset[at + q->motors] : nothing;
        number *held = command + at % q->motors;
        *held += w->u[at];
        AT(&sum, at % PER) += absolute(w->offset[at] - after) * (w->command_bound + absolute(*held));
    }
    for (int k = 0; NODES(q) && k < N; k++) AT(&sum, k % PER) += 2.0 * absolute(w->offset_e[k]);
    found.stationarity = total(&sum);
    if (REPEATED(q)) {
        closure_residual(w, closure);
        for (int i = 0; i < NODES(q); i++) {
            found.residual = at_least(absolute(closure[i]), found.residual);
            found.stationarity += absolute(w->p0[i] + w->eta[i]);
        }
    }
    return found;
}

/* The longest part, at most 1, of a step that leaves `rest` of each slack and multiplier. */
ALWAYS_INLINE number longest(const lanes *fastest, const number rest)
{
    return (1.0 - rest) / largest(fastest);
}

/* The predictor's steps. Returns what the corrector aims at (Mehrotra): the cube of what the longest step leaves of the
 * mean product, but not below `least`. */
static number predict(tr_work *w, const number product, const number count, const number least)
{
    const number whole = {0};
    lanes fastest = {0}, first = {0}, second = {0}; /* fall relative to the value; parts of the products by the step */
    fastest += 1.0;
    for (int i = 0; i < w->blocks; i++)
        for (const tr_side *z = w->side; z < w->side + 2; z++) {
            const lanes ds = SLACK_STEP(z, i), of_s = -ds * z->inverse[i], of_l = 1.0 - of_s;
            const lanes dl = -z->l[i] * of_l, cross = ds * dl;
            z->cross[i] = cross;
            first += z->s[i] * dl + z->l[i] * ds;
            second += cross;
            raise_to(&fastest, of_s);
            raise_to(&fastest, of_l);
        }
    const number step = longest(&fastest, whole), mean = product / count;
    const number ratio = (product + step * (total(&first) + step * total(&second))) / product;
    return at_least(ratio * ratio * ratio * mean, least);
}

/* Gradients of the rows for a step that aims at s l = `level`, less what the predictor's steps add to it. */
static void aim(tr_work *w, const number level)
{
    const tr_side *low = w->side, *up = low + 1;
    for (int i = 0; i < w->blocks; i++)
        w->y[i] += TARGET(up, i) * up->inverse[i] - TARGET(low, i) * low->inverse[i];
}

/* The longest part of the corrector's step that leaves `rest` of each slack and multiplier. */
static number correct(const tr_work *w, const number level, const number rest)
{
    lanes fastest = {0};
    fastest += 1.0 - rest;
    for (int i = 0; i < w->blocks; i++)
        for (const tr_side *z = w->side; z < w->side + 2; z++) {
            const lanes of_s = -SLACK_STEP(z, i) * z->inverse[i];
            const lanes of_l = -(z->l[i] * (of_s - 1.0) + TARGET(z, i) * z->inverse[i]) / (z->l[i] + LEAST);
            raise_to(&fastest, of_s);
            raise_to(&fastest, of_l);
        }
    return longest(&fastest, rest);
}

/* Copy an array onto another one, for the `chosen` problems. */
static void blend(size_t count, const int *chosen, const number *from, number *to)
{
#if ENTRIES > 1
    choice these;
    for (int e = 0; e < ENTRIES; e++) these[e] = -(long long)chosen[e];
    for (size_t i = 0; i < count; i++) to[i] = CHOSEN(these, from[i], to[i]);
#else
    if (chosen[0]) memcpy(to, from, count * sizeof(number));
#endif
}

/* Keep the iterate that `judge` has just measured, for the `chosen` problems. */
static void keep(tr_work *w, const tr_state *now, const int *chosen)
{
    const tr_problem *q = w->q;
    const size_t N = (size_t)q->stages, rows = (N + 1) * (size_t)q->rows;
    const number gap = now->complementarity + now->stationarity;
    blend(N * (size_t)q->motors, chosen, w->u, w->kept_movement);
    blend(N * (size_t)q->motors, chosen, w->offset, w->kept_gradient);
    if (NODES(q)) blend(N, chosen, w->e, w->kept_size), blend((size_t)NODES(q), chosen, w->theta, w->kept_start);
    blend(rows, chosen, (const number *)w->side[0].l, (number *)w->kept_lower);
    blend(rows, chosen, (const number *)w->side[1].l, (number *)w->kept_upper);
    blend(1, chosen, &now->objective, &w->kept_objective);
    blend(1, chosen, &gap, &w->kept_gap);
    blend(1, chosen, &now->residual, &w->kept_residual);
}

/* Hand out what was kept. */
static void deliver(const tr_work *w, tr_result *const *results)
{
    const tr_problem *q = w->q;
    const size_t N = (size_t)q->stages, rows = (N + 1) * (size_t)q->rows;
    for (int e = 0; e < ENTRIES; e++) {
        tr_result *r = results[e];
        double command[MOST_MOTORS] = {0};
        for (size_t at = 0; at < N * (size_t)q->motors; at++) {
            r->command[at] = command[at % (size_t)q->motors] += EACH(w->kept_movement[at], e);
            r->gradient[at] = EACH(w->kept_gradient[at], e);
        }
        for (size_t k = 0; NODES(q) && k < N; k++) r->size[k] = EACH(w->kept_size[k], e);
        for (size_t i = 0; i < rows; i++)
            r->lower[i] = EACH(AT(w->kept_lower, i), e), r->upper[i] = EACH(AT(w->kept_upper, i), e);
        for (int i = 0; i < NODES(q); i++) r->start[i] = EACH(w->kept_start[i], e);
        r->objective = EACH(w->kept_objective, e);
        r->gap = EACH(w->kept_gap, e);
        r->residual = EACH(w->kept_residual, e);
    }
}

/* State of the search for one problem. */
typedef struct {
    double best; /* measure of the best iterate, in units of the tolerance */
    int since;   /* iterations since then */
    int ended;
} tr_course;

/* End the search for one problem; its answer is not changed by later iterates. */
static void end_with(tr_course *course, tr_result *r, int code, int iterations)
{
    course->ended = 1;
    r->code = code;
    r->iterations = iterations;
}

/* Whether an iterate is to be kept, and whether the search ends with it. */
static int follow(tr_course *course, tr_result *r, const tr_options *options, const tr_state *now, int e, int iterations)
{
    const double allowed = options->tolerance * fmax(EACH(now->objective, e), 1.0);
    const double gap = (EACH(now->complementarity, e) + EACH(now->stationarity, e)) / allowed;
    const double residual = EACH(now->residual, e), measure = fmax(gap, residual / options->tolerance);
    const int number_found = gap < INFINITY && residual < INFINITY;
    if (number_found && measure < course->best) course->best = measure, course->since = 0;
    const int near = course->best <= NEAR, better = number_found && (course->since == 0 || !near);
    if (number_found && measure <= 1.0)
        end_with(course, r, TR_SOLVED, iterations);
    else if (near && (!number_found || course->since >= PATIENCE))
        end_with(course, r, TR_ACCURACY, iterations);
    else if (!number_found)
        end_with(course, r, TR_BREAKDOWN, iterations);
    else if (course->since >= LOST)
        end_with(course, r, TR_STALLED, iterations);
    else if (iterations >= options->max_iterations)
        end_with(course, r, near ? TR_ACCURACY : TR_ITERATION_LIMIT, iterations);
    course->since++;
    return better;
}

/* The gains of a step, and its costate where no closure comes in between. Returns TR_INTERRUPTED, or 0. */
static int factored(tr_work *w)
{
    number end[MOST_NODES] = {0};
    closure_price(w, w->eta, end);
    const number *along = REPEATED(w->q) ? NULL : end;
    int failed = factor(w, 1, along);
    if (failed == TR_BREAKDOWN && NODES(w->q)) failed = factor(w, 0, along);
    if (failed == TR_INTERRUPTED) return failed;
    if (REPEATED(w->q) && !failed) close_course(w);
    return 0;
}

/* Whether the search has ended for all problems; the step of those that have ended is set to zero. */
static int all_ended(const tr_course *course, number *step)
{
    int ended = 0;
    for (int e = 0; e < ENTRIES; e++)
        if (course[e].ended) EACH(*step, e) = 0.0, ended++;
    return ended == ENTRIES;
}

static int solve(const tr_problem *const *all, const tr_options *options, double *space, tr_result *const *r, tr_watch *watch)
{
    tr_work work, *w = &work;
    tr_course course[ENTRIES];
    const number nothing = {0};
    number step = {0}, level = {0};
    prepare(w, all, space, watch);
    number count = begin(w);
    w->limited = any(count);
    count = at_least(count, nothing + 1.0);
    for (int e = 0; e < ENTRIES; e++) course[e].best = INFINITY, course[e].since = course[e].ended = 0;
    for (int iterations = 0;; iterations++) {
        const tr_state now = judge(w, level, step);
        int better[ENTRIES], kept = 0;
        for (int e = 0; e < ENTRIES; e++)
            kept |= better[e] = !course[e].ended && follow(course + e, r[e], options, &now, e, iterations);
        if (kept) keep(w, &now, better);
        if (all_ended(course, &step)) break;
        if (tr_interrupted(watch)) return TR_INTERRUPTED;
        if (factored(w)) return TR_INTERRUPTED;
        for (int e = 0; e < ENTRIES; e++)
            if (!course[e].ended && EACH(w->sound, e) == 0.0)
                end_with(course + e, r[e], course[e].best <= NEAR ? TR_ACCURACY : TR_BREAKDOWN, iterations);
        if (all_ended(course, &step)) break;
        newton(w, !REPEATED(w->q));
        if (w->limited) {
            const number allowed = options->tolerance * at_least(now.objective, nothing + 1.0);
            level = predict(w, now.complementarity, count, LAST_GAP * allowed / count);
            aim(w, level);
            newton(w, 0);
        }
        /* Steps go closer to the limits as the gap falls: the last iterations then gain more than two digits each. Not
         * with temperatures: the two rows of a size share a multiplier, and only a centred iterate determines how. */
        number rest = nothing + FARTHEST;
        for (int e = 0; e < ENTRIES && !NODES(w->q); e++) {
            const double left = NEARNESS * EACH(now.complementarity, e) / fmax(EACH(now.objective, e), 1.0);
            EACH(rest, e) = fmin(FARTHEST, fmax(left, NEAREST));
        }
        step = correct(w, level, rest);
        for (int e = 0; e < ENTRIES; e++)
            if (!course[e].ended && !(EACH(step, e) > SHORTEST))
                end_with(course + e, r[e], course[e].best <= NEAR ? TR_ACCURACY : TR_STALLED, iterations);
        if (all_ended(course, &step)) break;
        advance(w, step);
    }
    deliver(w, r);
    return 0;
}

/* The optimum without limits: one Newton step from rest, and further ones with the same gains as refinement. `now` is of
 * the last iterate; the best one is kept. Returns TR_INTERRUPTED, or 0. */
static int pass(tr_work *w, double tolerance, tr_result *const *r, tr_state *now)
{
    tr_course course[ENTRIES];
    const number nothing = {0};
    number step;
    if (factor(w, 0, NULL) == TR_INTERRUPTED) return TR_INTERRUPTED;
    for (int e = 0; e < ENTRIES; e++) {
        course[e].best = INFINITY, course[e].ended = 0;
        if (EACH(w->sound, e) == 0.0) end_with(course + e, r[e], TR_BREAKDOWN, 0);
    }
    begin(w);
    for (int iterations = 1; step = nothing + 1.0, !all_ended(course, &step); iterations++) {
        int better[ENTRIES];
        newton(w, 0);
        advance(w, step);
        *now = judge(w, nothing, nothing);
        for (int e = 0; e < ENTRIES; e++) {
            double *best = &course[e].best;
            const int finite = EACH(now->objective, e) < INFINITY;
            better[e] = !course[e].ended && finite && EACH(now->stationarity, e) < *best;
            if (better[e]) *best = EACH(now->stationarity, e);
            if (course[e].ended) continue;
            if (*best <= tolerance * fmax(EACH(now->objective, e), 1.0))
                end_with(course + e, r[e], TR_SOLVED, iterations);
            else if (!better[e] || iterations > REFINEMENTS)
                end_with(course + e, r[e], *best < INFINITY ? TR_ACCURACY : TR_BREAKDOWN, iterations);
        }
        keep(w, now, better);
    }
    return 0;
}

static int linear(const tr_problem *const *all, double tolerance, double *space, tr_result *const *r, tr_watch *watch)
{
    tr_work work;
    tr_state now;
    prepare(&work, all, space, watch);
    if (pass(&work, tolerance, r, &now)) return TR_INTERRUPTED;
    deliver(&work, r);
    return 0;
}

/* Square root of each problem's number. */
static number root(const number of)
{
    number found;
    for (int e = 0; e < ENTRIES; e++) EACH(found, e) = sqrt(EACH(of, e));
    return found;
}

/* Cholesky factor Z (n, n) of the symmetric P = Z' Z (rows of ld numbers), by rows; a pivot that is zero up to rounding,
 * of a state without a cost, leaves a row of zeros. Returns y (n) with Z' y = p, the rows of zeros left out. */
static void root_of(int n, int ld, const number *P, const number *p, number *Z, number *y)
{
    const number nothing = {0};
    number most = nothing;
    for (int i = 0; i < n * n; i++) Z[i] = nothing;
    for (int i = 0; i < n; i++) most = at_least(P[i * ld + i], most);
    for (int i = 0; i < n; i++) {
        number left = P[i * ld + i], right = p[i];
        for (int l = 0; l < i; l++) left -= Z[l * n + i] * Z[l * n + i], right -= Z[l * n + i] * y[l];
        const number pivot = root(left), inverse = CHOSEN(left > NO_PIVOT * most, 1.0 / pivot, nothing);
        Z[i * n + i] = CHOSEN(left > NO_PIVOT * most, pivot, nothing), y[i] = right * inverse;
        for (int j = i + 1; j < n; j++) {
            number sum = P[j * ld + i]; /* of several problems the lower triangle alone is computed */
            if (ENTRIES == 1) sum = 0.5 * (sum + P[i * ld + j]);
            for (int l = 0; l < i; l++) sum -= Z[l * n + i] * Z[l * n + j];
            Z[i * n + j] = sum * inverse;
        }
    }
}

/* Doubles that `shortened` needs. */
static size_t shortened_workspace(const tr_problem *q)
{
    const size_t n = (size_t)q->states, ld = BLOCKS(n) * PER, m = ((size_t)q->stages + 1) * (size_t)q->rows;
    tr_problem head = *q;
    head.ends = q->states;
    return workspace(q) + workspace(&head) + ENTRIES * ((ld + 1) * ld + 2 * (n + 3) * n + 2 * m) + 4 * WIDTH;
}

/* For each problem the last stage, of those from `from` on, at which the movements take a row out of its bounds by more
 * than the tolerance; -1 if they keep them all. */
static void find_last(const tr_work *w, const tr_problem *const *all, int from, double tolerance, int *last)
{
    const int n = w->q->states, motors = w->q->motors, N = w->q->stages, m = all[0]->rows, blocks = w->ld / PER;
    lanes x[MOST_BLOCKS], next[MOST_BLOCKS];
    int begin[MOST_ENTRIES][MOST_ROWS], end[MOST_ENTRIES][MOST_ROWS]; /* of the states with the nonzeros of a row */
    memset(x, 0, sizeof x);
    for (int e = 0; e < ENTRIES; e++) {
        last[e] = -1;
        for (int i = 0; i < m; i++) {
            const double *g = all[e]->G + (size_t)i * (size_t)n;
            begin[e][i] = 0, end[e][i] = n;
            while (end[e][i] > 0 && g[end[e][i] - 1] == 0.0) end[e][i]--;
            while (begin[e][i] < end[e][i] && g[begin[e][i]] == 0.0) begin[e][i]++;
        }
    }
    for (int k = 0; k <= N; k++) {
        for (int e = 0; e < ENTRIES && k >= from; e++) {
            const tr_problem *q = all[e];
            for (int i = 0; i < m; i++) {
                double v = 0.0;
                for (int j = begin[e][i]; j < end[e][i]; j++) v += q->G[i * n + j] * EACH(AT(x, j), e);
                for (int c = 0; k < N && c < motors; c++) v += q->d[i * motors + c] * EACH(w->u[k * motors + c], e);
                /* What is not a number is outside. */
                if (!(v <= q->upper[k * m + i] + tolerance && v >= q->lower[k * m + i] - tolerance)) last[e] = k;
            }
        }
        if (k == N) break;
        flow(n - motors, motors, blocks, w, x, w->u + k * motors, next);
        copy(blocks, next, x);
    }
}

/* What a search before the cut does not see of its gap: the error of its costate at the cut, by the cost's root there,
 * on its way backward through the stages before. `costate` is that of the answer. */
static number unseen(const tr_work *w, const number *Z, const number *z, const lanes *costate)
{
    const int n = w->q->states, motors = w->q->motors, first = n - motors, blocks = w->ld / PER;
    lanes x[MOST_BLOCKS], off[MOST_BLOCKS], next[MOST_BLOCKS];
    number found = {0}, later[MOST_MOTORS] = {0};
    memset(x, 0, sizeof x);
    for (int k = 0; k < w->cut; k++) {
        flow(first, motors, blocks, w, x, w->u + k * motors, next);
        copy(blocks, next, x);
    }
    copy(blocks, costate, off);
    for (int i = 0; i < n; i++) {
        number left = -z[i];
        for (int j = i; j < n; j++) left += Z[i * n + j] * AT(x, j);
        for (int j = i; j < n; j++) AT(off, j) -= Z[i * n + j] * left;
    }
    for (int k = 0; k < w->cut; k++) {
        flow_back(first, motors, blocks, w, off, next);
        copy(blocks, next, off);
        for (int c = 0; c < motors; c++) {
            found += absolute(AT(off, first + c) - later[c]);
            later[c] = AT(off, first + c);
        }
    }
    return 2.0 * w->command_bound * found;
}

/* Search with limits that are stated before stage `cut` alone. From there on the optimum follows from the
 * state, and its cost is a square: a pass without limits gives both, and the search has `cut` stages. `last` says where
 * the answer leaves limits that are not stated (`find_last`); N where rounding in that cost takes its digits. */
static int shortened(const tr_problem *const *all, int cut, const tr_options *options, double *space, tr_result *const *r,
                     int *last, tr_watch *watch)
{
    tr_work work, *w = &work;
    tr_problem bare[ENTRIES], head[ENTRIES];
    const tr_problem *of_bare[ENTRIES], *of_head[ENTRIES], *q = all[0];
    const int n = q->states, motors = q->motors, first = n - motors, m = q->rows, N = q->stages;
    const int blocks = BLOCKS(n), ld = blocks * PER;
    static const number none[MOST_NODES];
    const number nothing = {0};
    lanes x[MOST_BLOCKS], next[MOST_BLOCKS];
    tr_state now;
    int unusable[ENTRIES], usable = 0;
    memset(x, 0, sizeof x);
    for (int e = 0; e < ENTRIES; e++) {
        bare[e] = head[e] = *all[e], of_bare[e] = bare + e, of_head[e] = head + e;
        bare[e].rows = bare[e].nodes = bare[e].repeated = 0;
        last[e] = N;
    }
    prepare(w, of_bare, space, watch);
    double *taken = space + workspace(bare);
    while ((uintptr_t)taken % (WIDTH * sizeof(double))) taken++;
    number *P = (number *)taken, *p = P + ld * ld, *Z = p + ld, *z = Z + n * n, *y = z + n;
    taken = (double *)(y + n);
    w->cut = cut, w->cost_at_cut = (lanes *)P, w->costate_at_cut = (lanes *)p;
    if (pass(w, options->tolerance, r, &now)) return TR_INTERRUPTED;
    for (int e = 0; e < ENTRIES; e++) unusable[e] = r[e]->code == TR_BREAKDOWN, usable = usable || !unusable[e];
    if (!usable) return 0;
    /* The rest's cost about the pass's own state x at the cut is |Z x_cut - z|^2 / 2 and a constant. */
    number constant = now.objective;
    for (int k = 0; k < cut; k++) {
        flow(first, motors, blocks, w, x, w->u + k * motors, next);
        copy(blocks, next, x);
        for (int c = k * motors; c < (k + 1) * motors; c++) constant -= 0.5 * w->movement_weight * w->u[c] * w->u[c];
        for (int o = k * q->outputs; o < (k + 1) * q->outputs; o++)
            constant -= 0.5 * w->weight[o] * w->error[o] * w->error[o];
    }
    root_of(n, ld, P, p, Z, y);
    for (int i = 0; i < n; i++) {
        z[i] = -y[i];
        for (int j = i; j < n; j++) z[i] += Z[i * n + j] * AT(x, j);
        constant -= 0.5 * y[i] * y[i];
    }
    for (int e = 0; e < ENTRIES; e++) {
        double *gain = taken, *target = gain + n * n, *lower = target + n, *upper = lower + (cut + 1) * m;
        taken = upper + (cut + 1) * m;
        for (int i = 0; i < n * n; i++) gain[i] = EACH(Z[i], e);
        for (int i = 0; i < n; i++) target[i] = EACH(z[i], e);
        /* At the cut itself only the temperature is limited: no other limit's value there is decided before it. */
        for (int i = 0; i < (cut + 1) * m; i++) {
            const int stated = i < cut * m || (NODES(q) && i == cut * m);
            lower[i] = stated ? all[e]->lower[i] : -INFINITY, upper[i] = stated ? all[e]->upper[i] : INFINITY;
        }
        head[e].constant = EACH(constant, e);
        head[e].stages = head[e].free_stages = cut, head[e].ends = n;
        head[e].end_gain = gain, head[e].end_target = target, head[e].lower = lower, head[e].upper = upper;
    }
    const int failed = solve(of_head, options, taken, r, watch);
    if (failed) return failed;
    /* What the search has moved, and by the pass's gains the rest. */
    memset(w->K, 0, (size_t)(cut * motors * ld) * sizeof(number));
    memset(w->pivot, 0, (size_t)(cut * motors * motors) * sizeof(number));
    memset(w->offset, 0, (size_t)(N * motors) * sizeof(number));
    for (int e = 0; e < ENTRIES; e++) {
        if (unusable[e]) r[e]->code = TR_BREAKDOWN;
        for (int at = 0; at < cut * motors; at++) {
            const double before = at < motors ? 0.0 : r[e]->command[at - motors];
            EACH(w->offset[at], e) = r[e]->command[at] - before - EACH(w->u[at], e);
        }
    }
    forward(w, none, w->offset, w->offset_e, 1);
    advance(w, nothing + 1.0);
    backward(w, none, 1, w->offset, w->offset_e, 0);
    for (int e = 0; e < ENTRIES; e++)
        for (int at = cut * motors; at < N * motors; at++) {
            r[e]->command[at] = (at < motors ? 0.0 : r[e]->command[at - motors]) + EACH(w->u[at], e);
            r[e]->gradient[at] = EACH(w->offset[at], e);
        }
    if (NODES(q)) return 0;
    find_last(w, all, cut, options->tolerance, last);
    const number left = unseen(w, Z, z, w->costate_at_cut);
    for (int e = 0; e < ENTRIES; e++)
        if (!(EACH(left, e) <= UNSEEN * fmax(r[e]->objective, 1.0))) last[e] = N;
    return 0;
}

/* A multiplier times the absolute slack; zero without a bound. */
ALWAYS_INLINE number paired_with(const number multiplier, const number slack)
{
    const number size = absolute(slack), nothing = {0};
    return CHOSEN((size < INFINITY) & (multiplier != 0.0), multiplier * size, nothing);
}

/* The larger of both; NaN is kept. */
ALWAYS_INLINE number largest_of(const number so_far, const number next)
{
    return CHOSEN((next > so_far) | (next != next), next, so_far);
}

static void prove(const tr_problem *const *all, double *space, tr_proof *const *proofs)
{
    tr_work work, *w = &work;
    const tr_problem *q = all[0];
    const int N = q->stages, m = q->rows, ny = q->outputs, n = q->states, motors = q->motors, first = n - motors;
    const int blocks = BLOCKS(n);
    const size_t stages = (size_t)N, bounds = stages * (size_t)m, ruled = (stages - (size_t)q->free_stages) * (size_t)motors;
    lanes x[MOST_BLOCKS], next[MOST_BLOCKS], p[MOST_BLOCKS], rule[MOST_BLOCKS];
    number slack = {0}, residual = {0}, dual_residual = {0}, by_command = {0}, by_movement = {0};
    number excess[MOST_ROWS], before[MOST_MOTORS] = {0}, later[MOST_MOTORS] = {0};
    size_t taken;
    int priced = 0;
    while ((uintptr_t)space % (WIDTH * sizeof(double))) space++;
    memset(w, 0, sizeof *w);
    lay_out(w, all, space);
    state(w);
    /* The certificate's arrays reuse the workspace that only a search needs. */
    taken = (size_t)((double *)w->V - space);
#define OF_PROOF(field, count) of_each((const void *const *)proofs, offsetof(tr_proof, field), count, space, &taken)
    const number *commands = OF_PROOF(command, stages * (size_t)motors), *by_rule = OF_PROOF(by_rule, ruled);
    const number *by_lower = OF_PROOF(by_lower, bounds), *by_upper = OF_PROOF(by_upper, bounds);
    const number *lower = OF_PROOF(lower, bounds), *upper = OF_PROOF(upper, bounds);
    for (int e = 0; e < ENTRIES; e++) priced = priced || proofs[e]->by_upper;
    memset(rule, 0, sizeof rule);
    memset(x, 0, sizeof x);
    memset(p, 0, sizeof p);
    for (int i = 0; i < m; i++) excess[i] = by_command - INFINITY;
    for (int k = 0; k < N; k++) {
        const number *command = commands + k * motors;
        number *u = w->u + k * motors;
        for (int c = 0; c < motors; c++) u[c] = command[c] - before[c], before[c] = command[c];
        for (int o = 0; o < ny; o++)
            w->error[k * ny + o] =
                by_controls(motors, w->E, o, u) + dot(blocks, w->C + o * blocks, x) - w->reference[k * ny + o];
        for (int i = 0; i < m; i++) {
            const int at = k * m + i;
            number v = by_controls(motors, w->d, i, u);
            for (int j = w->from[i]; j < w->to[i]; j++) v += AT(w->G + i * blocks, j) * AT(x, j);
            const number above = v - upper[at], below = lower[at] - v;
            excess[i] = largest_of(largest_of(excess[i], above), below);
            if (priced) slack += paired_with(by_upper[at], above) + paired_with(by_lower[at], below);
        }
        for (int c = 0; k >= q->free_stages && c < motors; c++) {
            const int at = (k - q->free_stages) * motors + c;
            memcpy(rule, w->rule_gain + at * n, (size_t)n * sizeof(number));
            const number left = absolute(u[c] - dot(blocks, rule, x) - w->rule_offset[at]);
            residual = largest_of(residual, left);
            slack += absolute(by_rule[at]) * left;
        }
        flow(first, motors, blocks, w, x, u, next);
        copy(blocks, next, x);
    }
    for (int j = 0; j < q->ends; j++) {
        w->end_error[j] = dot(blocks, w->Z + j * blocks, x) - w->end_target[j];
        add(blocks, w->end_error[j], w->Z + j * blocks, p);
    }
    const number objective = cost(w);
    for (int k = N - 1; k >= 0; k--) {
        number gradient[MOST_MOTORS];
        for (int c = 0; c < motors; c++)
            gradient[c] = dot(blocks, w->push + c * blocks, p) + w->movement_weight * w->u[k * motors + c];
        flow_back(first, motors, blocks, w, p, next);
        for (int o = 0; o < ny; o++) {
            const number by_error = w->weight[k * ny + o] * w->error[k * ny + o];
            for (int c = 0; c < motors; c++) gradient[c] += w->E[o * motors + c] * by_error;
            add(blocks, by_error, w->C + o * blocks, next);
        }
        for (int i = 0; priced && i < m; i++) {
            const number by_row = by_upper[k * m + i] - by_lower[k * m + i];
            for (int c = 0; c < motors; c++) gradient[c] += w->d[i * motors + c] * by_row;
            add(blocks, by_row, w->G + i * blocks, next);
        }
        for (int c = 0; k >= q->free_stages && c < motors; c++) {
            const int at = (k - q->free_stages) * motors + c;
            memcpy(rule, w->rule_gain + at * n, (size_t)n * sizeof(number));
            gradient[c] += by_rule[at];
            add(blocks, -by_rule[at], rule, next);
        }
        copy(blocks, next, p);
        /* A command enters its own movement with + and the next one with -. */
        for (int c = 0; c < motors; c++) {
            const number size = absolute(gradient[c] - later[c]);
            dual_residual = largest_of(dual_residual, size);
            by_command += size * (w->command_bound + absolute(commands[k * motors + c]));
            by_movement += gradient[c] * gradient[c];
            later[c] = gradient[c];
        }
    }
    by_movement /= 2.0 * w->movement_weight;
    for (int e = 0; e < ENTRIES; e++) {
        tr_proof *proof = proofs[e];
        for (int i = 0; i < m; i++) proof->excess[i] = EACH(excess[i], e);
        proof->objective = EACH(objective, e), proof->slack = EACH(slack, e), proof->residual = EACH(residual, e);
        proof->dual_residual = EACH(dual_residual, e), proof->by_command = EACH(by_command, e);
        proof->by_movement = EACH(by_movement, e);
    }
}

const tr_kernel KERNEL(WIDTH, ENTRIES) = {ENTRIES, workspace, solve, linear, prove, shortened_workspace, shortened};
#endif
