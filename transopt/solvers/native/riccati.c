/* Entry points of the interior-point method: checks of the arguments, and the choice of the kernel. */
#include <math.h>
#include <string.h>

#include "riccati.h"

static const double LOOK_S = 0.01; /* processor time between two checks for signals; each may wait for the interpreter's lock */

enum {
    MARGIN = 24,       /* stages beyond the last at which a limit is left, up to which limits are stated */
    LEAST_STAGES = 64, /* of a problem whose search may be shorter */
    GROWTH = 3,        /* of a search whose answer leaves limits */
    MOST_POOLED = 128, /* problems whose longer searches are shared; a multiple of the lanes */
    ENDED = -1         /* in place of the stages of a problem's next search */
};

static const double LENGTH = 3.0 / 16.0; /* of the first search, relative to all stages; longer ones are multiples of it */
static const double TIGHTER = 0.01; /* tolerance of a short search: two digits cost a thirtieth of its iterations */

static tr_watch released(const tr_host *host)
{
    tr_watch watch = {host, host ? host->release() : NULL, clock()};
    return watch;
}

static void acquired(const tr_watch *watch)
{
    if (watch->host) watch->host->acquire(watch->thread);
}

int tr_interrupted(tr_watch *watch)
{
    if (!watch->host || (double)(clock() - watch->asked) < LOOK_S * CLOCKS_PER_SEC) return 0;
    watch->host->acquire(watch->thread);
    const int stop = watch->host->interrupted();
    watch->thread = watch->host->release();
    watch->asked = clock();
    return stop;
}

int tr_paired(const tr_problem *q)
{
    const int n = q->states, first = n - q->motors;
    for (int i = 0; i < n; i++)
        for (int j = 0; j < n; j++) {
            const double of = q->A[i * n + j];
            if (i >= first && of != (i == j ? 1.0 : 0.0)) return 0;
            if (j < first && j != i && j != (i ^ 1) && of != 0.0) return 0;
        }
    return 1;
}

/* Number of leading problems that can be solved side by side, at most `most`. Long problems would exceed the cache. */
static int alike(const tr_problem *q, int count, int most)
{
    int found = 1;
    if (q->nodes || q->states > MOST_STATES_BESIDE || q->stages > MOST_STAGES_BESIDE || !tr_paired(q)) return 1;
    while (found < count && found < most && tr_paired(q + found)) found++;
    return found;
}

/* The fastest kernel for the first of `count` problems, and the number of them that it takes. */
static const tr_kernel *kernel_for(const tr_problem *q, int count, int *taken)
{
#if defined(ONLY_WIDTH)
    const tr_kernel *one = &KERNEL(ONLY_WIDTH, 1);
    *taken = alike(q, count, ONLY_WIDTH);
    if (*taken > 1) return &KERNEL(ONLY_WIDTH, ONLY_WIDTH);
#else
    const int four = __builtin_cpu_supports("avx2"), left = q->states % 8;
    const int eight = four && __builtin_cpu_supports("avx512dq") && __builtin_cpu_supports("avx512vl");
    *taken = alike(q, count, eight ? 8 : four ? 4 : 2);
    if (*taken > 4) return &KERNEL(8, 8);
    if (*taken > 2) return &KERNEL(4, 4);
    if (*taken == 2 && !four) return &KERNEL(2, 2);
    /* Registers of eight states only where padding does not make rows longer than with registers of four. */
    const tr_kernel *one = eight && (left == 0 || left > 4) ? &KERNEL(8, 1) : four ? &KERNEL(4, 1) : &KERNEL(2, 1);
#endif
    *taken = 1;
    return one;
}

/* Version of the interface, incremented when arguments or results change; callers must check it. */
int tr_interface(void) { return 14; }

static int fits(const tr_problem *q)
{
    if (q->motors < 1 || q->motors > (q->nodes ? 1 : MOST_MOTORS) || q->states < q->motors) return 0;
    if (q->ends < 0 || q->ends > q->states || q->nodes < 0 || q->nodes > MOST_NODES) return 0;
    if (q->states + q->nodes > MOST_STATES || q->rows < (q->nodes > 0) || q->rows > MOST_ROWS) return 0;
    if (q->outputs < 1 || q->outputs > MOST_ROWS) return 0;
    return q->stages >= 1 && q->free_stages >= 0 && q->free_stages <= q->stages;
}

/* Whether all problems have the same sizes (the fields up to `repeated`), within this method's limits. */
static int have_one_size(int count, const tr_problem *q)
{
    for (int i = 1; i < count; i++)
        if (memcmp(q, q + i, offsetof(tr_problem, repeated) + sizeof q->repeated)) return 0;
    return count > 0 && fits(q);
}

