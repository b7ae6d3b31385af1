/* Runs the compiled recursions on arrays of their exact sizes, against sums written out: for sanitizers and valgrind.
 * A strike without a force is a recursion too, and one with a force is run twice, alone and beside another; a spline
 * through a parabola is that parabola.
 *
 * Prints the number of cases; exit code 1 where a state differs.
 */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>

#include "../transopt/base/native/recursions.c"

static double drawn(void) { return (double)rand() / RAND_MAX - 0.5; }

static double *doubles(size_t count)
{
    double *found = malloc((count ? count : 1) * sizeof(double));
    if (!found) exit(2);
    for (size_t i = 0; i < count; i++) found[i] = drawn();
    return found;
}

/* The entries of rows (height, width) that are not zero, and the first of each row, in memory of their exact sizes. */
static struct sparse sparse_of(size_t height, size_t width, const double *rows)
{
    size_t count = 0;
    for (size_t i = 0; i < height * width; i++) count += i % width == 0 || rows[i] != 0;
    int *starts = malloc((height + 1) * sizeof *starts), *columns = malloc(count * sizeof *columns);
    double *values = doubles(count);
    if (!starts || !columns) exit(2);
    count = 0;
    for (size_t i = 0; i < height * width; i++) {
        if (i % width == 0) starts[i / width] = (int)count;
        if (i % width == 0 || rows[i] != 0) columns[count] = (int)(i % width), values[count++] = rows[i];
    }
    starts[height] = (int)count;
    return (struct sparse){starts, columns, values};
}

static void freed(struct sparse rows)
{
    free((void *)rows.starts), free((void *)rows.columns), free((void *)rows.values);
}

/* x_k = P_(k-1) x_(k-1) + f_k, or against time with the transposes; `step` doubles from one matrix to the next. */
static void expected(size_t count, size_t m, const double *P, size_t step, int back, double *x)
{
    for (size_t s = 1; s < count; s++) {
        const size_t to = back ? count - 1 - s : s, from = back ? to + 1 : s - 1, at = back ? to : from;
        for (size_t i = 0; i < m; i++)
            for (size_t j = 0; j < m; j++)
                x[to * m + i] += P[at * step + (back ? j * m + i : i * m + j)] * x[from * m + j];
    }
}

