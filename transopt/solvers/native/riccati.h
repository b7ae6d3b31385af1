/* Types shared by the C sources of the method: problem, options, results, and the kernels that solve a problem. */
#if !defined(RICCATI_H)
#define RICCATI_H
#include <stddef.h>
#include <time.h>

enum { MOST_STATES = 96, MOST_NODES = 2, MOST_MOTORS = 4, MOST_ROWS = 128, MOST_ENTRIES = 8 };
enum { MOST_STATES_BESIDE = 32, MOST_STAGES_BESIDE = 4096 };

typedef struct {
    int stages, free_stages, states, motors, outputs, ends, rows;
    int nodes;    /* of the temperature, which only a single motor has */
    int current;  /* index of the state that is the current; -1: the current is the command */
    int repeated; /* th_0 = F th_N + f */
    const double *A, *C, *E;                 /* (n, n), (outputs, n), (outputs, m) */
    const double *weight, *reference;        /* (N, outputs), both */
    const double *rule_gain, *rule_offset;   /* (N - free, m, n), (N - free, m) */
    const double *end_gain, *end_target;     /* Z (ends, n), z (ends): terms in the state at N, for the time after */
    const double *G, *d, *d_size;            /* (rows, n), (rows, m), (rows) */
    const double *lower, *upper;             /* (N + 1, rows), infinite where there is no limit */
    const double *M, *b, *gain, *square;     /* (nodes, nodes), (nodes), (N), (3): i_k^2, i_k i_(k+1), i_(k+1)^2 */
    const double *F, *f;                     /* (nodes, nodes), (nodes) */
    double movement_weight, decay, ripple, copper;
    double command_bound;                    /* on a command's size, used in the gap */
    double constant;                         /* constant term of the objective; tolerances are relative to the latter */
} tr_problem;

/* The interpreter, whose lock the caller holds. The method releases the lock while it works, and takes it now and then
 * to check for a signal. In CPython: PyEval_SaveThread, PyEval_RestoreThread, PyErr_CheckSignals.
 */
typedef struct {
    void *(*release)(void);
    void (*acquire)(void *thread);
    int (*interrupted)(void); /* not 0: stop */
} tr_host;

typedef struct {
    int max_iterations;
    double tolerance;     /* on the gap, relative to max(objective, 1), and on residuals */
    const tr_host *host;  /* NULL: no lock to release, no interruption */
} tr_options;

typedef struct {
    double *command, *size;    /* (N, m); (N), not written if there are no nodes */
    double *lower, *upper;     /* (N + 1, rows) multipliers */
    double *gradient;          /* (N, m) of the Lagrangian by u, with the hand-over's rule as feedback */
    double *start;             /* (nodes) th_0 */
    int code, iterations;
    int first; /* in `tr_solve`: stages up to which limits bind, as far as the caller knows; 0: not known */
    double objective, gap, residual;
} tr_result;

/* Certificate of a command with multipliers in a problem without nodes. The tangent of the Lagrangian gives two lower
 * bounds of the optimum: objective - slack - by_command, and objective - slack - by_movement. */
typedef struct {
    const double *command;             /* (N, m) */
    const double *by_lower, *by_upper; /* (N, rows) multipliers >= 0; NULL if all are zero */
    const double *by_rule;             /* (N - free, m) multipliers of the hand-over */
    const double *lower, *upper;       /* (N, rows) bounds of the rows, used in place of the problem's own */
    double *excess;                    /* (rows) largest violation of each row, negative inside */
    double objective, slack;           /* slack: sum of multipliers times absolute slacks, the hand-over's included */
    double residual;                   /* largest residual of the hand-over */
    double dual_residual;              /* largest absolute value of the Lagrangian's gradient by the commands */
    double by_command;                 /* sum of that gradient times the largest possible change of a command */
    double by_movement;                /* bound from that gradient and the curvature of the movement's weight */
} tr_proof;

enum {
    TR_SOLVED, TR_ACCURACY, TR_ITERATION_LIMIT, TR_STALLED, TR_BREAKDOWN,
    TR_TOO_LARGE,   /* sizes outside of what the method takes */
    TR_NO_BOUNDS,   /* invalid bounds: NaN, crossing, or infinite on the wrong side */
    TR_INTERRUPTED
};

/* State of the signal checks during one call. */
typedef struct {
    const tr_host *host;
    void *thread;
    clock_t asked;
} tr_watch;

/* Whether the host wants the work to stop. */
int tr_interrupted(tr_watch *watch);

/* Whether A couples only states 2 i and 2 i + 1, and the last m states, the held commands, to all others. */
int tr_paired(const tr_problem *q);

/* The method, compiled for one register width; it solves `entries` problems of equal sizes at once. Each result has its
 * code; a call returns nonzero only if it was interrupted. */
typedef struct {
    int entries;
    size_t (*sizes)(const tr_problem *q);
    int (*search)(const tr_problem *const *q, const tr_options *options, double *space, tr_result *const *r, tr_watch *watch);
    int (*pass)(const tr_problem *const *q, double tolerance, double *space, tr_result *const *r, tr_watch *watch);
    void (*certify)(const tr_problem *const *q, double *space, tr_proof *const *proof);
    size_t (*shortened_sizes)(const tr_problem *q);
    int (*shortened)(const tr_problem *const *q, int cut, const tr_options *options, double *space, tr_result *const *r,
                     int *last, tr_watch *watch);
} tr_kernel;

int tr_interface(void);
size_t tr_workspace(int count, const tr_problem *q);
int tr_solve(int count, const tr_problem *q, const tr_options *options, double *space, tr_result *r);
size_t tr_shortened_workspace(const tr_problem *q);
int tr_shortened(const tr_problem *q, int cut, const tr_options *options, double *space, tr_result *r);
int tr_linear(int count, const tr_problem *q, const tr_options *options, double *space, tr_result *r);
int tr_prove(int count, const tr_problem *q, double *space, tr_proof *proof);

/* Compiled register widths: all of them, chosen by processor at run time, or only one. */
#if !defined(ONLY_WIDTH) && !defined(__GNUC__)
#define ONLY_WIDTH 1
#elif !defined(ONLY_WIDTH) && (defined(__clang__) || !defined(__x86_64__))
#define ONLY_WIDTH 2
#endif
#if defined(ONLY_WIDTH)
#define HAS_WIDTH(width) ((width) == ONLY_WIDTH)
#else
#define HAS_WIDTH(width) ((width) > 1)
#endif
#define PASTED(width, entries) tr_kernel_##width##_##entries
#define KERNEL(width, entries) PASTED(width, entries)
extern const tr_kernel KERNEL(8, 8), KERNEL(8, 1), KERNEL(4, 4), KERNEL(4, 1), KERNEL(2, 2), KERNEL(2, 1), KERNEL(1, 1);
#endif
