/* A primal-dual interior-point method over the stages of one transient.
 *
 *     minimise    1/2 sum_k w_k |C x_k + E u_k - r_k|^2 + 1/2 s u_k^2 + 1/2 |Z x_N - z|^2 + constant
 *     subject to  x_(k+1) = A x_k + A[:, n-1] u_k,  x_0 = 0,
 *                 th_(k+1) = M th_k + b (gain_k + copper th_w,k) h_k,  th_0 = 0 or th_0 = F th_N + f,
 *                 h_k = quadratic in (current, command) + 2 ripple e_k + ripple^2,
 *                 u_k = f_k' x_k + g_k over the last stages (the hand-over),
 *                 lower_k <= G x_k + d u_k + d_size e_k <= upper_k,  the winding th_w,k being the first row,
 *
 * k = 0..N-1 but for the rows and the temperatures, which are bounded at N as well, where u_N = e_N = 0.
 *
 * The movement u and the size e of the mean current are the controls; x_(n-1) is the command held before. Predictor and
 * corrector follow Mehrotra (SIAM J. Optim. 2, 1992); each Newton step is a Riccati recursion (Rao, Wright, Rawlings,
 * J. Optim. Theory Appl. 99, 1998), in which the size is eliminated before the movement. Where the states stand in pairs
 * that only the held command couples to others, as the modes of a device do, products with A have no more terms than
 * that: they are taken pair by pair. Every iterate obeys the dynamics exactly: states are rolled out, the reduced gradient comes from the adjoint recursion, so rounding in a
 * factorisation costs a step's quality and never the answer's.
 *
 * C99 without dependencies, no global state, no allocation: the caller gives the workspace. Compile with contraction of
 * floating-point expressions off. All arrays are row by row. A caller that may be interrupted is asked for it now and
 * then (`tr_host`).
 */
#if !defined(WIDTH)
#include <math.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>
#include <time.h>

enum { MOST_STATES = 96, MOST_NODES = 2, MOST_ROWS = 128 };

typedef struct {
    int stages, free_stages, states, outputs, ends, rows, nodes;
    int current;  /* state that is the current; -1: it is the command */
    int repeated; /* th_0 = F th_N + f */
    const double *A, *C, *E;                 /* (n, n), (outputs, n), (outputs) */
    const double *weight, *reference;        /* (N, outputs), both */
    const double *rule_gain, *rule_offset;   /* (N - free, n), (N - free) */
    const double *end_gain, *end_target;     /* Z (ends, n), z (ends): what the state at N still does */
    const double *G, *d, *d_size;            /* (rows, n), (rows), (rows) */
    const double *lower, *upper;             /* (N + 1, rows), infinite where there is no limit */
    const double *M, *b, *gain, *square;     /* (nodes, nodes), (nodes), (N), (3): i_k^2, i_k i_(k+1), i_(k+1)^2 */
    const double *F, *f;                     /* (nodes, nodes), (nodes) */
    double movement_weight, decay, ripple, copper;
    double command_bound;                    /* on |x_(n-1) + u|, for the gap */
    double constant;                         /* of the objective, which tolerances are relative to */
} tr_problem;

/* An interpreter whose lock the caller holds: the lock is let go while the method works, and taken back to ask whether
 * a signal ends the work. In CPython: PyEval_SaveThread, PyEval_RestoreThread, PyErr_CheckSignals.
 */
typedef struct {
    void *(*release)(void);
    void (*acquire)(void *thread);
    int (*interrupted)(void); /* not 0: stop */
} tr_host;

typedef struct {
    int max_iterations;
    double tolerance;     /* on the gap, relative to max(objective, 1), and on residuals */
    const tr_host *host;  /* NULL: nobody interrupts, and no lock is held */
} tr_options;

typedef struct {
    double *command, *size;    /* (N) x_(n-1) + u; (N), left alone without nodes */
    double *lower, *upper;     /* (N + 1, rows) multipliers */
    double *gradient;          /* (N) of the Lagrangian by u, the rule fed back */
    double *start;             /* (nodes) th_0 */
    int iterations;
    double objective, gap, residual;
} tr_result;

/* What a command and multipliers prove in a problem without nodes: the Lagrangian's tangent bounds the optimum by
 * objective - slack - by_command, and by objective - slack - by_movement, from below. */
typedef struct {
    const double *command;             /* (N) */
    const double *by_lower, *by_upper; /* (N, rows) multipliers >= 0; NULL for none */
    const double *by_rule;             /* (N - free) multipliers of the hand-over */
    const double *lower, *upper;       /* (N, rows) what the rows are held to, in place of the problem's own bounds */
    double *excess;                    /* (rows) how far a row is outside at most, negative inside */
    double objective, slack;           /* multipliers times sizes of slacks, those of the hand-over too */
    double residual;                   /* largest of the hand-over */
    double dual_residual;              /* largest size of the Lagrangian's gradient by the commands */
    double by_command;                 /* that gradient times how far a command may be away */
    double by_movement;                /* the same gradient against the movement's own curvature */
} tr_proof;

enum {
    TR_SOLVED, TR_ACCURACY, TR_ITERATION_LIMIT, TR_STALLED, TR_BREAKDOWN,
    TR_TOO_LARGE,   /* or no problem at all */
    TR_NO_BOUNDS,   /* a bound is no number, above the other one, or infinite on the wrong side */
    TR_INTERRUPTED
};

/* Constants of the method. */
static const double NEAR = 1e3;       /* times the tolerance: from here on the best iterate counts */
static const double SHORTEST = 1e-12; /* part of a Newton step that is still one */
static const double FARTHEST = 5e-3;  /* part of slacks and multipliers that a step leaves */
static const double NEAREST = 1e-9, NEARNESS = 0.1;
static const double FIRST_GAP = 3.0;  /* of the first iterate, in units of its objective */
static const double LAST_GAP = 0.03;  /* that is aimed at, of what is allowed: less only costs digits elsewhere */
static const double LEAST = 1e-290;   /* nothing beside a multiplier, and never zero */
static const double LOOK_S = 0.01;    /* of processor time between two questions to the host: its lock may be taken */
enum {
    PATIENCE = 6,    /* iterations without a better iterate */
    STRIDE = 256,    /* stages of a factorisation after which the host may be asked */
    SYMMETRISED = 4, /* stages after which the cost to go is made symmetric again */
    REFINEMENTS = 4  /* of a linear pass, each one more step with the same gains */
};

/* Where an iterate stands. */
typedef struct {
    double complementarity, residual, stationarity, objective;
} tr_state;

/* The host during one call. */
typedef struct {
    const tr_host *host;
    void *thread;
    clock_t asked;
} tr_watch;

static tr_watch released(const tr_host *host)
{
    tr_watch watch = {host, host ? host->release() : NULL, clock()};
    return watch;
}

static void acquired(const tr_watch *watch)
{
    if (watch->host) watch->host->acquire(watch->thread);
}

/* Whether the host wants the work to stop. */
static int interrupted(tr_watch *watch)
{
    if (!watch->host || (double)(clock() - watch->asked) < LOOK_S * CLOCKS_PER_SEC) return 0;
    watch->host->acquire(watch->thread);
    const int stop = watch->host->interrupted();
    watch->thread = watch->host->release();
    watch->asked = clock();
    return stop;
}


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
#else
#define ALWAYS_INLINE static inline
#endif
#define AT(rows, i) (((double *)(rows))[i]) /* one double of a row of lanes */
#define MOST_BLOCKS (MOST_STATES / WIDTH)
#define WHOLE (WIDTH > 4 ? WIDTH : 4) /* a row of states has whole fours, and whole registers */

