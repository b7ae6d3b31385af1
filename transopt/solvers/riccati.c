/* A primal-dual interior-point method over the stages of one transient.
 *
 *     minimise    1/2 sum_k w_k |C x_k + E u_k - r_k|^2 + 1/2 s u_k^2
 *     subject to  x_(k+1) = A x_k + A[:, n-1] u_k,  x_0 = 0,
 *                 th_(k+1) = M th_k + b (gain_k + copper th_w,k) h_k,  th_0 = 0 or th_0 = F th_N + f,
 *                 h_k = quadratic in (current, command) + 2 ripple e_k + ripple^2,
 *                 u_k = f_k' x_k + g_k over the last stages (the hand-over),
 *                 lower_k <= G x_k + d u_k + d_size e_k <= upper_k,  the winding th_w,k being the first row.
 *
 * The movement u and the size e of the mean current are the controls; x_(n-1) is the command held before. Predictor and
 * corrector follow Mehrotra (SIAM J. Optim. 2, 1992); each Newton step is a Riccati recursion (Rao, Wright, Rawlings,
 * J. Optim. Theory Appl. 99, 1998), in which the size is eliminated before the movement. Every iterate obeys the
 * dynamics exactly: states are rolled out, the reduced gradient comes from the adjoint recursion, so rounding in a
 * factorisation costs a step's quality and never the answer's.
 *
 * C99 without dependencies, no global state, no allocation: the caller gives the workspace. Compile with contraction of
 * floating-point expressions off. All arrays are row by row.
 */
#include <math.h>
#include <stddef.h>
#include <string.h>

#define MOST_STATES 48
#define MOST_NODES 2
#define MOST_ROWS 16

typedef struct {
    int stages, free_stages, states, outputs, rows, nodes;
    int current;  /* state that is the current; -1: it is the command */
    int repeated; /* th_0 = F th_N + f */
    const double *A, *C, *E;                 /* (n, n), (outputs, n), (outputs) */
    const double *weight, *reference;        /* (N), (N) */
    const double *rule_gain, *rule_offset;   /* (N - free, n), (N - free) */
    const double *G, *d, *d_size;            /* (rows, n), (rows), (rows) */
    const double *lower, *upper;             /* (N + 1, rows), infinite where there is no limit */
    const double *M, *b, *gain, *square;     /* (nodes, nodes), (nodes), (N), (3): i_k^2, i_k i_(k+1), i_(k+1)^2 */
    const double *F, *f;                     /* (nodes, nodes), (nodes) */
    double movement_weight, decay, ripple, copper;
    double command_bound;                    /* on |x_(n-1) + u|, for the gap */
} tr_problem;

typedef struct {
    int max_iterations;
    double tolerance; /* on the gap, relative to max(objective, 1), and on residuals */
} tr_options;

typedef struct {
    double *movement, *size;   /* (N), (N) */
    double *lower, *upper;     /* (N + 1, rows) multipliers */
    double *gradient;          /* (N) of the Lagrangian by u, the rule fed back */
    double *start;             /* (nodes) th_0 */
    int iterations;
    double objective, gap, residual;
} tr_result;

enum { TR_SOLVED, TR_ACCURACY, TR_ITERATION_LIMIT, TR_STALLED, TR_BREAKDOWN, TR_TOO_LARGE };

static const double NEAR = 1e3;       /* times the tolerance: from here on the best iterate counts */
static const double SHORTEST = 1e-12; /* part of a Newton step that is still one */
static const double FARTHEST = 5e-3;  /* part of slacks and multipliers that a step leaves */
static const double NEAREST = 1e-9, NEARNESS = 0.1;
static const int PATIENCE = 6;        /* iterations without a better iterate */
static const int REFINEMENTS = 4;     /* of a linear pass, each one more step with the same gains */

#if defined(__GNUC__)
#define ALWAYS_INLINE static inline __attribute__((always_inline))
#else
#define ALWAYS_INLINE static inline
#endif
/* The same code for wider registers, chosen when the library is loaded; no operation is contracted or reordered. */
#if defined(__GNUC__) && !defined(__clang__) && defined(__x86_64__) && defined(__gnu_linux__) && \
    !defined(__SANITIZE_ADDRESS__)
#define CLONES __attribute__((target_clones("avx512f", "avx2", "default")))
#else
#define CLONES
#endif

/* One side of every row: slack s = sign (value - bound), s * l -> 0. Where `there` is 0 there is no limit: l = 0. */
typedef struct {
    double sign;
    double *there, *bound, *s, *l, *inverse, *residual, *ds, *dl, *target;
} tr_side;

