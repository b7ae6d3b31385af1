/* Runs the compiled stages of a device on arrays of their exact sizes, for sanitizers and valgrind: the outputs in modal
 * coordinates, and the cost of the time after the window, against those of the states as they are. Devices are random
 * oscillators in a chain; some are refused, as one with a number that is not finite always is.
 *
 * Prints the number of cases; exit code 1 where a number differs.
 */
#include <stdio.h>
#include <stdlib.h>

#include "../transopt/solvers/native/device.c"

enum { STEPS = 40 };

static double drawn(void) { return (double)rand() / RAND_MAX - 0.5; }

static double *doubles(int count)
{
    double *found = malloc((size_t)(count ? count : 1) * sizeof(double));
    if (!found) exit(2);
    for (int i = 0; i < count; i++) found[i] = drawn();
    return found;
}

/* One step of x (n) by A (n, n) and a movement of the command, the last state. */
static void step(int n, const double *A, double movement, double *x)
{
    double next[MOST];
    for (int i = 0; i < n; i++) {
        next[i] = A[i * n + n - 1] * movement;
        for (int j = 0; j < n; j++) next[i] += A[i * n + j] * x[j];
    }
    memcpy(x, next, (size_t)n * sizeof(double));
}

static int agrees(const tr_device *d, const tr_stages *found, const double *asked, double unit)
{
    double A[MOST * MOST], C[MOST * MOST], x[MOST] = {0}, z[MOST] = {0}, cost = found->rest, direct = 0.0;
    const int n = scaled(d, A, C);
    for (int k = 0; k < STEPS; k++) {
        const double movement = drawn();
        step(n, A, movement, x), step(n, found->A, movement, z);
        for (int t = 0; t < d->terms; t++) {
            double own = 0.0, other = 0.0;
            for (int i = 0; i < n; i++) own += found->C[t * n + i] * z[i], other += C[t * n + i] * x[i];
            other *= d->input_scale / unit;
            if (!(fabs(own - other) <= 1e-6 * (1.0 + fabs(other)))) return 0;
        }
    }
    for (int i = 0; i < n - 1; i++) {
        double left = -found->end_target[i];
        for (int j = 0; j < n; j++) left += found->end_gain[i * n + j] * z[j];
        cost += left * left / (d->by * d->by);
    }
    x[n - 1] = 0.0;
    for (int k = 0; k < d->after; k++, step(n, A, 0.0, x))
        for (int t = 0; t < d->terms; t++) {
            double made = -asked[t * d->stride + k] / d->input_scale;
            for (int i = 0; i < n; i++) made += C[t * n + i] * x[i];
            direct += pow(d->root[t] * d->input_scale / unit * made, 2.0);
        }
    return fabs(cost - direct) <= 1e-6 * (1.0 + direct);
}

int main(void)
{
    int cases = 0;
    for (int plant = 2; plant <= 34; plant += 2)
        for (int terms = 1; terms <= 3; terms++)
            for (int after = 0; after < 60; after += 23) {
                const int held = plant + 2;
                double *flow = doubles(held * held), *output = doubles(plant + 1), *filter = doubles(terms * TR_FILTER);
                double *root = doubles(terms), *asked = doubles(terms * (after + 2));
                for (int i = 0; i < plant; i++) {
                    for (int j = 0; j < held; j++) flow[i * held + j] *= j < i - i % 2 || j >= plant ? 0.1 : 0.0;
                    flow[i * held + i] = -0.05 - 0.01 * i;
                    flow[i * held + (i ^ 1)] = (i % 2 ? -1.0 : 1.0) * (0.1 + 0.05 * i);
                }
                for (int j = 0; j < 2 * held; j++) flow[plant * held + j] = 0.0;
                flow[plant * held + plant] = -0.7, flow[plant * held + plant + 1] = 0.7;
                for (int t = 0; t < terms; t++) {
                    root[t] = t == 1 ? 0.0 : fabs(root[t]);
                    filter[t * TR_FILTER] = t % 2, filter[t * TR_FILTER + 1] = -1.2, filter[t * TR_FILTER + 2] = 0.5;
                }
                const tr_device device = {plant, terms, 30, after, after + 2, flow, output, filter, root, 1.5, 2.0};
                const int n = states_of(&device);
                double *space = doubles((int)tr_device_workspace(&device));
                tr_stages found = {doubles(n * n), doubles(terms * n), doubles((n - 1) * n), doubles(n - 1), 0.0};
                const double condition = tr_device_stages(&device, asked, 0.8, space, &found);
                if (n > MOST ? condition < INFINITY : condition < 1e4 && !agrees(&device, &found, asked, 0.8)) return 1;
                cases += condition < 1e4;
                flow[1] = NAN;
                if (tr_device_stages(&device, asked, 0.8, space, &found) < INFINITY) return 1;
                free(flow), free(output), free(filter), free(root), free(asked), free(space);
                free(found.A), free(found.C), free(found.end_gain), free(found.end_target);
            }
    printf("%d\n", cases);
    return cases < 20;
}