/* The second half of this file is compiled once for each width of registers, its names with that width behind them. */
#define PASTE(name, width) name##_##width
#define OF_WIDTH(name, width) PASTE(name, width)
#define lanes OF_WIDTH(lanes, WIDTH)
#define choice OF_WIDTH(choice, WIDTH)
#define tr_side OF_WIDTH(tr_side, WIDTH)
#define tr_work OF_WIDTH(tr_work, WIDTH)
#define raise_to OF_WIDTH(raise_to, WIDTH)
#define total OF_WIDTH(total, WIDTH)
#define largest OF_WIDTH(largest, WIDTH)
#define take OF_WIDTH(take, WIDTH)
#define lay_out OF_WIDTH(lay_out, WIDTH)
#define workspace OF_WIDTH(workspace, WIDTH)
#define prepare OF_WIDTH(prepare, WIDTH)
#define combine OF_WIDTH(combine, WIDTH)
#define pair_up OF_WIDTH(pair_up, WIDTH)
#define flow OF_WIDTH(flow, WIDTH)
#define flow_back OF_WIDTH(flow_back, WIDTH)
#define congruence OF_WIDTH(congruence, WIDTH)
#define dot OF_WIDTH(dot, WIDTH)
#define add OF_WIDTH(add, WIDTH)
#define add_product OF_WIDTH(add_product, WIDTH)
#define add_nodes OF_WIDTH(add_nodes, WIDTH)
#define factor_sized OF_WIDTH(factor_sized, WIDTH)
#define tr_costate OF_WIDTH(tr_costate, WIDTH)
#define backward_begin OF_WIDTH(backward_begin, WIDTH)
#define backward_stage OF_WIDTH(backward_stage, WIDTH)
#define backward_sized OF_WIDTH(backward_sized, WIDTH)
#define forward_sized OF_WIDTH(forward_sized, WIDTH)
#define factor OF_WIDTH(factor, WIDTH)
#define backward OF_WIDTH(backward, WIDTH)
#define forward OF_WIDTH(forward, WIDTH)
#define roll_heat OF_WIDTH(roll_heat, WIDTH)
#define closure_residual OF_WIDTH(closure_residual, WIDTH)
#define closure_price OF_WIDTH(closure_price, WIDTH)
#define close_course OF_WIDTH(close_course, WIDTH)
#define newton OF_WIDTH(newton, WIDTH)
#define cost OF_WIDTH(cost, WIDTH)
#define move OF_WIDTH(move, WIDTH)
#define advance OF_WIDTH(advance, WIDTH)
#define begin OF_WIDTH(begin, WIDTH)
#define judge_rows OF_WIDTH(judge_rows, WIDTH)
#define judge OF_WIDTH(judge, WIDTH)
#define aim OF_WIDTH(aim, WIDTH)
#define slack_steps OF_WIDTH(slack_steps, WIDTH)
#define centre OF_WIDTH(centre, WIDTH)
#define keep OF_WIDTH(keep, WIDTH)
#define solve OF_WIDTH(solve, WIDTH)
#define linear OF_WIDTH(linear, WIDTH)
#define prove OF_WIDTH(prove, WIDTH)
#define pad OF_WIDTH(pad, WIDTH)
#define paired_with OF_WIDTH(paired_with, WIDTH)
#define largest_of OF_WIDTH(largest_of, WIDTH)

#if !defined(ONLY_WIDTH) && !defined(__GNUC__)
#define ONLY_WIDTH 1
#elif !defined(ONLY_WIDTH) && (defined(__clang__) || !defined(__x86_64__))
#define ONLY_WIDTH 2
#endif
#if defined(ONLY_WIDTH)
#define WIDTH ONLY_WIDTH
#include "riccati.c"
#define BY_WIDTH(name) name
#else
#pragma GCC push_options
#pragma GCC target("avx512f,avx512dq,avx512vl,prefer-vector-width=512")
#define WIDTH 8
#include "riccati.c"
#undef WIDTH
#pragma GCC pop_options
#pragma GCC push_options
#pragma GCC target("avx2")
#define WIDTH 4
#include "riccati.c"
#undef WIDTH
#pragma GCC pop_options
#define WIDTH 2
#include "riccati.c"
#define BY_WIDTH(name) (fits_eight(q) ? name##_8 : __builtin_cpu_supports("avx2") ? name##_4 : name##_2)

/* Whether rows of eight doubles are at hand, and take no more of them than rows of four do. */
static int fits_eight(const tr_problem *q)
{
    const int left = q->states % 8;
    return (left == 0 || left > 4) && __builtin_cpu_supports("avx512dq") && __builtin_cpu_supports("avx512vl");
}
#endif

/* What arguments and results mean, as a number that changes with it: a caller who knows another one has to stay away. */
int tr_interface(void) { return 7; }

/* Doubles of workspace that a problem needs; 0 if it is too large for this method, or none. */
size_t tr_workspace(const tr_problem *q)
{
    if (q->states < 1 || q->ends < 0 || q->ends > q->states || q->nodes < 0 || q->nodes > MOST_NODES || q->states + q->nodes > MOST_STATES) return 0;
    if (q->rows < (q->nodes > 0) || q->rows > MOST_ROWS || q->stages < 1 || q->outputs < 1) return 0;
    if (q->free_stages < 0 || q->free_stages > q->stages) return 0;
    return BY_WIDTH(workspace)(q);
}

static int has_bounds(const tr_problem *q)
{
    for (size_t i = 0; i < ((size_t)q->stages + 1) * (size_t)q->rows; i++) {
        const double lower = q->lower[i], upper = q->upper[i];
        if (!(lower <= upper) || lower == INFINITY || upper == -INFINITY) return 0;
    }
    return 1;
}

/* Solve; the answer is judged by the caller.
 *
 * Near the answer rounding wins over progress at last: the best iterate is returned, as TR_ACCURACY where it is not
 * quite what was asked for. Far from it the last iterate is, whose multipliers tell of infeasibility.
 */
int tr_solve(const tr_problem *q, const tr_options *options, double *space, tr_result *r)
{
    r->iterations = 0;
    if (!tr_workspace(q)) return TR_TOO_LARGE;
    if (!has_bounds(q)) return TR_NO_BOUNDS;
    tr_watch watch = released(options->host);
    const int code = BY_WIDTH(solve)(q, options, space, r, &watch);
    acquired(&watch);
    return code;
}

/* The problem without rows and nodes: one Newton step from rest, and as many more as refine it.
 *
 * The gains stay in the workspace: with `factored` they are those of the last call, of a problem that differs in
 * nothing but `reference`, `rule_offset`, `end_target` and `constant`. TR_BREAKDOWN and TR_INTERRUPTED leave none.
 */
int tr_linear(const tr_problem *q, const tr_options *options, int factored, double *space, tr_result *r)
{
    r->iterations = 0;
    if (!tr_workspace(q) || q->rows || q->nodes) return TR_TOO_LARGE;
    tr_watch watch = released(options->host);
    const int code = BY_WIDTH(linear)(q, options->tolerance, factored, space, r, &watch);
    acquired(&watch);
    return code;
}

/* Certify: what `proof` states of a problem without nodes. The solver has no say in it. */
int tr_prove(const tr_problem *q, double *space, tr_proof *proof)
{
    if (!tr_workspace(q) || q->nodes) return TR_TOO_LARGE;
    BY_WIDTH(prove)(q, space, proof);
    return TR_SOLVED;
}

#else
/* Doubles that are worked on side by side; every array of the workspace begins with whole ones. */
#if WIDTH > 1
typedef double lanes __attribute__((vector_size(8 * WIDTH), may_alias));
typedef long long choice __attribute__((vector_size(8 * WIDTH), may_alias));

/* The larger, lane by lane; what is no number is passed over. */
ALWAYS_INLINE void raise_to(lanes *most, const lanes *than)
{
    const choice above = *than > *most;
    *most = (lanes)((above & (choice)*than) | (~above & (choice)*most));
}

/* Block j of v with neighbours 2 i and 2 i + 1 in each other's place. */
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

ALWAYS_INLINE void raise_to(lanes *most, const lanes *than) { *most = *than > *most ? *than : *most; }
#endif

ALWAYS_INLINE double total(const lanes *of)
{
    double sum[WIDTH];
    for (int j = 0; j < WIDTH; j++) sum[j] = AT(of, j);
    for (int half = WIDTH / 2; half > 0; half /= 2)
        for (int j = 0; j < half; j++) sum[j] += sum[j + half];
    return sum[0];
}

ALWAYS_INLINE double largest(const lanes *of)
{
    double most = AT(of, 0);
    for (int j = 1; j < WIDTH; j++) most = AT(of, j) > most ? AT(of, j) : most;
    return most;
}

/* One side of every row: slack s = sign (value - bound), s * l -> 0. Where `there` is 0 there is no limit: l = 0. */
typedef struct {
    double sign;
    lanes *there, *bound, *s, *l, *inverse, *residual, *ds, *dl, *target;
} tr_side;

