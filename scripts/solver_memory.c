/* Runs the interior point on problems from a file, every array in memory of its exact size: for sanitizers and valgrind.
 *
 * Written by solver_memory.py: count, then per problem the integers and numbers of tr_problem in its order, the lengths
 * of its arrays, the arrays. Every problem is solved BESIDE times side by side with itself: as often as fills a register
 * of ONLY_WIDTH numbers, and once alone. Prints per answer: code, iterations, objective, sum of the commands; of a proof, without and with multipliers, the sum of what it bounds in
 * place of the commands.
 */
#include <stdio.h>
#include <stdlib.h>

#include "../transopt/solvers/native/riccati.h"

enum { INTEGERS = 10, ARRAYS = 20, NUMBERS = 6, BESIDE = ONLY_WIDTH + 1 };

static void read_or_stop(void *into, size_t size, size_t count, FILE *file)
{
    if (fread(into, size, count, file) != count) {
        fputs("the file of problems is cut\n", stderr);
        exit(2);
    }
}

static double *doubles(size_t count)
{
    double *found = malloc((count ? count : 1) * sizeof(double));
    if (!found) exit(2);
    return found;
}

/* Without limits rounding alone says how many steps refine the answer: they are not told. */
static void tell(const char *what, const tr_problem *q, const tr_result *r)
{
    const int moves = q->stages * q->motors;
    const int code = r->code;
    double sum = 0.0;
    for (int k = 0; k < moves; k++) sum += r->command[k];
    printf("%s %d %d %.17g %.17g\n", what, code, q->rows ? r->iterations : 0, code < TR_ITERATION_LIMIT ? r->objective : 0.0, sum);
}

/* What the answer and its multipliers prove: of each kind of number the first. */
static void tell_proof(const tr_problem *q, const tr_result *r)
{
    const size_t N = (size_t)q->stages, rows = N * (size_t)q->rows, motors = (size_t)q->motors;
    const size_t free_moves = (size_t)q->free_stages * motors;
    double *workspace = doubles(tr_workspace(1, q)), *excess = doubles((size_t)q->rows), most = 0.0;
    double *by_lower = doubles(rows), *by_upper = doubles(rows), *by_rule = doubles(N * motors - free_moves);
    double *lower = doubles(rows), *upper = doubles(rows);
    for (size_t i = 0; i < rows; i++) {
        by_lower[i] = r->lower[i], by_upper[i] = r->upper[i];
        lower[i] = q->lower[i], upper[i] = q->upper[i];
    }
    for (size_t k = free_moves; k < N * motors; k++) by_rule[k - free_moves] = -r->gradient[k];
    for (int with = 0; with < 2; with++) {
        tr_proof proof = {r->command, with ? by_lower : NULL, with ? by_upper : NULL, by_rule, lower, upper, excess,
                          0.0, 0.0, 0.0, 0.0, 0.0, 0.0};
        const int code = tr_prove(1, q, workspace, &proof);
        for (int i = 0; i < q->rows; i++) most = excess[i] > most ? excess[i] : most;
        printf("%s %d 0 %.17g %.17g\n", with ? "proof" : "bare", code, code ? 0.0 : proof.objective,
               code ? 0.0 : proof.slack + proof.residual + proof.by_command + proof.by_movement + most);
    }
    free(workspace), free(excess), free(by_lower), free(by_upper), free(by_rule), free(lower), free(upper);
}

static void run(FILE *file)
{
    int of[INTEGERS];
    long long lengths[ARRAYS];
    double numbers[NUMBERS], *arrays[ARRAYS];
    read_or_stop(of, sizeof(int), INTEGERS, file);
    read_or_stop(numbers, sizeof(double), NUMBERS, file);
    read_or_stop(lengths, sizeof(long long), ARRAYS, file);
    for (int i = 0; i < ARRAYS; i++) {
        arrays[i] = doubles((size_t)lengths[i]);
        read_or_stop(arrays[i], sizeof(double), (size_t)lengths[i], file);
    }
    tr_problem q = {of[0], of[1], of[2], of[3], of[4], of[5], of[6], of[7], of[8], of[9],
                    arrays[0], arrays[1], arrays[2], arrays[3], arrays[4], arrays[5], arrays[6], arrays[7], arrays[8],
                    arrays[9], arrays[10], arrays[11], arrays[12], arrays[13], arrays[14], arrays[15], arrays[16],
                    arrays[17], arrays[18], arrays[19],
                    numbers[0], numbers[1], numbers[2], numbers[3], numbers[4], numbers[5]};
    const size_t N = (size_t)q.stages, rows = (N + 1) * (size_t)q.rows, moves = N * (size_t)q.motors;
    const tr_options options = {60, 1e-9, NULL};
    tr_problem beside[BESIDE];
    tr_result r[BESIDE];
    for (int i = 0; i < BESIDE; i++) {
        const tr_result empty = {doubles(moves), doubles(N), doubles(rows), doubles(rows), doubles(moves), doubles((size_t)q.nodes),
                                 0, 0, 0, 0.0, 0.0, 0.0};
        beside[i] = q;
        r[i] = empty;
        /* A result that is not written, as of a breakdown at once, is zero as from Python. */
        for (size_t k = 0; k < moves; k++) r[i].command[k] = 0.0;
    }
    double *workspace = doubles(tr_workspace(BESIDE, beside));
    tr_solve(BESIDE, beside, &options, workspace, r);
    /* Limits that are none are told once. */
    for (int i = 0; i < (r[0].code == TR_NO_BOUNDS ? 1 : BESIDE); i++) tell("solve", &q, r + i);
    free(workspace);
    if (!q.nodes && r->code <= TR_ACCURACY) tell_proof(&q, r);
    if (r->code != TR_NO_BOUNDS && !q.repeated && q.free_stages > 1) {
        workspace = doubles(tr_shortened_workspace(&q));
        tr_shortened(&q, (q.free_stages + 1) / 2, &options, workspace, r);
        tell("shortened", &q, r);
        free(workspace);
    }
    if (!q.rows && !q.nodes) {
        workspace = doubles(tr_workspace(1, &q));
        tr_linear(1, &q, &options, workspace, r);
        tell("linear", &q, r);
        free(workspace);
    }
    for (int i = 0; i < ARRAYS; i++) free(arrays[i]);
    for (int i = 0; i < BESIDE; i++) {
        free(r[i].command), free(r[i].size), free(r[i].gradient), free(r[i].start);
        free(r[i].lower), free(r[i].upper);
    }
}

int main(int argc, char **argv)
{
    int count = 0;
    FILE *file = argc == 2 ? fopen(argv[1], "rb") : NULL;
    if (!file) return 2;
    read_or_stop(&count, sizeof count, 1, file);
    for (int i = 0; i < count; i++) run(file);
    fclose(file);
    return 0;
}