/* Everything that lives during one solve. Differences carry a d: dE is the change of `error` by a Newton step. */
typedef struct {
    const tr_problem *q;
    int ld;                              /* row length of (n + nodes, n + nodes) matrices */
    double *At, *Acol, *Cp;              /* padded A, its transpose, C */
    double *K, *pivot, *Ke, *Ke_u, *pivot_e; /* gains of u and e, inverse pivots */
    double *offset, *offset_e;           /* Newton step without feedback */
    double *u, *e, *du, *de;
    double *error, *d_error;
    double *current, *command, *d_current, *d_command; /* i_k, c_k */
    double *heat;                        /* (N, 4): dh/di, dh/dc, times resistance; resistance; copper h */
    double *theta;                       /* (N + 1, nodes) */
    double *by_heat;                     /* (N) b' costate of th_(k+1) */
    double *V, *dV, *sigma, *y;          /* rows: values, weights, gradients */
    tr_side side[2];                     /* their lower and their upper limits */
    double *unit_offset, *unit_offset_e; /* (nodes, N) response to the closure's multiplier */
    double *still;                       /* (N) zeros */
    /* At the ends of the horizon: cost to go in th_0, its gradient, th_N of a step; the closure's multiplier. */
    double P0[MOST_NODES * MOST_NODES], p0[MOST_NODES], th_end[MOST_NODES];
    double eta[MOST_NODES], d_eta[MOST_NODES], d_start[MOST_NODES];
    double closing[4 * MOST_NODES * MOST_NODES]; /* matrix of the closure's equations */
    int from[MOST_ROWS], to[MOST_ROWS];          /* states between which a row of G has all that is not zero */
} tr_work;

static size_t padded(size_t n) { return (n + 3) & ~(size_t)3; }

/* Doubles of workspace that a problem needs; 0 if it is too large for this method. */
size_t tr_workspace(const tr_problem *q)
{
    if (q->states < 1 || q->nodes < 0 || q->nodes > MOST_NODES || q->states + q->nodes > MOST_STATES) return 0;
    if (q->rows < 0 || q->rows > MOST_ROWS) return 0;
    const size_t N = (size_t)q->stages, m = (size_t)q->rows, ny = (size_t)q->outputs, t = (size_t)q->nodes;
    const size_t ld = padded((size_t)q->states + t);
    return (2 * ld + ny) * ld + N * (2 * ld + 19 + 2 * ny + 2 * t) + (N + 1) * (t + 22 * m);
}

static double *take(double **rest, size_t count)
{
    double *found = *rest;
    *rest += count;
    return found;
}

/* Arrays in the workspace, all zero but, with `keep_gains`, what a factorisation left: it stands in front. */
static void lay_out(tr_work *w, const tr_problem *q, double *rest, int keep_gains)
{
    const size_t N = (size_t)q->stages, m = (N + 1) * (size_t)q->rows, ny = (size_t)q->outputs, t = (size_t)q->nodes;
    const size_t n = (size_t)q->states, ld = padded(n + t);
    const size_t kept = keep_gains ? (2 * ld + ny) * ld + N * (ld + 1) : 0;
    memset(rest + kept, 0, (tr_workspace(q) - kept) * sizeof(double));
    w->q = q;
    w->ld = (int)ld;
    w->At = take(&rest, ld * ld), w->Acol = take(&rest, ld * ld), w->Cp = take(&rest, ny * ld);
    w->K = take(&rest, N * ld), w->pivot = take(&rest, N);
    w->Ke = take(&rest, N * ld), w->Ke_u = take(&rest, N), w->pivot_e = take(&rest, N);
    w->offset = take(&rest, N), w->offset_e = take(&rest, N);
    w->u = take(&rest, N), w->e = take(&rest, N), w->du = take(&rest, N), w->de = take(&rest, N);
    w->error = take(&rest, N * ny), w->d_error = take(&rest, N * ny);
    w->current = take(&rest, N), w->command = take(&rest, N);
    w->d_current = take(&rest, N), w->d_command = take(&rest, N);
    w->heat = take(&rest, 4 * N), w->by_heat = take(&rest, N);
    w->unit_offset = take(&rest, N * t), w->unit_offset_e = take(&rest, N * t);
    w->still = take(&rest, N), w->theta = take(&rest, (N + 1) * t);
    w->V = take(&rest, m), w->dV = take(&rest, m), w->sigma = take(&rest, m), w->y = take(&rest, m);
    for (int side = 0; side < 2; side++) {
        tr_side *z = w->side + side;
        const double *limit = side ? q->upper : q->lower;
        z->sign = side ? -1.0 : 1.0;
        z->l = take(&rest, m);
        z->there = take(&rest, m), z->bound = take(&rest, m), z->s = take(&rest, m), z->inverse = take(&rest, m);
        z->residual = take(&rest, m), z->ds = take(&rest, m), z->dl = take(&rest, m), z->target = take(&rest, m);
        for (size_t i = 0; i < m; i++) {
            z->s[i] = 1.0, z->l[i] = 0.0;
            if (limit[i] > -INFINITY && limit[i] < INFINITY) z->there[i] = 1.0, z->bound[i] = limit[i];
        }
    }
    for (size_t i = 0; i < n; i++)
        for (size_t j = 0; j < n; j++) w->At[i * ld + j] = w->Acol[j * ld + i] = q->A[i * n + j];
    for (size_t s = 0; s < ny; s++) memcpy(w->Cp + s * ld, q->C + s * n, n * sizeof(double));
    for (int j = 0; j < q->rows; j++) {
        const double *c = q->G + (size_t)j * n;
        w->from[j] = 0, w->to[j] = q->states;
        while (w->to[j] > 0 && c[w->to[j] - 1] == 0.0) w->to[j]--;
        while (w->from[j] < w->to[j] && c[w->from[j]] == 0.0) w->from[j]++;
    }
}