/* Everything that lives during one solve. Differences carry a d: dE is the change of `error` by a Newton step. */
typedef struct {
    const tr_problem *q;
    tr_watch *watch;
    int ld;                              /* length of a row of states, padded with zeros */
    int blocks;                          /* of all values of the rows */
    lanes *A, *At, *C, *G, *Z;          /* padded A, its transpose, C, G and Z */
    int paired;                          /* A couples states 2 i and 2 i + 1, and the held command to all */
    lanes own[MOST_BLOCKS], from_pair[MOST_BLOCKS], to_pair[MOST_BLOCKS]; /* its diagonal, A[j][j ^ 1] and A[j ^ 1][j] */
    lanes push[MOST_BLOCKS], held[MOST_BLOCKS];                           /* its last column; one at the held command */
    lanes *K, *Ke;
    double *Kth, *pivot;             /* gains of u by states and by nodes, inverse pivots */
    double *Keth, *Ke_u, *pivot_e;  /* the same of e, its gain by u */
    double *offset, *offset_e;           /* Newton step without feedback */
    double *u, *e, *du, *de;
    double *error, *d_error, *end_error, *d_end_error;
    double *current, *command, *d_current, *d_command; /* i_k, c_k, where they heat */
    double *heat;                        /* (N, 4): dh/di, dh/dc, times resistance; resistance; copper h */
    double *theta;                       /* (N + 1, nodes) */
    double *by_heat;                     /* (N) b' costate of th_(k+1) */
    lanes *V, *dV, *sigma, *y;           /* rows: values, weights, gradients */
    tr_side side[2];                     /* their lower and their upper limits */
    double *unit_offset, *unit_offset_e; /* (nodes, N) response to the closure's multiplier */
    double *still;                       /* (N) zeros */
    /* At the ends of the horizon: cost to go in th_0, its gradient, th_N of a step; the closure's multiplier. */
    double P0[MOST_NODES * MOST_NODES], p0[MOST_NODES], th_end[MOST_NODES];
    double eta[MOST_NODES], d_eta[MOST_NODES], d_start[MOST_NODES];
    double closing[4 * MOST_NODES * MOST_NODES]; /* matrix of the closure's equations */
    int from[MOST_ROWS], to[MOST_ROWS];          /* states between which a row of G has all that is not zero */
} tr_work;

/* Registers that a row of n states takes, padded with zeros. */
#define BLOCKS(n) (((n) + WHOLE - 1) / WHOLE * (WHOLE / WIDTH))

/* The next `count` doubles of the workspace, if there is one yet. */
static void *take(double *workspace, size_t *taken, size_t count)
{
    void *found = workspace ? workspace + *taken : NULL;
    *taken += (count + WIDTH - 1) / WIDTH * WIDTH;
    return found;
}

/* Arrays in the workspace; in front those that a linear pass with its gains kept finds as it left them. Returns the
 * doubles that are taken, and in `kept` how many of them stand in front. */
static size_t lay_out(tr_work *w, const tr_problem *q, double *space, size_t *kept)
{
    const size_t N = (size_t)q->stages, m = (N + 1) * (size_t)q->rows, ny = (size_t)q->outputs, t = (size_t)q->nodes;
    const size_t ld = BLOCKS((size_t)q->states) * WIDTH;
    size_t taken = 0;
    w->q = q;
    w->ld = (int)ld;
    w->blocks = (int)((m + WIDTH - 1) / WIDTH);
    w->A = take(space, &taken, ld * ld), w->At = take(space, &taken, ld * ld);
    w->C = take(space, &taken, ny * ld), w->G = take(space, &taken, (size_t)q->rows * ld);
    w->Z = take(space, &taken, (size_t)q->ends * ld), w->d_end_error = take(space, &taken, (size_t)q->ends);
    w->K = take(space, &taken, N * ld), w->pivot = take(space, &taken, N);
    w->du = take(space, &taken, N), w->d_error = take(space, &taken, N * ny);
    *kept = taken;
    w->offset = take(space, &taken, N), w->u = take(space, &taken, N), w->error = take(space, &taken, N * ny);
    w->end_error = take(space, &taken, (size_t)q->ends);
    const size_t warm = t ? N : 0; /* what only temperatures need */
    w->Kth = take(space, &taken, N * t), w->Keth = take(space, &taken, N * t);
    w->Ke = take(space, &taken, warm * ld), w->Ke_u = take(space, &taken, warm), w->pivot_e = take(space, &taken, warm);
    w->offset_e = take(space, &taken, warm), w->e = take(space, &taken, warm), w->de = take(space, &taken, warm);
    w->heat = take(space, &taken, 4 * warm), w->by_heat = take(space, &taken, warm);
    w->unit_offset = take(space, &taken, N * t), w->unit_offset_e = take(space, &taken, N * t);
    w->current = take(space, &taken, warm), w->command = take(space, &taken, warm);
    w->d_current = take(space, &taken, warm), w->d_command = take(space, &taken, warm);
    w->still = take(space, &taken, warm), w->theta = take(space, &taken, (N + 1) * t);
    w->V = take(space, &taken, m), w->dV = take(space, &taken, m), w->sigma = take(space, &taken, m), w->y = take(space, &taken, m);
    for (tr_side *z = w->side; z < w->side + 2; z++) {
        z->there = take(space, &taken, m), z->bound = take(space, &taken, m), z->s = take(space, &taken, m), z->l = take(space, &taken, m);
        z->inverse = take(space, &taken, m), z->residual = take(space, &taken, m);
        z->ds = take(space, &taken, m), z->dl = take(space, &taken, m), z->target = take(space, &taken, m);
    }
    return taken;
}

/* Doubles that a problem needs, wherever they begin. */
static size_t workspace(const tr_problem *q)
{
    tr_work w;
    size_t kept;
    return lay_out(&w, q, NULL, &kept) + WIDTH - 1;
}

/* Whether the states stand in pairs, and what couples them. */
static void pair_up(tr_work *w)
{
    const int n = w->q->states, last = n - 1;
    const double *A = w->q->A;
    w->paired = A[last * n + last] == 1.0;
    for (int i = 0; i < n; i++)
        for (int j = 0; j < last; j++)
            if (j != i && (j != (i ^ 1) || i == last) && A[i * n + j] != 0.0) w->paired = 0;
    for (int i = 0; i < last; i++) {
        const int other = i ^ 1;
        AT(w->own, i) = A[i * n + i];
        if (other < last) AT(w->from_pair, i) = A[i * n + other], AT(w->to_pair, i) = A[other * n + i];
        AT(w->push, i) = A[i * n + last];
    }
    AT(w->push, last) = A[last * n + last];
    AT(w->held, last) = 1.0;
}

/* The matrices, their rows padded with zeros. */
static void pad(tr_work *w)
{
    const tr_problem *q = w->q;
    const size_t n = (size_t)q->states, ld = (size_t)w->ld, in_one = n * sizeof(double);
    memset(w->A, 0, (size_t)((char *)w->d_end_error - (char *)w->A));
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
    pair_up(w);
}

/* The workspace, all zero but what the problem says; with `keep_gains`, what stands in front is left alone. */
static void prepare(tr_work *w, const tr_problem *q, double *space, int keep_gains, tr_watch *watch)
{
    const size_t n = (size_t)q->states, ld = BLOCKS(n) * WIDTH, rows = (size_t)((q->stages + 1) * q->rows);
    size_t kept;
    while ((uintptr_t)space % (WIDTH * sizeof(double))) space++;
    memset(w, 0, sizeof *w);
    w->watch = watch;
    const size_t all = lay_out(w, q, space, &kept);
    if (!keep_gains) kept = 0;
    memset(space + kept, 0, (all - kept) * sizeof(double));
    for (int side = 0; side < 2; side++) {
        tr_side *z = w->side + side;
        const double *limit = side ? q->upper : q->lower;
        z->sign = side ? -1.0 : 1.0;
        for (int i = 0; i < w->blocks * WIDTH; i++) AT(z->s, i) = 1.0;
        for (size_t i = 0; i < rows; i++)
            if (limit[i] > -INFINITY && limit[i] < INFINITY) AT(z->there, i) = 1.0, AT(z->bound, i) = limit[i];
    }
    pad(w);
    if (keep_gains) return;
    for (size_t k = (size_t)q->free_stages; k < (size_t)q->stages; k++)
        memcpy(&AT(w->K, k * ld), q->rule_gain + (k - (size_t)q->free_stages) * n, n * sizeof(double));
}

/* out = M' v, four rows of M at a time: short chains of additions. */
ALWAYS_INLINE void combine(const int blocks, const lanes *restrict M, const double *restrict v, lanes *restrict out)
{
    for (int j = 0; j < blocks; j++) {
        const lanes *m = M + j;
        lanes sum = (v[0] * m[0] + v[1] * m[blocks]) + (v[2] * m[2 * blocks] + v[3] * m[3 * blocks]);
        for (int l = 4; l < blocks * WIDTH; l += 4) {
            m += 4 * blocks;
            sum += (v[l] * m[0] + v[l + 1] * m[blocks]) + (v[l + 2] * m[2 * blocks] + v[l + 3] * m[3 * blocks]);
        }
        out[j] = sum;
    }
}

ALWAYS_INLINE double dot(const int blocks, const lanes *restrict a, const lanes *restrict b)
{
    lanes sum = a[0] * b[0];
    for (int j = 1; j < blocks; j++) sum += a[j] * b[j];
    return total(&sum);
}

ALWAYS_INLINE void add(const int blocks, const double by, const lanes *restrict c, lanes *restrict to)
{
    for (int j = 0; j < blocks; j++) to[j] += by * c[j];
}

/* out = A x + A[:, n-1] u. */
ALWAYS_INLINE void flow(const int last, const int blocks, const tr_work *w, const lanes *restrict x, const double u,
                        lanes *restrict out)
{
    if (!w->paired) {
        combine(blocks, w->At, (const double *)x, out);
        add(blocks, u, w->At + last * blocks, out);
        return;
    }
    const double command = AT(x, last) + u;
    for (int j = 0; j < blocks; j++)
        out[j] = (w->own[j] * x[j] + w->from_pair[j] * SWAPPED(x, j)) + command * w->push[j];
}