/* Whether limits are stated at the first stages alone: not a temperature's, which is highest at the end. */
static int shortens(const tr_problem *q) { return q->rows && !q->nodes && q->stages >= LEAST_STAGES; }

/* Doubles of workspace for `count` problems of equal sizes; 0 if the sizes are not within this method's limits. */
size_t tr_workspace(int count, const tr_problem *q)
{
    size_t most = 0;
    if (!have_one_size(count, q)) return 0;
    for (int i = 0, taken; i < count; i += taken) {
        const tr_kernel *kernel = kernel_for(q + i, count - i, &taken);
        const size_t whole = kernel->sizes(q + i), shorter = shortens(q) ? kernel->shortened_sizes(q + i) : 0;
        const size_t needed = whole > shorter ? whole : shorter;
        if (needed > most) most = needed;
    }
    return most;
}

/* Repeat the last of `taken` pointers where a kernel takes more. */
#define FILL(some, taken) \
    for (int e = (taken); e < MOST_ENTRIES; e++) (some)[e] = (some)[(taken) - 1]

/* Pointers to `taken` array elements from `first` on. */
#define SIDE_BY_SIDE(of, first, taken, found) \
    for (int e = 0; e < (taken); e++) (found)[e] = (of) + (first) + e; \
    FILL(found, taken)

static int has_bounds(const tr_problem *q)
{
    for (size_t i = 0; i < ((size_t)q->stages + 1) * (size_t)q->rows; i++) {
        const double lower = q->lower[i], upper = q->upper[i];
        if (!(lower <= upper) || lower == INFINITY || upper == -INFINITY) return 0;
    }
    return 1;
}

/* Stages of a search for a problem whose limits bind up to the stage `last`: a little more, of few lengths, so that many
 * problems share a search; all of them where the others are few. */
static int cut_after(const tr_problem *q, int last)
{
    const int length = (int)(LENGTH * q->stages), cut = ((last + MARGIN) / length + 1) * length;
    return cut > 3 * q->free_stages / 4 ? q->stages : cut;
}

/* Stages of the next search after one of `cut` stages whose answer leaves limits up to the stage `last`: `GROWTH` times as
 * many suffice as a rule, since an answer that keeps more limits leaves fewer. */
static int next_cut(const tr_problem *q, int cut, int last)
{
    const int wanted = cut_after(q, last);
    return last < q->stages && wanted > GROWTH * cut ? cut_after(q, GROWTH * cut - MARGIN - 1) : wanted;
}

/* Stages of the first search for a problem whose limits bind up to the stage `last`, as far as the caller knows. */
static int first_cut(const tr_problem *q, int last)
{
    return shortens(q) ? cut_after(q, last > 0 ? last : -MARGIN) : q->stages;
}

/* Solve problems of equal sizes, at most `MOST_POOLED`. Returns TR_INTERRUPTED, or 0.
 *
 * Limits bind early as a rule: they are first stated at the first stages alone, then up to the last stage at which that
 * answer leaves them. What an answer keeps everywhere has bound nothing. Few problems need the longer searches; those
 * that need as many stages share one. A problem has the same kernel all along, so that its answer does not depend on the
 * problems beside it.
 */
static int search(const tr_problem *q, int count, const tr_options *options, double *space, tr_result *r, tr_watch *watch)
{
    const tr_kernel *kernels[MOST_POOLED];
    int cut[MOST_POOLED];
    tr_options tighter = *options;
    tighter.tolerance *= TIGHTER;
    for (int i = 0, taken; i < count; i += taken) {
        const tr_kernel *kernel = kernel_for(q + i, count - i, &taken);
        for (int e = i; e < i + taken; e++) kernels[e] = kernel, cut[e] = first_cut(q, r[e].first);
    }
    for (;;) {
        const tr_problem *some[MOST_ENTRIES];
        tr_result *theirs[MOST_ENTRIES];
        int last[MOST_ENTRIES], of[MOST_ENTRIES], found = 0, shortest = ENDED, failed;
        for (int i = 0; i < count; i++)
            if (cut[i] != ENDED && (shortest == ENDED || cut[i] < cut[shortest])) shortest = i;
        if (shortest == ENDED) return 0;
        const tr_kernel *kernel = kernels[shortest];
        const int stages = cut[shortest];
        for (int i = shortest; i < count && found < kernel->entries; i++)
            if (cut[i] == stages && kernels[i] == kernel) some[found] = q + i, theirs[found] = r + i, of[found++] = i;
        FILL(some, found);
        FILL(theirs, found);
        failed = stages < q->stages ? kernel->shortened(some, stages, &tighter, space, theirs, last, watch)
                                    : kernel->search(some, options, space, theirs, watch);
        if (failed) return failed;
        for (int e = 0; e < found; e++) {
            const int solved = theirs[e]->code == TR_SOLVED || theirs[e]->code == TR_ACCURACY;
            const int ended = stages == q->stages || (solved && last[e] < 0);
            cut[of[e]] = ended ? ENDED : solved ? next_cut(q, stages, last[e]) : q->stages;
        }
    }
}