/* Z = X Y for z columns, or only the upper triangle with its diagonal blocks; rows and columns are padded with zeros. */
ALWAYS_INLINE void multiply(const int z, const int ld, const double *restrict X, const double *restrict Y,
                            double *restrict Z, const int upper)
{
    for (int i = 0; i < z; i += 2)
        for (int j = upper ? (i & ~3) : 0; j < z; j += 4) {
            double a0 = 0, a1 = 0, a2 = 0, a3 = 0, b0 = 0, b1 = 0, b2 = 0, b3 = 0;
            for (int l = 0; l < z; l++) {
                const double a = X[i * ld + l], b = X[(i + 1) * ld + l];
                const double *y = Y + l * ld + j;
                a0 += a * y[0], a1 += a * y[1], a2 += a * y[2], a3 += a * y[3];
                b0 += b * y[0], b1 += b * y[1], b2 += b * y[2], b3 += b * y[3];
            }
            double *first = Z + i * ld + j, *second = first + ld;
            first[0] = a0, first[1] = a1, first[2] = a2, first[3] = a3;
            second[0] = b0, second[1] = b1, second[2] = b2, second[3] = b3;
        }
}

/* Add weight c c' to the upper triangle of H. */
ALWAYS_INLINE void add_square(const int z, const int ld, double weight, const double *restrict c, double *restrict H)
{
    for (int i = 0; i < z; i++) {
        const double by = weight * c[i];
        for (int j = i & ~3; j < ld; j++) H[i * ld + j] += by * c[j];
    }
}

static void add_at(double *H, int ld, int i, int j, double value)
{
    H[i < j ? i * ld + j : j * ld + i] += value;
}

/* Add outer product c d' to the upper triangle of H; both padded with zeros. */
ALWAYS_INLINE void add_product(const int z, const int ld, const double *restrict c, const double *restrict d,
                               double *restrict H)
{
    for (int i = 0; i < z; i++)
        for (int j = i & ~3; j < ld; j++) H[i * ld + j] += c[i] * d[j];
}

/* What the nodes add to H = A' P A: their flow is [B M] with B in the columns of current and command only.
 *
 * Cost to go P (states), Q (nodes, n), R (nodes, nodes). In: H = A' P A of the states. Out: H of the states, HQ and HR;
 * U = A' Q' + B' R and RM = R M, which are the nodes' rows of P A.
 */
ALWAYS_INLINE void add_nodes(const int n, const int t, const int ld, const tr_work *w, const double *heat,
                             const double *restrict Q, const double *restrict R, double *restrict H,
                             double *restrict HQ, double *restrict HR, double *restrict U, double *restrict RM)
{
    const tr_problem *q = w->q;
    const int last = n - 1, a = q->current;
    double M[MOST_NODES * MOST_NODES], by_current[MOST_STATES] = {0}, by_command[MOST_STATES] = {0};
    double cc = 0.0, cd = 0.0, dd = 0.0;
    for (int i = 0; i < t; i++)
        for (int j = 0; j < t; j++) M[i * t + j] = q->M[i * t + j] + (j == 0 ? q->b[i] * heat[3] : 0.0);
    for (int i = 0; i < t; i++) {
        double *u = U + i * ld;
        for (int j = 0; j < ld; j++) u[j] = w->At[j] * Q[i * ld];
        for (int l = 1; l < n; l++) {
            const double v = Q[i * ld + l];
            for (int j = 0; j < ld; j++) u[j] += w->At[l * ld + j] * v;
        }
        const double c = a >= 0 ? q->b[i] * heat[0] : 0.0, d = q->b[i] * heat[1];
        for (int j = 0; j < n; j++) by_current[j] += u[j] * c, by_command[j] += u[j] * d;
        double rb = 0.0;
        for (int j = 0; j < t; j++) rb += R[i * t + j] * q->b[j];
        cc += c * rb * heat[0], cd += c * rb * heat[1], dd += d * rb * heat[1];
        if (a >= 0) u[a] += heat[0] * rb;
        u[last] += heat[1] * rb;
        for (int j = 0; j < t; j++) {
            RM[i * t + j] = 0.0;
            for (int l = 0; l < t; l++) RM[i * t + j] += R[i * t + l] * M[l * t + j];
        }
    }
    for (int j = 0; j < n; j++) {
        if (a >= 0) add_at(H, ld, j, a, by_current[j]);
        add_at(H, ld, j, last, by_command[j]);
    }
    if (a >= 0) {
        add_at(H, ld, a, a, by_current[a] + cc);
        add_at(H, ld, a, last, cd);
    }
    add_at(H, ld, last, last, by_command[last] + dd);
    for (int i = 0; i < t; i++) {
        for (int j = 0; j < ld; j++) HQ[i * ld + j] = U[j] * M[i];
        for (int l = 1; l < t; l++)
            for (int j = 0; j < ld; j++) HQ[i * ld + j] += U[l * ld + j] * M[l * t + i];
        for (int j = 0; j < t; j++) {
            HR[i * t + j] = 0.0;
            for (int l = 0; l < t; l++) HR[i * t + j] += M[l * t + i] * RM[l * t + j];
        }
    }
}