/* out = A' p. */
ALWAYS_INLINE void flow_back(const int blocks, const tr_work *w, const lanes *restrict p, lanes *restrict out)
{
    if (!w->paired) {
        combine(blocks, w->A, (const double *)p, out);
        return;
    }
    const double command = dot(blocks, w->push, p);
    for (int j = 0; j < blocks; j++)
        out[j] = (w->own[j] * p[j] + w->to_pair[j] * SWAPPED(p, j)) + command * w->held[j];
}

/* H = A' P A of a symmetric P; PA is scratch. */
ALWAYS_INLINE void congruence(const int n, const int blocks, const tr_work *w, const lanes *restrict P,
                              lanes *restrict PA, lanes *restrict H)
{
    const int last = n - 1, ld = blocks * WIDTH;
    if (!w->paired) {
        for (int i = 0; i < ld; i++) combine(blocks, w->A, (const double *)(P + i * blocks), PA + i * blocks);
        for (int i = 0; i < ld; i++) combine(blocks, PA, (const double *)(w->At + i * blocks), H + i * blocks);
        return;
    }
    lanes pushed[MOST_BLOCKS];
    memset(pushed, 0, (size_t)ld * sizeof(double));
    for (int i = 0; i < n; i++) add(blocks, AT(w->push, i), P + i * blocks, pushed);
    flow_back(blocks, w, pushed, H + last * blocks);
    for (int i = 0; i < n; i++) /* of the last column the last row is enough */
        for (int j = 0; j < blocks; j++)
            PA[i * blocks + j] = w->own[j] * P[i * blocks + j] + w->to_pair[j] * SWAPPED(P + i * blocks, j);
    for (int i = 0; i < last; i++) {
        const int other = (i ^ 1) < last ? i ^ 1 : i;
        const double own = AT(w->own, i), pair = AT(w->to_pair, i), command = AT(H + last * blocks, i);
        for (int j = 0; j < blocks; j++)
            H[i * blocks + j] = (own * PA[i * blocks + j] + pair * PA[other * blocks + j]) + command * w->held[j];
    }
}

/* Add c d' to H. */
ALWAYS_INLINE void add_product(const int blocks, const lanes *restrict c, const lanes *restrict d, lanes *restrict H)
{
    for (int i = 0; i < blocks * WIDTH; i++) add(blocks, AT(c, i), d, H + i * blocks);
}

/* What the nodes add to H = A' P A of the states: their flow is B x + M th with B = b g', where g = `by_x`.
 *
 * Cost to go P (states), Q (nodes, states), R (nodes, nodes). Out: H; HQ and HR; f = sum_i b_i U_i and fR = b' R M,
 * where [U R M] are the nodes' rows of P times the flow. Returns b' R b.
 */
ALWAYS_INLINE double add_nodes(const int t, const int blocks, const tr_work *w, const double *heat,
                               const lanes *restrict by_x, const lanes *restrict Q, const double *restrict R,
                               lanes *restrict H, lanes *restrict HQ, double *restrict HR, lanes *restrict f,
                               double *restrict fR)
{
    const tr_problem *q = w->q;
    double M[MOST_NODES * MOST_NODES], RM[MOST_NODES * MOST_NODES], bRb = 0.0;
    lanes U[MOST_NODES * MOST_BLOCKS], half[MOST_BLOCKS];
    for (int i = 0; i < t; i++)
        for (int j = 0; j < t; j++) M[i * t + j] = q->M[i * t + j] + (j == 0 ? q->b[i] * heat[3] : 0.0);
    for (int i = 0; i < t; i++) {
        double Rb = 0.0;
        for (int j = 0; j < t; j++) Rb += R[i * t + j] * q->b[j];
        bRb += q->b[i] * Rb;
        flow_back(blocks, w, Q + i * blocks, U + i * blocks);
        add(blocks, Rb, by_x, U + i * blocks);
        for (int j = 0; j < t; j++) {
            RM[i * t + j] = 0.0;
            for (int l = 0; l < t; l++) RM[i * t + j] += R[i * t + l] * M[l * t + j];
        }
    }
    for (int j = 0; j < blocks; j++) f[j] = q->b[0] * U[j];
    for (int i = 1; i < t; i++) add(blocks, q->b[i], U + i * blocks, f);
    for (int j = 0; j < blocks; j++) half[j] = f[j] - 0.5 * bRb * by_x[j];
    for (int i = 0; i < blocks * WIDTH; i++)
        for (int j = 0; j < blocks; j++) H[i * blocks + j] += AT(half, i) * by_x[j] + AT(by_x, i) * half[j];
    for (int i = 0; i < t; i++) {
        for (int j = 0; j < blocks; j++) HQ[i * blocks + j] = M[i] * U[j];
        for (int l = 1; l < t; l++) add(blocks, M[l * t + i], U + l * blocks, HQ + i * blocks);
        fR[i] = 0.0;
        for (int l = 0; l < t; l++) fR[i] += q->b[l] * RM[l * t + i];
        for (int j = 0; j < t; j++) {
            HR[i * t + j] = 0.0;
            for (int l = 0; l < t; l++) HR[i * t + j] += M[l * t + i] * RM[l * t + j];
        }
    }
    return bRb;
}

/* A costate on its way backward. */
typedef struct {
    lanes p[MOST_BLOCKS], by_x[MOST_BLOCKS];
    double th[MOST_NODES];
} tr_costate;

/* The costate at N. `own` is 0 for the response to the closure's multiplier alone. */
ALWAYS_INLINE void backward_begin(const int blocks, const tr_work *w, const int t, const double *end, const int own,
                                  tr_costate *c)
{
    const tr_problem *q = w->q;
    const int N = q->stages, m = q->rows;
    memset(c, 0, sizeof *c);
    for (int i = 0; i < t; i++) c->th[i] = end[i];
    if (t && own) c->th[0] += AT(w->y, N * m);
    for (int j = 0; own && j < q->ends; j++) add(blocks, w->end_error[j], w->Z + j * blocks, c->p);
    for (int j = t ? 1 : 0; own && j < m; j++) {
        const double y = AT(w->y, N * m + j);
        if (y != 0.0) add(blocks, y, w->G + j * blocks, c->p);
    }
}

/* From k + 1 to k with the gains: steps without feedback into `offset`; without them, as not `newton`: the gradient
 * into `offset`, and the heat's prices. */
ALWAYS_INLINE void backward_stage(const int n, const int blocks, tr_work *w, const int t, const int k, const int own,
                                  double *restrict offset, double *restrict offset_e, const int newton, tr_costate *c)
{
    const tr_problem *q = w->q;
    const int m = q->rows, last = n - 1;
    const lanes nothing = {0};
    lanes a[MOST_BLOCKS], drive[MOST_BLOCKS];
    const double *y = &AT(w->y, k * m);
    double by_size = 0.0, th_before[MOST_NODES] = {0}, direct = 0.0;
    /* What does not depend on later stages stands apart, to be ready before they are. */
    for (int j = 0; j < blocks; j++) drive[j] = nothing;
    if (own) {
        direct = q->movement_weight * w->u[k];
        for (int o = 0; o < q->outputs; o++) {
            const double v = q->weight[k * q->outputs + o] * w->error[k * q->outputs + o];
            direct += q->E[o] * v;
            add(blocks, v, w->C + o * blocks, drive);
        }
        if (t) th_before[0] = y[0];
        for (int j = t ? 1 : 0; j < m; j++) {
            direct += q->d[j] * y[j];
            by_size += q->d_size[j] * y[j];
            add(blocks, y[j], w->G + j * blocks, drive);
        }
    }
    flow_back(blocks, w, c->p, a);
    if (t) {
        const double *heat = w->heat + 4 * k;
        double beta = 0.0;
        for (int i = 0; i < t; i++) beta += q->b[i] * c->th[i];
        if (q->current >= 0) AT(c->by_x, q->current) = heat[0];
        AT(c->by_x, last) = heat[1];
        add(blocks, beta, c->by_x, a);
        by_size += 2.0 * q->ripple * heat[2] * beta;
        for (int j = 0; j < t; j++)
            for (int i = 0; i < t; i++) th_before[j] += q->M[i * t + j] * c->th[i];
        th_before[0] += heat[3] * beta;
        if (!newton) w->by_heat[k] = beta;
    }
    double by_movement = AT(a, last) + direct;
    for (int j = 0; j < blocks; j++) a[j] += drive[j];
    if (newton) {
        const lanes *gain = w->K + k * blocks;
        if (t) {
            offset_e[k] = -by_size * w->pivot_e[k];
            by_movement += w->Ke_u[k] * by_size;
            add(blocks, by_size, w->Ke + k * blocks, a);
            for (int j = 0; j < t; j++) th_before[j] += w->Keth[k * t + j] * by_size;
        }
        offset[k] = -by_movement * w->pivot[k];
        for (int j = 0; j < blocks; j++) c->p[j] = a[j] + by_movement * gain[j];
        for (int j = 0; j < t; j++) c->th[j] = th_before[j] + w->Kth[k * t + j] * by_movement;
    } else {
        offset[k] = by_movement;
        if (t) offset_e[k] = by_size;
        for (int j = 0; j < blocks; j++) c->p[j] = a[j];
        if (k >= q->free_stages) add(blocks, by_movement, w->K + k * blocks, c->p);
        for (int j = 0; j < t; j++) c->th[j] = th_before[j];
    }
}