/* Solve `count` problems of equal sizes; the caller certifies the answers. Each result has its code. Returns 0, or the
 * code of an error that affects all problems.
 *
 * Near the optimum rounding eventually prevents progress: the best iterate is then returned, as TR_ACCURACY if it is not
 * within the tolerance. Far from the optimum the last iterate is returned; its multipliers may prove infeasibility.
 */
int tr_solve(int count, const tr_problem *q, const tr_options *options, double *space, tr_result *r)
{
    int failed = 0;
    if (!have_one_size(count, q)) failed = TR_TOO_LARGE;
    for (int i = 0; i < count; i++) r[i].iterations = 0, r[i].code = failed;
    for (int i = 0; i < count && !failed; i++)
        if (!has_bounds(q + i)) r[i].code = failed = TR_NO_BOUNDS;
    if (failed) return failed;
    tr_watch watch = released(options->host);
    for (int i = 0; i < count && !failed; i += MOST_POOLED)
        failed = search(q + i, count - i < MOST_POOLED ? count - i : MOST_POOLED, options, space, r + i, &watch);
    acquired(&watch);
    return failed;
}

/* Doubles of workspace of `tr_shortened`; 0 if the sizes are not within this method's limits. */
size_t tr_shortened_workspace(const tr_problem *q)
{
    int taken;
    return fits(q) ? kernel_for(q, 1, &taken)->shortened_sizes(q) : 0;
}

/* `tr_solve` of one problem whose limits are stated at the stages before `cut` alone; the multipliers of the others are
 * not written. Nodes and their limit may be there, but no taps that repeat. */
int tr_shortened(const tr_problem *q, int cut, const tr_options *options, double *space, tr_result *r)
{
    int taken, last[MOST_ENTRIES];
    r->iterations = 0;
    if (!fits(q) || q->repeated || cut < 1 || cut > q->free_stages) return r->code = TR_TOO_LARGE;
    if (!has_bounds(q)) return r->code = TR_NO_BOUNDS;
    tr_watch watch = released(options->host);
    const int failed = kernel_for(q, 1, &taken)->shortened(&q, cut, options, space, &r, last, &watch);
    acquired(&watch);
    return failed;
}

/* Solve problems without rows and nodes: one Newton step from rest, and further ones as iterative refinement. */
int tr_linear(int count, const tr_problem *q, const tr_options *options, double *space, tr_result *r)
{
    const tr_problem *some[MOST_ENTRIES];
    tr_result *theirs[MOST_ENTRIES];
    int failed = 0;
    if (!have_one_size(count, q) || q->rows || q->nodes) failed = TR_TOO_LARGE;
    for (int i = 0; i < count; i++) r[i].iterations = 0, r[i].code = failed;
    if (failed) return failed;
    tr_watch watch = released(options->host);
    for (int i = 0, taken; i < count && !failed; i += taken) {
        const tr_kernel *kernel = kernel_for(q + i, count - i, &taken);
        SIDE_BY_SIDE(q, i, taken, some);
        SIDE_BY_SIDE(r, i, taken, theirs);
        failed = kernel->pass(some, options->tolerance, space, theirs, &watch);
    }
    acquired(&watch);
    return failed;
}

/* Fill in each `proof` for its problem without nodes, independently of the solver. */
int tr_prove(int count, const tr_problem *q, double *space, tr_proof *proof)
{
    const tr_problem *some[MOST_ENTRIES];
    tr_proof *theirs[MOST_ENTRIES];
    if (!have_one_size(count, q) || q->nodes) return TR_TOO_LARGE;
    for (int i = 0, taken; i < count; i += taken) {
        const tr_kernel *kernel = kernel_for(q + i, count - i, &taken);
        SIDE_BY_SIDE(q, i, taken, some);
        SIDE_BY_SIDE(proof, i, taken, theirs);
        kernel->certify(some, space, theirs);
    }
    return TR_SOLVED;
}