/* Backward: gains of u and e from the weights `sigma` of the rows. With `curved` the copper's bilinear terms are in. */
ALWAYS_INLINE int factor_sized(const int n, const int t, const int ld, tr_work *w, const int curved)
{
    const tr_problem *q = w->q;
    const int N = q->stages, m = q->rows, z = n + t, last = n - 1, a = q->current;
    double P[MOST_STATES * MOST_STATES], PA[MOST_STATES * MOST_STATES], H[MOST_STATES * MOST_STATES];
    double hu[MOST_STATES], he[MOST_STATES], hu_x[MOST_STATES], he_x[MOST_STATES], g_x[MOST_STATES];
    double Q[MOST_NODES * MOST_STATES], HQ[MOST_NODES * MOST_STATES], U[MOST_NODES * MOST_STATES];
    double R[MOST_NODES * MOST_NODES], HR[MOST_NODES * MOST_NODES], RM[MOST_NODES * MOST_NODES];
    const double e1 = q->decay, e2 = 1.0 - e1, *s = q->square;
    const double haa = t ? 2.0 * (s[0] + s[1] * e1 + s[2] * e1 * e1) : 0.0;
    const double hac = t ? (s[1] + 2.0 * s[2] * e1) * e2 : 0.0, hcc = t ? 2.0 * s[2] * e2 * e2 : 0.0;
    memset(P, 0, (size_t)(ld * ld) * sizeof(double));
    memset(hu_x, 0, sizeof hu_x);
    memset(he_x, 0, sizeof he_x);
    memset(g_x, 0, sizeof g_x);
    memset(Q, 0, sizeof Q);
    memset(R, 0, sizeof R);
    if (t) R[0] = w->sigma[N * m];
    for (int k = N - 1; k >= 0; k--) {
        const double *heat = w->heat + 4 * k, *sigma = w->sigma + k * m;
        multiply(n, ld, P, w->At, PA, 0);
        multiply(n, ld, w->Acol, PA, H, 1);
        if (t) add_nodes(n, t, ld, w, heat, Q, R, H, HQ, HR, U, RM);
        for (int i = 0; i < n; i++) hu[i] = H[i * ld + last];
        for (int j = 0; j < t; j++) hu[n + j] = HQ[j * ld + last];
        double r = hu[last] + q->movement_weight, hee = 0.0, heu = 0.0;
        for (int o = 0; o < q->outputs; o++) {
            add_square(n, ld, q->weight[k], w->Cp + o * ld, H);
            const double direct = q->weight[k] * q->E[o];
            if (direct != 0.0) {
                for (int i = 0; i < n; i++) hu[i] += direct * w->Cp[o * ld + i];
                r += direct * q->E[o];
            }
        }
        if (t) {
            /* e moves the nodes only: column 2 ripple resistance b. */
            const double by = 2.0 * q->ripple * heat[2];
            for (int j = 0; j < z; j++) he[j] = 0.0;
            for (int i = 0; i < t; i++) {
                for (int j = 0; j < n; j++) he[j] += by * q->b[i] * U[i * ld + j];
                for (int j = 0; j < t; j++) {
                    he[n + j] += by * q->b[i] * RM[i * t + j];
                    hee += by * by * q->b[i] * q->b[j] * R[i * t + j];
                }
            }
            heu = he[last];
            /* Curvature of the heat, weighed by what a kelvin at the next instant costs. */
            const double price = w->by_heat[k], bend = price * heat[2];
            if (a >= 0) {
                add_at(H, ld, a, a, bend * haa);
                add_at(H, ld, a, last, bend * hac);
                hu[a] += bend * hac;
            }
            add_at(H, ld, last, last, bend * hcc);
            hu[last] += bend * hcc;
            r += bend * hcc;
            if (curved && heat[2] > 0.0) {
                const double cross = price * q->copper / heat[2];
                if (a >= 0) HQ[a] += cross * heat[0];
                HQ[last] += cross * heat[1];
                hu[n] += cross * heat[1];
                he[n] += price * q->copper * 2.0 * q->ripple;
            }
            HR[0] += sigma[0];
        }
        for (int j = t ? 1 : 0; j < m; j++) {
            const double weight = sigma[j];
            if (weight == 0.0) continue;
            const double *c = q->G + j * n, d = weight * q->d[j], size = weight * q->d_size[j];
            for (int i = w->from[j]; i < w->to[j]; i++) {
                const double by = weight * c[i];
                for (int l = i; l < w->to[j]; l++) H[i * ld + l] += by * c[l];
                hu[i] += d * c[i];
                if (t) he[i] += size * c[i];
            }
            r += d * q->d[j];
            heu += size * q->d[j];
            hee += size * q->d_size[j];
        }
        double *gain = w->K + k * ld, *gain_e = w->Ke + k * ld;
        if (t) {
            if (!(hee > 0.0)) return 1;
            const double inverse = 1.0 / hee;
            w->pivot_e[k] = inverse;
            w->Ke_u[k] = -heu * inverse;
            for (int i = 0; i < z; i++) gain_e[i] = -he[i] * inverse;
            for (int i = 0; i < z; i++) hu[i] += heu * gain_e[i];
            for (int i = 0; i < n; i++) he_x[i] = he[i], g_x[i] = gain_e[i];
            add_product(n, ld, he_x, g_x, H);
            for (int j = 0; j < t; j++) {
                for (int i = 0; i < n; i++) HQ[j * ld + i] += he[i] * gain_e[n + j];
                for (int i = 0; i < t; i++) HR[i * t + j] += he[n + i] * gain_e[n + j];
            }
            r += heu * w->Ke_u[k];
        }
        if (k >= q->free_stages) {
            const double *f = q->rule_gain + (k - q->free_stages) * n;
            for (int i = 0; i < n; i++) {
                gain[i] = f[i];
                for (int j = i; j < n; j++) H[i * ld + j] += f[i] * hu[j] + hu[i] * f[j] + f[i] * r * f[j];
                for (int j = 0; j < t; j++) HQ[j * ld + i] += f[i] * hu[n + j];
            }
        } else {
            if (!(r > 0.0)) return 1;
            const double inverse = 1.0 / r;
            w->pivot[k] = inverse;
            for (int i = 0; i < z; i++) gain[i] = -hu[i] * inverse;
            for (int i = 0; i < n; i++) hu_x[i] = hu[i], g_x[i] = gain[i];
            add_product(n, ld, hu_x, g_x, H);
            for (int j = 0; j < t; j++) {
                for (int i = 0; i < n; i++) HQ[j * ld + i] += hu[i] * gain[n + j];
                for (int i = 0; i < t; i++) HR[i * t + j] += hu[n + i] * gain[n + j];
            }
        }
        for (int i = 0; i < n; i++)
            for (int j = i; j < n; j++) P[i * ld + j] = P[j * ld + i] = H[i * ld + j];
        for (int j = 0; j < t; j++) {
            for (int i = 0; i < n; i++) Q[j * ld + i] = HQ[j * ld + i];
            for (int i = 0; i <= j; i++) R[i * t + j] = R[j * t + i] = HR[i * t + j];
        }
    }
    memcpy(w->P0, R, (size_t)(t * t) * sizeof(double));
    return 0;
}