ALWAYS_INLINE void backward_sized(const int n, const int blocks, tr_work *w, const int t, const double *end,
                                  const int own, double *restrict offset, double *restrict offset_e, const int newton)
{
    tr_costate costate;
    backward_begin(blocks, w, t, end, own, &costate);
    for (int k = w->q->stages - 1; k >= 0; k--)
        backward_stage(n, blocks, w, t, k, own, offset, offset_e, newton, &costate);
    memcpy(w->p0, costate.th, (size_t)t * sizeof(double));
}

/* Backward: gains of u and e from the weights `sigma` of the rows. With `curved` the copper's bilinear terms are in.
 * With `end`, the heat's price at N, the Newton step's costate goes along, as in `backward`: its chain of short sums
 * then waits while the products of the factorisation keep the processor busy. Returns 0, or the code of what has ended
 * it. */
ALWAYS_INLINE int factor_sized(const int n, const int t, const int blocks, tr_work *w, const int curved,
                               const double *end)
{
    const tr_problem *q = w->q;
    const int N = q->stages, m = q->rows, last = n - 1, a = q->current, ld = blocks * WIDTH;
    const int of_current = t && a >= 0;
    lanes P[MOST_STATES * MOST_BLOCKS], PA[MOST_STATES * MOST_BLOCKS], H[MOST_STATES * MOST_BLOCKS];
    lanes hu[MOST_BLOCKS], he[MOST_BLOCKS], by_x[MOST_BLOCKS], bend_a[MOST_BLOCKS], bend_c[MOST_BLOCKS];
    lanes Q[MOST_NODES * MOST_BLOCKS], HQ[MOST_NODES * MOST_BLOCKS];
    double R[MOST_NODES * MOST_NODES], HR[MOST_NODES * MOST_NODES], hu_th[MOST_NODES], he_th[MOST_NODES];
    const double e1 = q->decay, e2 = 1.0 - e1, *s = q->square;
    tr_costate costate;
    if (end) backward_begin(blocks, w, t, end, 1, &costate);
    memset(P, 0, (size_t)(ld * ld) * sizeof(double));
    memset(H, 0, (size_t)(ld * ld) * sizeof(double));
    memset(by_x, 0, sizeof by_x);
    memset(bend_a, 0, sizeof bend_a);
    memset(bend_c, 0, sizeof bend_c);
    memset(Q, 0, sizeof Q);
    memset(R, 0, sizeof R);
    for (int j = 0; j < q->ends; j++) add_product(blocks, w->Z + j * blocks, w->Z + j * blocks, P);
    for (int j = t ? 1 : 0; j < m; j++) {
        const double weight = AT(w->sigma, N * m + j);
        const lanes *c = w->G + j * blocks;
        for (int i = w->from[j]; i < w->to[j] && weight != 0.0; i++) add(blocks, weight * AT(c, i), c, P + i * blocks);
    }
    if (t) R[0] = AT(w->sigma, N * m), AT(bend_c, last) = 2.0 * s[2] * e2 * e2;
    if (of_current) {
        AT(bend_a, a) = 2.0 * (s[0] + s[1] * e1 + s[2] * e1 * e1);
        AT(bend_a, last) = AT(bend_c, a) = (s[1] + 2.0 * s[2] * e1) * e2;
    }
    for (int k = N - 1; k >= 0; k--) {
        if (k % STRIDE == 0 && interrupted(w->watch)) return TR_INTERRUPTED;
        const double *heat = w->heat + 4 * k, *sigma = &AT(w->sigma, k * m);
        double r = q->movement_weight, hee = 0.0, heu = 0.0;
        lanes *gain = w->K + k * blocks;
        congruence(n, blocks, w, P, PA, H);
        if (t) {
            /* e moves the nodes only: column 2 ripple resistance b. */
            const double by = 2.0 * q->ripple * heat[2];
            if (of_current) AT(by_x, a) = heat[0];
            AT(by_x, last) = heat[1];
            hee = by * by * add_nodes(t, blocks, w, heat, by_x, Q, R, H, HQ, HR, he, he_th);
            for (int j = 0; j < blocks; j++) he[j] *= by;
            for (int j = 0; j < t; j++) he_th[j] *= by;
            heu = AT(he, last);
            /* Curvature of the heat, weighed by what a kelvin at the next instant costs. */
            const double price = w->by_heat[k], bend = price * heat[2];
            if (of_current) add(blocks, bend, bend_a, H + a * blocks);
            add(blocks, bend, bend_c, H + last * blocks);
            if (curved && heat[2] > 0.0) {
                add(blocks, price * q->copper / heat[2], by_x, HQ);
                he_th[0] += price * q->copper * 2.0 * q->ripple;
            }
            HR[0] += sigma[0];
            for (int j = 0; j < t; j++) hu_th[j] = AT(HQ + j * blocks, last);
        }
        for (int j = 0; j < blocks; j++) hu[j] = H[last * blocks + j];
        r += AT(hu, last);
        for (int o = 0; o < q->outputs; o++) {
            const lanes *c = w->C + o * blocks;
            const double weight = q->weight[k * q->outputs + o], direct = weight * q->E[o];
            for (int i = 0; i < ld; i++) add(blocks, weight * AT(c, i), c, H + i * blocks);
            if (direct != 0.0) {
                add(blocks, direct, c, hu);
                r += direct * q->E[o];
            }
        }
        for (int j = t ? 1 : 0; j < m; j++) {
            const double weight = sigma[j], d = weight * q->d[j], size = weight * q->d_size[j];
            const lanes *c = w->G + j * blocks;
            for (int i = w->from[j]; i < w->to[j]; i++) add(blocks, weight * AT(c, i), c, H + i * blocks);
            if (d != 0.0) {
                add(blocks, d, c, hu);
                r += d * q->d[j];
                heu += size * q->d[j];
            }
            if (size != 0.0) {
                add(blocks, size, c, he);
                hee += size * q->d_size[j];
            }
        }
        if (t) {
            lanes *gain_e = w->Ke + k * blocks;
            double *gain_e_th = w->Keth + k * t;
            if (!(hee > 0.0)) return TR_BREAKDOWN;
            const double inverse = 1.0 / hee, Ke_u = -heu * inverse;
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
            r += heu * Ke_u;
        }
        if (k >= q->free_stages) {
            for (int i = 0; i < ld; i++) {
                const double f = AT(gain, i), g = AT(hu, i) + f * r;
                for (int j = 0; j < blocks; j++) P[i * blocks + j] = H[i * blocks + j] + (f * hu[j] + g * gain[j]);
            }
            for (int j = 0; j < t; j++) add(blocks, hu_th[j], gain, HQ + j * blocks);
        } else {
            if (!(r > 0.0)) return TR_BREAKDOWN;
            const double inverse = 1.0 / r;
            w->pivot[k] = inverse;
            for (int j = 0; j < blocks; j++) gain[j] = -inverse * hu[j];
            for (int i = 0; i < ld; i++)
                for (int j = 0; j < blocks; j++) P[i * blocks + j] = H[i * blocks + j] + AT(hu, i) * gain[j];
            for (int j = 0; j < t; j++) {
                w->Kth[k * t + j] = -hu_th[j] * inverse;
                add(blocks, hu_th[j], gain, HQ + j * blocks);
            }
            for (int i = 0; i < t; i++)
                for (int j = 0; j < t; j++) HR[i * t + j] += hu_th[i] * w->Kth[k * t + j];
        }
        if (k % SYMMETRISED == 0)
            for (int i = 1; i < n; i++)
                for (int j = 0; j < i; j++) AT(P, i * ld + j) = AT(P, j * ld + i);
        for (int j = 0; j < t; j++) {
            for (int i = 0; i < blocks; i++) Q[j * blocks + i] = HQ[j * blocks + i];
            for (int i = 0; i <= j; i++) R[i * t + j] = R[j * t + i] = HR[i * t + j];
        }
        if (end) backward_stage(n, blocks, w, t, k, 1, w->offset, w->offset_e, 1, &costate);
    }
    if (end) memcpy(w->p0, costate.th, (size_t)t * sizeof(double));
    memcpy(w->P0, R, (size_t)(t * t) * sizeof(double));
    return 0;
}