int main(void)
{
    static const size_t counts[] = {0, 1, 2, 30};
    int cases = 0;
    for (int m = 1; m <= tr_most_states(); m = m < 13 ? m + 1 : m + 17)
        for (size_t c = 0; c < sizeof counts / sizeof *counts; c++)
            for (int way = 0; way < 3; way++) {
                const size_t n = (size_t)m, K = counts[c], step = way ? n * n : 0;
                double *P = doubles(way ? (K ? K - 1 : 0) * n * n : n * n), *x = doubles(K * n), *y = doubles(K * n);
                memcpy(y, x, K * n * sizeof(double));
                if (way == 0) tr_run(K, m, P, x);
                if (way == 1) tr_forwards(K, m, P, x);
                if (way == 2) tr_backwards(K, m, P, x);
                expected(K, n, P, step, way == 2, y);
                for (size_t i = 0; i < K * n; i++)
                    if (!(fabs(x[i] - y[i]) <= 1e-9 * (1.0 + fabs(y[i])))) return 1;
                free(P), free(x), free(y);
                cases++;
            }
    for (int m = 1; m <= 15; m += 7)
        for (size_t steps = 0; steps < 40; steps += 13)
            for (size_t columns = 1; columns < 40; columns += 11) {
                /* The only output is the first state. */
                const size_t n = (size_t)m, width = n + 4, height = 9 + n;
                double *rows = doubles(height * width), *state = doubles(n * columns), *alone = doubles(n);
                double *found = doubles((steps + 1) * columns), *course = doubles(steps + 1);
                double *A = doubles(n * n), *sums = doubles((steps + 1) * n);
                const double contact[3] = {0.3, 1.5, 0.1}, none[3] = {0.0, 1.5, 0.1};
                for (size_t j = 0; j < width; j++) rows[8 * width + j] = j == 0;
                for (size_t i = 0; i < n; i++) alone[i] = sums[i] = state[i * columns + columns - 1];
                memset(sums + n, 0, steps * n * sizeof(double));
                for (size_t i = 0; i < n * n; i++) A[i] = rows[(9 + i / n) * width + i % n];
                const struct sparse given = sparse_of(height, width, rows);
                tr_struck(steps, m, 1, columns, given.starts, given.columns, given.values, contact, state, found);
                tr_struck(steps, m, 1, 1, given.starts, given.columns, given.values, contact, alone, course);
                for (size_t k = 0; k <= steps; k++) {
                    const double other = found[k * columns + columns - 1];
                    if (course[k] != other && !(isnan(course[k]) && isnan(other))) return 1;
                }
                memcpy(alone, sums, n * sizeof(double));
                tr_struck(steps, m, 1, 1, given.starts, given.columns, given.values, none, alone, course);
                tr_run(steps + 1, m, A, sums);
                for (size_t k = 0; k <= steps; k++)
                    if (!(fabs(course[k] - sums[k * n]) <= 1e-9 * (1.0 + fabs(sums[k * n])))) return 1;
                free(rows), free(state), free(alone), free(found), free(course), free(A), free(sums);
                freed(given);
                cases++;
            }
    for (int m = 1; m <= 12; m += 3)
        for (int p = 1; p <= 3; p++)
            for (int q = 1; q <= 25; q += 8)
                for (size_t c = 0; c < sizeof counts / sizeof *counts; c++)
                    for (int back = 0; back < 2; back++) {
                        const size_t n = (size_t)m, K = counts[c], width = (size_t)(m + q + 3) / 4 * 4;
                        /* One course to more than stand side by side, of which the last is looked at. */
                        const size_t number = 1 + (size_t)(5 * m + 2 * p + q) % 37, last = number - 1;
                        double *S = doubles((n + (size_t)p) * width), *all = doubles(number * (size_t)p * K);
                        double *found = doubles(number * (size_t)q * K), *x = doubles(n), *next = doubles(n);
                        const double *u = all + last * (size_t)p * K, *y = found + last * (size_t)q * K;
                        const size_t wide = (size_t)p + n;
                        double *rows = doubles(((size_t)q + n) * wide), *state = doubles(number * n);
                        double *largest = doubles(number), sums = 0, most = 0;
                        for (size_t i = 0; i < (size_t)q + n; i++)
                            for (size_t j = 0; j < wide; j++) {
                                const size_t row = i < (size_t)q ? n + i : i - (size_t)q;
                                rows[i * wide + j] = S[(j < (size_t)p ? n + j : j - (size_t)p) * width + row];
                            }
                        const size_t lanes = ((size_t)q + n + 7) / 8 * 8;
                        double *by_columns = doubles(wide * lanes);
                        for (size_t i = 0; i < wide * lanes; i++)
                            by_columns[i] = i % lanes < (size_t)q + n ? rows[i % lanes * wide + i / lanes] : 0;
                        /* Without sparse rows courses are worked on one by one. */
                        const struct sparse rows_of = sparse_of((size_t)q + n, wide, rows), none = {NULL, NULL, NULL};
                        const struct sparse given = number % 3 ? rows_of : none;
                        tr_courses(number, K, m, p, q, (int)lanes, by_columns, given.starts, given.columns,
                                   given.values, all, found, back);
                        memset(state, 0, number * n * sizeof(double));
                        tr_largest(number, K, m, p, q, q, (int)lanes, by_columns, given.starts, given.columns,
                                   given.values, all, state, largest);
                        memset(x, 0, n * sizeof(double));
                        for (size_t s = 0; s < K; s++) {
                            const size_t k = back ? K - 1 - s : s;
                            for (size_t i = 0; i < n + (size_t)q; i++) {
                                double sum = 0;
                                for (size_t j = 0; j < n; j++) sum += S[j * width + i] * x[j];
                                for (size_t j = 0; j < (size_t)p; j++) sum += S[(n + j) * width + i] * u[j * K + k];
                                if (i < n) next[i] = sum;
                                else if (!(fabs(y[(i - n) * K + k] - sum) <= 1e-9 * (1.0 + fabs(sum)))) return 1;
                            }
                            memcpy(x, next, n * sizeof(double));
                            sums = 0;
                            for (size_t i = 0; i < (size_t)q; i++) sums += fabs(y[i * K + k]);
                            most = sums > most ? sums : most;
                        }
                        if (!back) {
                            if (!(fabs(largest[last] - most) <= 1e-9 * (1.0 + most))) return 1;
                            for (size_t i = 0; i < n; i++)
                                if (!(fabs(state[last * n + i] - x[i]) <= 1e-9 * (1.0 + fabs(x[i])))) return 1;
                        }
                        free(S), free(all), free(found), free(x), free(next);
                        free(rows), free(state), free(largest), free(by_columns), freed(rows_of);
                        cases++;
                    }
    for (int m = 1; m <= 2; m++)
        for (size_t c = 0; c < sizeof counts / sizeof *counts; c++) {
            const size_t n = (size_t)m, K = counts[c];
            double *M = doubles(n * n), *b = doubles(n), *gain = doubles(K), *h = doubles(K), *x = doubles((K + 1) * n);
            tr_bilinear(K, m, M, b, gain, 0.3, h, x);
            for (size_t k = 0; k < K; k++)
                for (size_t i = 0; i < n; i++) {
                    double sum = b[i] * (gain[k] + 0.3 * x[k * n]) * h[k];
                    for (size_t j = 0; j < n; j++) sum += M[i * n + j] * x[k * n + j];
                    if (!(fabs(x[(k + 1) * n + i] - sum) <= 1e-9 * (1.0 + fabs(sum)))) return 1;
                }
            free(M), free(b), free(gain), free(h), free(x);
            cases++;
        }
    for (size_t c = 0; c < sizeof counts / sizeof *counts; c++) {
        /* The current is steady over long steps, or turns at once; over short ones it stays what it was. */
        const size_t K = counts[c];
        double *factors = doubles(4 * K), *before = doubles(2 * K), *command = doubles(2 * K), *found = doubles(2 * K);
        for (size_t k = 0; k < K; k++) {
            const double x = k % 3 ? 1e-9 : 1e9;
            factors[k] = x, factors[K + k] = exp(-x);
            factors[2 * K + k] = -expm1(-x) / x, factors[3 * K + k] = -expm1(-2 * x) / (2 * x);
        }
        tr_square_means(2, K, factors, 0.02, before, command, found);
        for (size_t k = 0; k < 2 * K; k++) {
            const double i = fabs(k % K % 3 ? before[k] : command[k]) + 0.02;
            if (!(fabs(found[k] - i * i) <= 1e-7)) return 1;
        }
        free(factors), free(before), free(command), free(found);
        cases++;
    }
    for (size_t c = 0; c < sizeof counts / sizeof *counts; c++) {
        /* Steady heat over many steps warms as over one step of their length, from any temperature; beside no number. */
        static const double heat[] = {0.03, 2.0, 0.4, -0.7, 6.0, 9.0};
        enum { COILS = BESIDE + 1 };
        const size_t K = counts[c];
        double *steps = doubles(K), *q = doubles(COILS * K), whole = 0.0;
        double *winding = doubles(COILS * (K + 1)), *housing = doubles(COILS * (K + 1));
        double first[COILS][2], second[COILS][2];
        for (size_t k = 0; k < K; k++) whole += steps[k] = fabs(steps[k]);
        for (size_t k = 0; k < COILS * K; k++) q[k] = k < K ? NAN : 3.0;
        for (size_t i = 0; i < COILS; i++) first[i][0] = winding[i * (K + 1)], second[i][0] = housing[i * (K + 1)];
        const double steady[COILS] = {NAN, 3.0, 3.0, 3.0, 3.0};
        tr_heated(COILS, K, heat, q, steps, winding, housing);
        tr_heated(COILS, 1, heat, steady, &whole, first[0], second[0]);
        if (K > 1 && isfinite(winding[K])) return 1;
        for (size_t i = 1; i < COILS && K; i++) {
            const size_t last = i * (K + 1) + K;
            if (!(fabs(winding[last] - first[i][1]) <= 1e-12 * fabs(first[i][1]))) return 1;
            if (!(fabs(housing[last] - second[i][1]) <= 1e-12 * fabs(second[i][1]))) return 1;
        }
        free(steps), free(q), free(winding), free(housing);
        cases++;
    }
    for (size_t knots = 4; knots < 8; knots++) {
        /* A parabola is its own spline; the last place is no number. */
        double places[] = {-0.5, 0.0, 0.25, 1.0, (double)knots - 1.0, (double)knots + 3.0, NAN};
        const size_t count = sizeof places / sizeof *places;
        for (size_t courses = 1; courses < 6; courses++) {
            double *y = doubles(courses * knots), *work = doubles((courses + 1) * knots);
            double *found = doubles(courses * count);
            for (size_t i = 0; i < courses * knots; i++) y[i] = (double)((i / courses) * (i / courses));
            tr_spline(knots, courses, y, count, places, work, found);
            for (size_t i = 0; i < courses * (count - 1); i++)
                if (!(fabs(found[i] - places[i / courses] * places[i / courses]) <= 1e-9)) return 1;
            if (courses == 1) {
                tr_spline_even(knots, y, count, -0.5, 0.7, work, found);
                for (size_t i = 0; i < count; i++)
                    if (!(fabs(found[i] - pow(0.7 * (double)i - 0.5, 2)) <= 1e-9)) return 1;
            }
            free(y), free(work), free(found);
            cases++;
        }
    }
    printf("%d\n", cases);
    return 0;
}