/* Backward with the gains: steps without feedback into `offset`; without them: the gradient into `offset`, and the
 * heat's prices. `own` is 0 for the response to the closure's multiplier alone. */
ALWAYS_INLINE void backward_sized(const int n, const int ld, tr_work *w, const int t, const double *end, const int own,
                                  double *offset, double *offset_e, const int newton)
{
    const tr_problem *q = w->q;
    const int N = q->stages, m = q->rows, last = n - 1;
    double p[MOST_STATES], a[MOST_STATES], th[MOST_NODES] = {0};
    memset(p, 0, sizeof p);
    for (int i = 0; i < t; i++) th[i] = end[i];
    if (t && own) th[0] += w->y[N * m];
    for (int k = N - 1; k >= 0; k--) {
        const double *y = w->y + k * m;
        for (int j = 0; j < ld; j++) a[j] = w->At[j] * p[0];
        for (int l = 1; l < n; l++) {
            const double v = p[l];
            for (int j = 0; j < ld; j++) a[j] += w->At[l * ld + j] * v;
        }
        double by_size = 0.0, th_before[MOST_NODES] = {0};
        if (t) {
            const double *heat = w->heat + 4 * k;
            double beta = 0.0;
            for (int i = 0; i < t; i++) beta += q->b[i] * th[i];
            if (q->current >= 0) a[q->current] += heat[0] * beta;
            a[last] += heat[1] * beta;
            by_size = 2.0 * q->ripple * heat[2] * beta;
            for (int j = 0; j < t; j++)
                for (int i = 0; i < t; i++) th_before[j] += q->M[i * t + j] * th[i];
            th_before[0] += heat[3] * beta;
            if (!newton) w->by_heat[k] = beta;
        }
        double by_movement = a[last];
        if (own) {
            by_movement += q->movement_weight * w->u[k];
            for (int o = 0; o < q->outputs; o++) {
                const double v = q->weight[k] * w->error[k * q->outputs + o];
                by_movement += q->E[o] * v;
                for (int j = 0; j < ld; j++) a[j] += w->Cp[o * ld + j] * v;
            }
            if (t) th_before[0] += y[0];
            for (int j = t ? 1 : 0; j < m; j++) {
                const double v = y[j], *c = q->G + j * n;
                if (v == 0.0) continue;
                by_movement += q->d[j] * v;
                by_size += q->d_size[j] * v;
                for (int i = w->from[j]; i < w->to[j]; i++) a[i] += c[i] * v;
            }
        }
        if (newton) {
            const double *gain = w->K + k * ld, *gain_e = w->Ke + k * ld;
            if (t) {
                offset_e[k] = -by_size * w->pivot_e[k];
                by_movement += w->Ke_u[k] * by_size;
                for (int j = 0; j < n; j++) a[j] += gain_e[j] * by_size;
                for (int j = 0; j < t; j++) th_before[j] += gain_e[n + j] * by_size;
            }
            offset[k] = -by_movement * w->pivot[k];
            for (int j = 0; j < n; j++) p[j] = a[j] + gain[j] * by_movement;
            for (int j = 0; j < t; j++) th[j] = th_before[j] + gain[n + j] * by_movement;
        } else {
            offset[k] = by_movement;
            if (t) offset_e[k] = by_size;
            memcpy(p, a, (size_t)n * sizeof(double));
            if (k >= q->free_stages) {
                const double *f = q->rule_gain + (k - q->free_stages) * n;
                for (int j = 0; j < n; j++) p[j] += f[j] * by_movement;
            }
            for (int j = 0; j < t; j++) th[j] = th_before[j];
        }
    }
    for (int i = 0; i < t; i++) w->p0[i] = th[i];
}