/* Forward by the gains from x_0 = 0 and th_0 = `th`: what a step changes, to first order. */
ALWAYS_INLINE void forward_sized(const int n, const int blocks, tr_work *w, const int t, const double *start,
                                 const double *restrict offset, const double *restrict offset_e, const int full)
{
    const tr_problem *q = w->q;
    const int N = q->stages, m = q->rows, last = n - 1;
    lanes x[MOST_BLOCKS], next[MOST_BLOCKS];
    double th[MOST_NODES] = {0};
    memset(x, 0, sizeof x);
    for (int i = 0; i < t; i++) th[i] = start[i];
    for (int k = 0; k < N; k++) {
        double u = offset[k], e = 0.0;
        for (int j = 0; j < t; j++) u += w->Kth[k * t + j] * th[j];
        u += dot(blocks, w->K + k * blocks, x);
        if (t) {
            e = offset_e[k] + w->Ke_u[k] * u;
            for (int j = 0; j < t; j++) e += w->Keth[k * t + j] * th[j];
            e += dot(blocks, w->Ke + k * blocks, x);
        }
        const double current = q->current >= 0 ? AT(x, q->current) : 0.0, command = AT(x, last) + u;
        if (full) {
            w->du[k] = u;
            if (t) w->de[k] = e, w->d_current[k] = current, w->d_command[k] = command;
            for (int o = 0; o < q->outputs; o++)
                w->d_error[k * q->outputs + o] = q->E[o] * u + dot(blocks, w->C + o * blocks, x);
            if (t) AT(w->dV, k * m) = th[0];
            for (int i = t ? 1 : 0; i < m; i++) {
                double v = q->d[i] * u + q->d_size[i] * e;
                for (int j = w->from[i]; j < w->to[i]; j++) v += AT(w->G + i * blocks, j) * AT(x, j);
                AT(w->dV, k * m + i) = v;
            }
        }
        if (t) {
            const double *heat = w->heat + 4 * k;
            const double h = heat[0] * current + heat[1] * command + heat[3] * th[0] + 2.0 * q->ripple * heat[2] * e;
            double th_next[MOST_NODES];
            for (int i = 0; i < t; i++) {
                th_next[i] = q->b[i] * h;
                for (int j = 0; j < t; j++) th_next[i] += q->M[i * t + j] * th[j];
            }
            for (int i = 0; i < t; i++) th[i] = th_next[i];
        }
        flow(last, blocks, w, x, u, next);
        for (int j = 0; j < blocks; j++) x[j] = next[j];
    }
    for (int j = 0; full && j < q->ends; j++) w->d_end_error[j] = dot(blocks, w->Z + j * blocks, x);
    if (full && t) AT(w->dV, N * m) = th[0];
    for (int i = t ? 1 : 0; full && i < m; i++) {
        double v = 0.0;
        for (int j = w->from[i]; j < w->to[i]; j++) v += AT(w->G + i * blocks, j) * AT(x, j);
        AT(w->dV, N * m + i) = v;
    }
    for (int i = 0; i < t; i++) w->th_end[i] = th[i];
}

/* Sizes that are known when compiled keep their rows in registers. A program that solves few problems, such as one for
 * sanitizers, may say which sizes it SOLVES: the others are then left to the code for any size.
 */
#if !defined(SOLVES)
#define SOLVES(n, t) 1
#endif
#define OF_SIZE(n, t, call)         \
    if (!SOLVES(n, t)) goto any;    \
    call(n, t, BLOCKS(n))
#define BY_SIZE(call)                                              \
    switch (w->q->nodes * 100 + w->q->states) {                    \
    case 4: OF_SIZE(4, 0, call);                                   \
    case 5: OF_SIZE(5, 0, call);                                   \
    case 6: OF_SIZE(6, 0, call);                                   \
    case 7: OF_SIZE(7, 0, call);                                   \
    case 8: OF_SIZE(8, 0, call);                                   \
    case 9: OF_SIZE(9, 0, call);                                   \
    case 10: OF_SIZE(10, 0, call);                                 \
    case 11: OF_SIZE(11, 0, call);                                 \
    case 12: OF_SIZE(12, 0, call);                                 \
    case 108: OF_SIZE(8, 1, call);                                 \
    case 110: OF_SIZE(10, 1, call);                                \
    case 208: OF_SIZE(8, 2, call);                                 \
    case 210: OF_SIZE(10, 2, call);                                \
    default:                                                       \
    any: call(w->q->states, w->q->nodes, w->ld / WIDTH);           \
    }
#define FACTOR(n, t, blocks) return factor_sized(n, t, blocks, w, curved, end)
#define BACKWARD(n, t, blocks) backward_sized(n, blocks, w, t, end, own, offset, offset_e, newton); return
#define FORWARD(n, t, blocks) forward_sized(n, blocks, w, t, start, offset, offset_e, full); return

static int factor(tr_work *w, int curved, const double *end)
{
    BY_SIZE(FACTOR)
}

static void backward(tr_work *w, const double *end, int own, double *offset, double *offset_e, int newton)
{
    BY_SIZE(BACKWARD)
}

static void forward(tr_work *w, const double *start, const double *offset, const double *offset_e, int full)
{
    BY_SIZE(FORWARD)
}

/* Temperatures and their derivatives along the horizon, from currents, commands, sizes and th_0. */
static void roll_heat(tr_work *w)
{
    const tr_problem *q = w->q;
    const int t = q->nodes;
    if (!t) return;
    const double e1 = q->decay, e2 = 1.0 - e1, *s = q->square;
    for (int k = 0; k < q->stages; k++) {
        const double *th = w->theta + k * t, a = w->current[k], b = e1 * a + e2 * w->command[k];
        double *heat = w->heat + 4 * k, *after = w->theta + (k + 1) * t;
        const double by_a = 2.0 * s[0] * a + s[1] * b, by_b = s[1] * a + 2.0 * s[2] * b;
        const double h = s[0] * a * a + s[1] * a * b + s[2] * b * b + q->ripple * (2.0 * w->e[k] + q->ripple);
        const double resistance = q->gain[k] + q->copper * th[0];
        heat[0] = resistance * (by_a + e1 * by_b);
        heat[1] = resistance * e2 * by_b;
        heat[2] = resistance;
        heat[3] = q->copper * h;
        for (int i = 0; i < t; i++) {
            after[i] = q->b[i] * resistance * h;
            for (int j = 0; j < t; j++) after[i] += q->M[i * t + j] * th[j];
        }
    }
    for (int k = 0; k <= q->stages; k++) AT(w->V, k * q->rows) = w->theta[k * t];
}

/* th_0 - F th_N - f. */
static void closure_residual(const tr_work *w, double *residual)
{
    const tr_problem *q = w->q;
    const int t = q->nodes;
    for (int i = 0; i < t; i++) {
        residual[i] = w->theta[i] - q->f[i];
        for (int j = 0; j < t; j++) residual[i] -= q->F[i * t + j] * w->theta[q->stages * t + j];
    }
}

/* Gradient of the closure's term by th_N. */
static void closure_price(const tr_work *w, const double *eta, double *end)
{
    const tr_problem *q = w->q;
    for (int j = 0; j < q->nodes; j++) {
        end[j] = 0.0;
        for (int i = 0; q->repeated && i < q->nodes; i++) end[j] -= q->F[i * q->nodes + j] * eta[i];
    }
}

/* What one unit of th_0 and of the closure's multiplier does, with the gains of the last factorisation. */
static void close_course(tr_work *w)
{
    const tr_problem *q = w->q;
    const int t = q->nodes, N = q->stages, c = 2 * t;
    static const double nothing[MOST_NODES] = {0};
    double end[MOST_NODES], unit[MOST_NODES], *E = w->closing;
    for (int j = 0; j < t; j++) {
        for (int i = 0; i < t; i++) unit[i] = i == j;
        closure_price(w, unit, end);
        backward(w, end, 0, w->unit_offset + j * N, w->unit_offset_e + j * N, 1);
        for (int i = 0; i < t; i++) E[i * c + t + j] = w->p0[i] + unit[i];
        forward(w, nothing, w->unit_offset + j * N, w->unit_offset_e + j * N, 0);
        for (int i = 0; i < t; i++) {
            E[(t + i) * c + t + j] = 0.0;
            for (int l = 0; l < t; l++) E[(t + i) * c + t + j] -= q->F[i * t + l] * w->th_end[l];
        }
        forward(w, unit, w->still, w->still, 0);
        for (int i = 0; i < t; i++) {
            E[i * c + j] = w->P0[i * t + j];
            E[(t + i) * c + j] = unit[i];
            for (int l = 0; l < t; l++) E[(t + i) * c + j] -= q->F[i * t + l] * w->th_end[l];
        }
    }
}

