/* What the parts of the method in C share: a problem, what is asked and told of it, and the kernels that solve it. */
#if !defined(RICCATI_H)
#define RICCATI_H
#include <stddef.h>
#include <time.h>

enum { MOST_STATES = 96, MOST_NODES = 2, MOST_ROWS = 128, MOST_ENTRIES = 8 };
enum { MOST_STATES_BESIDE = 32, MOST_STAGES_BESIDE = 4096 };

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
    int code, iterations;
    double objective, gap, residual;
} tr_result;

/* What a command and multipliers prove in a problem, its nodes aside: the Lagrangian's tangent bounds the optimum by
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

/* The host during one call. */
typedef struct {
    const tr_host *host;
    void *thread;
    clock_t asked;
} tr_watch;

/* Whether the host wants the work to stop. */
int tr_interrupted(tr_watch *watch);

/* Whether states 2 i and 2 i + 1 alone are coupled, and the held command, the last one, to all. */
int tr_paired(const tr_problem *q);

/* The method, compiled for one width: `entries` problems of equal sizes at once. Codes stand in the results; a call
 * that was interrupted is not 0. */
typedef struct {
    int entries;
    size_t (*sizes)(const tr_problem *q);
    int (*search)(const tr_problem *const *q, const tr_options *options, double *space, tr_result *const *r, tr_watch *watch);
    int (*pass)(const tr_problem *const *q, double tolerance, double *space, tr_result *const *r, tr_watch *watch);
    void (*certify)(const tr_problem *const *q, double *space, tr_proof *const *proof);
} tr_kernel;

int tr_interface(void);
size_t tr_workspace(int count, const tr_problem *q);
int tr_solve(int count, const tr_problem *q, const tr_options *options, double *space, tr_result *r);
int tr_linear(int count, const tr_problem *q, const tr_options *options, double *space, tr_result *r);
int tr_prove(int count, const tr_problem *q, double *space, tr_proof *proof);

/* Which widths are compiled: all, of which the processor has the last word, or only one. */
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