/* Forward by the gains from x_0 = 0 and th_0 = `th`: what a step changes, to first order. */
ALWAYS_INLINE void forward_sized(const int n, const int ld, tr_work *w, const int t, const double *start,
                                 const double *offset, const double *offset_e, const int full)
{
    const tr_problem *q = w->q;
    const int N = q->stages, m = q->rows, last = n - 1;
    double x[MOST_STATES], next[MOST_STATES], th[MOST_NODES] = {0};
    memset(x, 0, sizeof x);
    for (int i = 0; i < t; i++) th[i] = start[i];
    for (int k = 0; k < N; k++) {
        const double *gain = w->K + k * ld;
        double u = offset[k], e = 0.0;
        for (int j = 0; j < n; j++) u += gain[j] * x[j];
        for (int j = 0; j < t; j++) u += gain[n + j] * th[j];
        if (t) {
            const double *gain_e = w->Ke + k * ld;
            e = offset_e[k] + w->Ke_u[k] * u;
            for (int j = 0; j < n; j++) e += gain_e[j] * x[j];
            for (int j = 0; j < t; j++) e += gain_e[n + j] * th[j];
        }
        if (full) {
            w->du[k] = u;
            w->de[k] = e;
            for (int o = 0; o < q->outputs; o++) {
                double v = q->E[o] * u;
                for (int j = 0; j < n; j++) v += w->Cp[o * ld + j] * x[j];
                w->d_error[k * q->outputs + o] = v;
            }
            if (t) w->dV[k * m] = th[0];
            for (int i = t ? 1 : 0; i < m; i++) {
                double v = q->d[i] * u + q->d_size[i] * e;
                for (int j = w->from[i]; j < w->to[i]; j++) v += q->G[i * n + j] * x[j];
                w->dV[k * m + i] = v;
            }
        }
        const double before = q->current >= 0 ? x[q->current] : 0.0;
        x[last] += u;
        if (full) w->d_current[k] = before, w->d_command[k] = x[last];
        if (t) {
            const double *heat = w->heat + 4 * k;
            const double h = heat[0] * before + heat[1] * x[last] + heat[3] * th[0] + 2.0 * q->ripple * heat[2] * e;
            double th_next[MOST_NODES];
            for (int i = 0; i < t; i++) {
                th_next[i] = q->b[i] * h;
                for (int j = 0; j < t; j++) th_next[i] += q->M[i * t + j] * th[j];
            }
            for (int i = 0; i < t; i++) th[i] = th_next[i];
        }
        for (int i = 0; i < ld; i++) next[i] = w->Acol[i] * x[0];
        for (int l = 1; l < n; l++) {
            const double v = x[l];
            for (int i = 0; i < ld; i++) next[i] += w->Acol[l * ld + i] * v;
        }
        memcpy(x, next, (size_t)n * sizeof(double));
    }
    if (full && t) w->dV[N * m] = th[0];
    for (int i = 0; i < t; i++) w->th_end[i] = th[i];
}

/* Sizes that are known when compiled keep their rows in registers. */
#define BY_SIZE(call)                                          \
    switch (w->q->nodes * 100 + w->q->states) {                \
    case 5: call(5, 0, 8);                                     \
    case 7: call(7, 0, 8);                                     \
    case 8: call(8, 0, 8);                                     \
    case 108: call(8, 1, 12);                                  \
    case 208: call(8, 2, 12);                                  \
    default: call(w->q->states, w->q->nodes, w->ld);           \
    }
#define FACTOR(n, t, ld) return factor_sized(n, t, ld, w, curved)
#define BACKWARD(n, t, ld) backward_sized(n, ld, w, t, end, own, offset, offset_e, newton); return
#define FORWARD(n, t, ld) forward_sized(n, ld, w, t, start, offset, offset_e, full); return

CLONES static int factor(tr_work *w, int curved)
{
    BY_SIZE(FACTOR)
}

CLONES static void backward(tr_work *w, const double *end, int own, double *offset, double *offset_e, int newton)
{
    BY_SIZE(BACKWARD)
}

CLONES static void forward(tr_work *w, const double *start, const double *offset, const double *offset_e, int full)
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
    for (int k = 0; k <= q->stages; k++) w->V[k * q->rows] = w->theta[k * t];
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