/* One Newton step for the gradients in `y`; `begun`, where the factorisation has taken its costate along. */
static void newton(tr_work *w, int begun)
{
    const tr_problem *q = w->q;
    const int t = q->nodes, N = q->stages;
    double end[MOST_NODES] = {0}, right[2 * MOST_NODES];
    static const double nothing[MOST_NODES] = {0};
    if (!begun) {
        closure_price(w, w->eta, end);
        backward(w, end, 1, w->offset, w->offset_e, 1);
    }
    if (!q->repeated) {
        forward(w, nothing, w->offset, w->offset_e, 1);
        return;
    }
    for (int i = 0; i < t; i++) right[i] = -w->p0[i] - w->eta[i];
    forward(w, nothing, w->offset, w->offset_e, 0);
    closure_residual(w, right + t);
    for (int i = 0; i < t; i++) {
        right[t + i] = -right[t + i];
        for (int j = 0; j < t; j++) right[t + i] += q->F[i * t + j] * w->th_end[j];
    }
    eliminate(2 * t, w->closing, right);
    for (int j = 0; j < t; j++) {
        w->d_start[j] = right[j], w->d_eta[j] = right[t + j];
        for (int k = 0; k < N; k++) {
            w->offset[k] += right[t + j] * w->unit_offset[j * N + k];
            w->offset_e[k] += right[t + j] * w->unit_offset_e[j * N + k];
        }
    }
    forward(w, w->d_start, w->offset, w->offset_e, 1);
}

static double cost(const tr_work *w)
{
    const tr_problem *q = w->q;
    double twice = 0.0;
    for (int k = 0; k < q->stages; k++) {
        twice += q->movement_weight * w->u[k] * w->u[k];
        for (int o = 0; o < q->outputs; o++) {
            const double e = w->error[k * q->outputs + o];
            twice += q->weight[k * q->outputs + o] * e * e;
        }
    }
    for (int j = 0; j < q->ends; j++) twice += w->end_error[j] * w->end_error[j];
    return 0.5 * twice + q->constant;
}

static void move(int count, double step, const double *restrict by, double *restrict what)
{
    for (int i = 0; i < count; i++) what[i] += step * by[i];
}

/* Move everything by a part of the Newton step. */
static void advance(tr_work *w, double step)
{
    const tr_problem *q = w->q;
    const int N = q->stages;
    move(N, step, w->du, w->u);
    if (q->nodes) {
        move(N, step, w->de, w->e);
        move(N, step, w->d_current, w->current), move(N, step, w->d_command, w->command);
    }
    move(N * q->outputs, step, w->d_error, w->error);
    move(q->ends, step, w->d_end_error, w->end_error);
    for (int i = 0; i < w->blocks; i++) w->V[i] += step * w->dV[i];
    for (tr_side *z = w->side; z < w->side + 2; z++)
        for (int i = 0; i < w->blocks; i++) z->s[i] += step * z->ds[i], z->l[i] += step * z->dl[i];
    if (q->repeated)
        for (int i = 0; i < q->nodes; i++) w->theta[i] += step * w->d_start[i], w->eta[i] += step * w->d_eta[i];
    roll_heat(w);
}

/* Start at rest, where symmetric limits have all their room, slacks and multipliers well inside. Returns the number of
 * limits. */
static double begin(tr_work *w)
{
    const tr_problem *q = w->q;
    const int N = q->stages, rows = (N + 1) * q->rows;
    static const double nothing[MOST_NODES] = {0};
    int moves = q->nodes > 0;
    for (int k = q->free_stages; k < N; k++) {
        w->offset[k] = q->rule_offset[k - q->free_stages];
        moves = moves || w->offset[k] != 0.0;
    }
    if (q->nodes)
        for (int k = 0; k < N; k++) w->offset_e[k] = 1.0;
    if (moves) {
        forward(w, nothing, w->offset, w->offset_e, 1);
        advance(w, 1.0);
    }
    for (int k = 0; k < N; k++)
        for (int o = 0; o < q->outputs; o++) w->error[k * q->outputs + o] -= q->reference[k * q->outputs + o];
    for (int j = 0; j < q->ends; j++) w->end_error[j] -= q->end_target[j];
    double count = 0.0;
    for (tr_side *z = w->side; z < w->side + 2; z++)
        for (int i = 0; i < rows; i++) count += AT(z->there, i);
    const double product = FIRST_GAP * fmax(cost(w), 1.0) / fmax(count, 1.0);
    for (tr_side *z = w->side; z < w->side + 2; z++)
        for (int i = 0; i < rows; i++) {
            if (AT(z->there, i) == 0.0) continue;
            AT(z->s, i) = fmax(z->sign * (AT(w->V, i) - AT(z->bound, i)), 0.1);
            AT(z->l, i) = product / AT(z->s, i);
        }
    return count;
}

/* Residuals of the slacks, the inverse slacks, and the gradients of the rows. */
static void judge_rows(tr_work *w, tr_state *found)
{
    lanes sum = {0}, most = {0};
    for (const tr_side *z = w->side; z < w->side + 2; z++)
        for (int i = 0; i < w->blocks; i++) {
            const lanes residual = z->there[i] * (z->sign * (w->V[i] - z->bound[i]) - z->s[i]), below = -residual;
            z->inverse[i] = 1.0 / z->s[i];
            z->residual[i] = residual;
            sum += z->s[i] * z->l[i];
            raise_to(&most, &residual);
            raise_to(&most, &below);
        }
    for (int i = 0; i < w->blocks; i++) w->y[i] = w->side[1].l[i] - w->side[0].l[i];
    found->complementarity = total(&sum);
    found->residual = largest(&most);
}

/* Where the iterate stands; leaves the gradient by the movements in `offset` and the heat's prices. */
static tr_state judge(tr_work *w)
{
    const tr_problem *q = w->q;
    const int N = q->stages;
    tr_state found = {0.0, 0.0, 0.0, cost(w)};
    double end[MOST_NODES] = {0}, closure[MOST_NODES];
    lanes sum = {0};
    judge_rows(w, &found);
    closure_price(w, w->eta, end);
    backward(w, end, 1, w->offset, w->offset_e, 0);
    double command = 0.0;
    for (int k = 0; k < q->free_stages; k++) {
        const double after = k + 1 < q->free_stages ? w->offset[k + 1] : 0.0;
        command += w->u[k];
        AT(&sum, k % WIDTH) += fabs(w->offset[k] - after) * (q->command_bound + fabs(command));
    }
    for (int k = 0; q->nodes && k < N; k++) AT(&sum, k % WIDTH) += 2.0 * fabs(w->offset_e[k]);
    found.stationarity = total(&sum);
    if (q->repeated) {
        closure_residual(w, closure);
        for (int i = 0; i < q->nodes; i++) {
            found.residual = fmax(found.residual, fabs(closure[i]));
            found.stationarity += fabs(w->p0[i] + w->eta[i]);
        }
    }
    return found;
}

/* Weights and gradients of the rows for a step that aims at s l = target, or at 0. */
static void aim(tr_work *w, int corrector)
{
    const tr_side *low = w->side, *up = low + 1;
    for (int i = 0; i < w->blocks; i++) {
        const lanes of_low = low->l[i] * low->inverse[i], of_up = up->l[i] * up->inverse[i];
        w->sigma[i] = of_low + of_up;
        w->y[i] = of_low * low->residual[i] - of_up * up->residual[i];
        if (corrector) w->y[i] += up->target[i] * up->inverse[i] - low->target[i] * low->inverse[i];
    }
}

/* Steps of slacks and multipliers that belong to the Newton step; the longest part of it, at most 1, that leaves
 * `rest` of each. */
static double slack_steps(tr_work *w, int corrector, double rest)
{
    lanes fastest = {0}; /* fall relative to the value */
    fastest += 1.0 - rest;
    for (const tr_side *z = w->side; z < w->side + 2; z++)
        for (int i = 0; i < w->blocks; i++) {
            const lanes ds = z->there[i] * (z->sign * w->dV[i] + z->residual[i]), of_s = -ds * z->inverse[i];
            lanes dl = z->l[i] * (of_s - 1.0);
            if (corrector) dl += z->target[i] * z->inverse[i];
            const lanes of_l = -dl / (z->l[i] + LEAST);
            z->ds[i] = ds;
            z->dl[i] = dl;
            raise_to(&fastest, &of_s);
            raise_to(&fastest, &of_l);
        }
    return (1.0 - rest) / largest(&fastest);
}

/* Mehrotra's target: the cube of what the predictor leaves, but no product below `least`, less that of its steps. */
static void centre(tr_work *w, double step, double mean, double count, double least)
{
    lanes sum = {0};
    for (const tr_side *z = w->side; z < w->side + 2; z++)
        for (int i = 0; i < w->blocks; i++)
            sum += (z->s[i] + step * z->ds[i]) * (z->l[i] + step * z->dl[i]);
    const double ratio = total(&sum) / count / mean, level = fmax(ratio * ratio * ratio * mean, least);
    for (const tr_side *z = w->side; z < w->side + 2; z++)
        for (int i = 0; i < w->blocks; i++) z->target[i] = z->there[i] * (level - z->ds[i] * z->dl[i]);
}

/* The iterate that `judge` has just seen, as the result. */
static void keep(const tr_work *w, const tr_state *now, tr_result *r)
{
    const tr_problem *q = w->q;
    const size_t stages = (size_t)q->stages, rows = (stages + 1) * (size_t)q->rows;
    double command = 0.0;
    for (size_t k = 0; k < stages; k++) r->command[k] = command += w->u[k];
    if (q->nodes) memcpy(r->size, w->e, stages * sizeof(double));
    memcpy(r->gradient, w->offset, stages * sizeof(double));
    memcpy(r->lower, w->side[0].l, rows * sizeof(double));
    memcpy(r->upper, w->side[1].l, rows * sizeof(double));
    for (int i = 0; i < q->nodes; i++) r->start[i] = w->theta[i];
    r->objective = now->objective;
    r->gap = now->complementarity + now->stationarity;
    r->residual = now->residual;
}

static int solve(const tr_problem *q, const tr_options *options, double *space, tr_result *r, tr_watch *watch)
{
    tr_work work, *w = &work;
    prepare(w, q, space, 0, watch);
    const double count = begin(w);
    double best = INFINITY, end[MOST_NODES] = {0};
    for (int since = 0;; r->iterations++, since++) {
        const tr_state now = judge(w);
        const double allowed = options->tolerance * fmax(now.objective, 1.0);
        const double gap = (now.complementarity + now.stationarity) / allowed;
        const double measure = fmax(gap, now.residual / options->tolerance);
        const int number = gap < INFINITY && now.residual < INFINITY;
        if (number && measure < best) best = measure, since = 0;
        const int near = best <= NEAR;
        if (number && (since == 0 || !near)) keep(w, &now, r);
        if (number && measure <= 1.0) return TR_SOLVED;
        if (near && (!number || since >= PATIENCE)) return TR_ACCURACY;
        if (!number) return TR_BREAKDOWN;
        if (r->iterations >= options->max_iterations) return near ? TR_ACCURACY : TR_ITERATION_LIMIT;
        aim(w, 0);
        if (interrupted(watch)) return TR_INTERRUPTED;
        closure_price(w, w->eta, end);
        /* The closure takes costates of its own in between. */
        const double *along = q->repeated ? NULL : end;
        int failed = factor(w, 1, along);
        if (failed == TR_BREAKDOWN) failed = factor(w, 0, along);
        if (failed) return failed == TR_BREAKDOWN && near ? TR_ACCURACY : failed;
        if (q->repeated) close_course(w);
        newton(w, along != NULL);
        if (count > 0.0) {
            const double step = slack_steps(w, 0, 0.0);
            centre(w, step, now.complementarity / count, count, LAST_GAP * allowed / count);
            aim(w, 1);
            newton(w, 0);
        }
        /* Closer to the limits as they matter less: the last iterations then gain more than two digits each. Not with
         * sizes, whose two rows share a multiplier: how, only a centred iterate tells. */
        const double left = NEARNESS * now.complementarity / fmax(now.objective, 1.0);
        const double step = slack_steps(w, count > 0.0, q->nodes ? FARTHEST : fmin(FARTHEST, fmax(left, NEAREST)));
        if (!(step > SHORTEST)) return near ? TR_ACCURACY : TR_STALLED;
        advance(w, step);
    }
}

static int linear(const tr_problem *q, double tolerance, int factored, double *space, tr_result *r, tr_watch *watch)
{
    tr_work work, *w = &work;
    prepare(w, q, space, factored, watch);
    const int failed = factored ? 0 : factor(w, 0, NULL);
    if (failed) return failed;
    begin(w);
    for (double best = INFINITY;;) {
        newton(w, 0);
        advance(w, 1.0);
        r->iterations++;
        const tr_state now = judge(w);
        const int better = now.stationarity < best;
        if (better) best = now.stationarity, keep(w, &now, r);
        if (best <= tolerance * fmax(now.objective, 1.0)) return TR_SOLVED;
        if (!better || r->iterations > REFINEMENTS) return best < INFINITY ? TR_ACCURACY : TR_BREAKDOWN;
    }
}

/* A multiplier times the size of its slack; nothing where there is no bound. */
ALWAYS_INLINE double paired_with(const double multiplier, const double slack)
{
    return multiplier != 0.0 && fabs(slack) < INFINITY ? multiplier * fabs(slack) : 0.0;
}

/* The larger of both; what is no number stays none. */
ALWAYS_INLINE double largest_of(const double so_far, const double next)
{
    return next > so_far || next != next ? next : so_far;
}

static void prove(const tr_problem *q, double *space, tr_proof *proof)
{
    tr_work work, *w = &work;
    const int N = q->stages, m = q->rows, ny = q->outputs, n = q->states, last = n - 1, blocks = BLOCKS(n);
    lanes x[MOST_BLOCKS], next[MOST_BLOCKS], p[MOST_BLOCKS], rule[MOST_BLOCKS];
    size_t taken;
    while ((uintptr_t)space % (WIDTH * sizeof(double))) space++;
    memset(w, 0, sizeof *w);
    lay_out(w, q, space, &taken);
    pad(w);
    memset(rule, 0, sizeof rule);
    memset(x, 0, sizeof x);
    memset(p, 0, sizeof p);
    proof->slack = proof->residual = proof->dual_residual = proof->by_command = proof->by_movement = 0.0;
    for (int i = 0; i < m; i++) proof->excess[i] = -INFINITY;
    for (int k = 0; k < N; k++) {
        const double u = w->u[k] = proof->command[k] - (k ? proof->command[k - 1] : 0.0);
        for (int o = 0; o < ny; o++)
            w->error[k * ny + o] = q->E[o] * u + dot(blocks, w->C + o * blocks, x) - q->reference[k * ny + o];
        for (int i = 0; i < m; i++) {
            const int at = k * m + i;
            double v = q->d[i] * u;
            for (int j = w->from[i]; j < w->to[i]; j++) v += AT(w->G + i * blocks, j) * AT(x, j);
            const double above = v - proof->upper[at], below = proof->lower[at] - v;
            proof->excess[i] = largest_of(largest_of(proof->excess[i], above), below);
            if (!proof->by_upper) continue;
            proof->slack += paired_with(proof->by_upper[at], above) + paired_with(proof->by_lower[at], below);
        }
        if (k >= q->free_stages) {
            memcpy(rule, q->rule_gain + (k - q->free_stages) * n, (size_t)n * sizeof(double));
            const double left = fabs(u - dot(blocks, rule, x) - q->rule_offset[k - q->free_stages]);
            proof->residual = largest_of(proof->residual, left);
            proof->slack += fabs(proof->by_rule[k - q->free_stages]) * left;
        }
        flow(last, blocks, w, x, u, next);
        memcpy(x, next, sizeof x);
    }
    for (int j = 0; j < q->ends; j++) {
        w->end_error[j] = dot(blocks, w->Z + j * blocks, x) - q->end_target[j];
        add(blocks, w->end_error[j], w->Z + j * blocks, p);
    }
    proof->objective = cost(w);
    double later = 0.0;
    for (int k = N - 1; k >= 0; k--) {
        double by_movement = dot(blocks, w->push, p) + q->movement_weight * w->u[k];
        flow_back(blocks, w, p, next);
        for (int o = 0; o < ny; o++) {
            const double by_error = q->weight[k * ny + o] * w->error[k * ny + o];
            by_movement += q->E[o] * by_error;
            add(blocks, by_error, w->C + o * blocks, next);
        }
        for (int i = 0; proof->by_upper && i < m; i++) {
            const double by_row = proof->by_upper[k * m + i] - proof->by_lower[k * m + i];
            by_movement += q->d[i] * by_row;
            add(blocks, by_row, w->G + i * blocks, next);
        }
        if (k >= q->free_stages) {
            const double by_rule = proof->by_rule[k - q->free_stages];
            memcpy(rule, q->rule_gain + (k - q->free_stages) * n, (size_t)n * sizeof(double));
            by_movement += by_rule;
            add(blocks, -by_rule, rule, next);
        }
        memcpy(p, next, sizeof p);
        /* A command moves by its own movement and against the next. */
        const double by_command = fabs(by_movement - later);
        proof->dual_residual = largest_of(proof->dual_residual, by_command);
        proof->by_command += by_command * (q->command_bound + fabs(proof->command[k]));
        proof->by_movement += by_movement * by_movement;
        later = by_movement;
    }
    proof->by_movement /= 2.0 * q->movement_weight;
}
#endif