/* One Newton step for the gradients in `y`. */
static void newton(tr_work *w)
{
    const tr_problem *q = w->q;
    const int t = q->nodes, N = q->stages;
    double end[MOST_NODES] = {0}, right[2 * MOST_NODES];
    static const double nothing[MOST_NODES] = {0};
    closure_price(w, w->eta, end);
    backward(w, end, 1, w->offset, w->offset_e, 1);
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

static double objective(const tr_work *w)
{
    const tr_problem *q = w->q;
    double twice = 0.0;
    for (int k = 0; k < q->stages; k++) {
        twice += q->movement_weight * w->u[k] * w->u[k];
        for (int o = 0; o < q->outputs; o++) {
            const double e = w->error[k * q->outputs + o];
            twice += q->weight[k] * e * e;
        }
    }
    return 0.5 * twice;
}

/* Move everything by a part of the Newton step. */
static void advance(tr_work *w, double step)
{
    const tr_problem *q = w->q;
    const int N = q->stages, rows = (N + 1) * q->rows;
    for (int k = 0; k < N; k++) {
        w->u[k] += step * w->du[k], w->e[k] += step * w->de[k];
        w->current[k] += step * w->d_current[k], w->command[k] += step * w->d_command[k];
    }
    for (int i = 0; i < N * q->outputs; i++) w->error[i] += step * w->d_error[i];
    for (int i = 0; i < rows; i++) w->V[i] += step * w->dV[i];
    for (tr_side *z = w->side; z < w->side + 2; z++)
        for (int i = 0; i < rows; i++) z->s[i] += step * z->ds[i], z->l[i] += step * z->dl[i];
    if (q->repeated)
        for (int i = 0; i < q->nodes; i++) w->theta[i] += step * w->d_start[i], w->eta[i] += step * w->d_eta[i];
    roll_heat(w);
}

/* Start at rest, where symmetric limits have all their room, slacks and multipliers well inside. Returns the number of
 * limits. */
static double start(tr_work *w)
{
    const tr_problem *q = w->q;
    const int N = q->stages, n = q->states, rows = (N + 1) * q->rows;
    static const double nothing[MOST_NODES] = {0};
    int moves = q->nodes > 0;
    for (int k = q->free_stages; k < N; k++) {
        memcpy(w->K + k * w->ld, q->rule_gain + (k - q->free_stages) * n, (size_t)n * sizeof(double));
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
        for (int o = 0; o < q->outputs; o++) w->error[k * q->outputs + o] -= q->reference[k];
    const double scale = fmax(objective(w), 1.0) / 100.0;
    double count = 0.0;
    for (tr_side *z = w->side; z < w->side + 2; z++)
        for (int i = 0; i < rows; i++) {
            if (z->there[i] == 0.0) continue;
            z->s[i] = fmax(z->sign * (w->V[i] - z->bound[i]), 0.1);
            z->l[i] = scale / z->s[i];
            count += 1.0;
        }
    return count;
}

typedef struct {
    double complementarity, residual, stationarity, objective;
} tr_state;

/* Where the iterate stands; leaves the gradient by the movements in `offset` and the heat's prices. */
static tr_state judge(tr_work *w)
{
    const tr_problem *q = w->q;
    const int N = q->stages, rows = (N + 1) * q->rows;
    tr_state found = {0.0, 0.0, 0.0, objective(w)};
    double end[MOST_NODES] = {0}, closure[MOST_NODES];
    for (tr_side *z = w->side; z < w->side + 2; z++)
        for (int i = 0; i < rows; i++) {
            z->inverse[i] = 1.0 / z->s[i];
            z->residual[i] = z->there[i] * (z->sign * (w->V[i] - z->bound[i]) - z->s[i]);
            found.complementarity += z->s[i] * z->l[i];
            found.residual = fmax(found.residual, fabs(z->residual[i]));
        }
    for (int i = 0; i < rows; i++) w->y[i] = w->side[1].l[i] - w->side[0].l[i];
    closure_price(w, w->eta, end);
    backward(w, end, 1, w->offset, w->offset_e, 0);
    for (int k = 0; k < N; k++) {
        const double after = k + 1 < q->free_stages ? w->offset[k + 1] : 0.0;
        if (k < q->free_stages)
            found.stationarity += fabs(w->offset[k] - after) * (q->command_bound + fabs(w->command[k]));
        if (q->nodes) found.stationarity += 2.0 * fabs(w->offset_e[k]);
    }
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
CLONES static void aim(tr_work *w, int corrector)
{
    const tr_problem *q = w->q;
    const int rows = (q->stages + 1) * q->rows;
    const tr_side *low = w->side, *up = low + 1;
    double *restrict sigma = w->sigma, *restrict y = w->y;
    for (int i = 0; i < rows; i++) {
        const double of_low = low->l[i] * low->inverse[i], of_up = up->l[i] * up->inverse[i];
        sigma[i] = of_low + of_up;
        y[i] = of_low * low->residual[i] - of_up * up->residual[i];
    }
    if (!corrector) return;
    for (int i = 0; i < rows; i++) y[i] += up->target[i] * up->inverse[i] - low->target[i] * low->inverse[i];
}

/* Steps of slacks and multipliers that belong to the Newton step; the longest part of it, at most 1, that leaves
 * `rest` of each. */
CLONES static double slack_steps(tr_work *w, int corrector, double rest)
{
    const tr_problem *q = w->q;
    const int rows = (q->stages + 1) * q->rows;
    double fastest = 1.0 - rest; /* fall relative to the value */
    for (tr_side *z = w->side; z < w->side + 2; z++) {
        double *restrict ds = z->ds, *restrict dl = z->dl;
        const double *restrict inverse = z->inverse, *restrict l = z->l;
        for (int i = 0; i < rows; i++) {
            ds[i] = z->there[i] * (z->sign * w->dV[i] + z->residual[i]);
            dl[i] = -l[i] * (ds[i] * inverse[i] + 1.0);
        }
        for (int i = 0; corrector && i < rows; i++) dl[i] += z->there[i] * z->target[i] * inverse[i];
        for (int i = 0; i < rows; i++) {
            const double of_s = -ds[i] * inverse[i];
            fastest = of_s > fastest ? of_s : fastest;
            if (-dl[i] > fastest * l[i] && l[i] > 0.0) fastest = -dl[i] / l[i];
        }
    }
    return (1.0 - rest) / fastest;
}

/* Mehrotra's target: the cube of what the predictor leaves, less the product of its steps. */
CLONES static void centre(tr_work *w, double step, double mean, double count)
{
    const tr_problem *q = w->q;
    const int rows = (q->stages + 1) * q->rows;
    double after = 0.0;
    for (tr_side *z = w->side; z < w->side + 2; z++)
        for (int i = 0; i < rows; i++) after += (z->s[i] + step * z->ds[i]) * (z->l[i] + step * z->dl[i]);
    const double ratio = after / count / mean, target = ratio * ratio * ratio * mean;
    for (tr_side *z = w->side; z < w->side + 2; z++)
        for (int i = 0; i < rows; i++) z->target[i] = z->there[i] * (target - z->ds[i] * z->dl[i]);
}

/* The iterate that `judge` has just seen, as the result. */
static void keep(const tr_work *w, const tr_state *now, tr_result *r)
{
    const tr_problem *q = w->q;
    const size_t stages = (size_t)q->stages, rows = (stages + 1) * (size_t)q->rows;
    memcpy(r->movement, w->u, stages * sizeof(double));
    memcpy(r->size, w->e, stages * sizeof(double));
    memcpy(r->gradient, w->offset, stages * sizeof(double));
    memcpy(r->lower, w->side[0].l, rows * sizeof(double));
    memcpy(r->upper, w->side[1].l, rows * sizeof(double));
    for (int i = 0; i < q->nodes; i++) r->start[i] = w->theta[i];
    r->objective = now->objective;
    r->gap = now->complementarity + now->stationarity;
    r->residual = now->residual;
}

/* Solve; the answer is judged by the caller.
 *
 * Near the answer rounding wins over progress at last: the best iterate is returned, as TR_ACCURACY where it is not
 * quite what was asked for. Far from it the last iterate is, whose multipliers tell of infeasibility.
 */
int tr_solve(const tr_problem *q, const tr_options *options, double *workspace, tr_result *r)
{
    r->iterations = 0;
    if (!tr_workspace(q)) return TR_TOO_LARGE;
    tr_work work, *w = &work;
    memset(w, 0, sizeof work);
    lay_out(w, q, workspace, 0);
    const double count = start(w);
    double best = INFINITY;
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
        if (factor(w, 1) && factor(w, 0)) return near ? TR_ACCURACY : TR_BREAKDOWN;
        if (q->repeated) close_course(w);
        newton(w);
        if (count > 0.0) {
            centre(w, slack_steps(w, 0, 0.0), now.complementarity / count, count);
            aim(w, 1);
            newton(w);
        }
        /* Closer to the limits as they matter less: the last iterations then gain more than two digits each. Not with
         * sizes, whose two rows share a multiplier: how, only a centred iterate tells. */
        const double left = NEARNESS * now.complementarity / fmax(now.objective, 1.0);
        const double step = slack_steps(w, count > 0.0, q->nodes ? FARTHEST : fmin(FARTHEST, fmax(left, NEAREST)));
        if (!(step > SHORTEST)) return near ? TR_ACCURACY : TR_STALLED;
        advance(w, step);
    }
}

/* The problem without rows and nodes: one Newton step from rest, and as many more as refine it.
 *
 * The gains stay in the workspace: with `factored` they are those of the last call, of a problem that differs in
 * nothing but `reference` and `rule_offset`. TR_BREAKDOWN leaves none.
 */
int tr_linear(const tr_problem *q, double tolerance, int factored, double *workspace, tr_result *r)
{
    r->iterations = 0;
    if (!tr_workspace(q) || q->rows || q->nodes) return TR_TOO_LARGE;
    tr_work work, *w = &work;
    memset(w, 0, sizeof work);
    lay_out(w, q, workspace, factored);
    if (!factored && factor(w, 0)) return TR_BREAKDOWN;
    start(w);
    for (double best = INFINITY;;) {
        newton(w);
        advance(w, 1.0);
        r->iterations++;
        const tr_state now = judge(w);
        const int better = now.stationarity < best;
        if (better) best = now.stationarity, keep(w, &now, r);
        if (best <= tolerance * fmax(now.objective, 1.0)) return TR_SOLVED;
        if (!better || r->iterations > REFINEMENTS) return best < INFINITY ? TR_ACCURACY : TR_BREAKDOWN;
    }
}
