/* Runs the compiled stages of a device on arrays of their exact sizes, for sanitizers and valgrind: the factors of the
 * cost after the window against its sum, instant by instant. Devices are random modes; some are refused, as one with a
 * number that is not finite always is.
 *
 * Prints the number of cases; exit code 1 where a number differs.
 */
#include <stdio.h>
#include <stdlib.h>

#include "../transopt/solvers/native/device.c"

static double drawn(void) { return (double)rand() / RAND_MAX - 0.5; }

static double *doubles(int count)
{
    double *found = malloc((size_t)(count ? count : 1) * sizeof(double));
    if (!found) exit(2);
    for (int i = 0; i < count; i++) found[i] = drawn();
    return found;
}

static int agrees(const tr_device *d, const tr_stages *found, const double *asked, double unit)
{
    double z[MOST] = {0}, next[MOST], cost = found->rest, direct = 0.0;
    const int n = states_of(d);
    for (int i = 0; i < n - 1; i++) z[i] = drawn();
    for (int i = 0; i < n - 1; i++) {
        double left = -found->end_target[i];
        for (int j = 0; j < n; j++) left += found->end_gain[i * n + j] * z[j];
        cost += left * left / (d->by * d->by);
    }
    for (int k = 0; k < d->after; k++) {
        for (int t = 0; t < d->terms; t++) {
            double made = -asked[t * d->stride + k] / unit;
            for (int i = 0; i < n; i++) made += found->C[t * n + i] * z[i];
            direct += pow(d->root[t] * made, 2.0);
        }
        for (int i = 0; i < n; i++) {
            next[i] = 0.0;
            for (int j = 0; j < n; j++) next[i] += found->A[i * n + j] * z[j];
        }
        memcpy(z, next, (size_t)n * sizeof(double));
    }
    return fabs(cost - direct) <= 1e-9 * (1.0 + direct);
}

int main(void)
{
    int cases = 0;
    for (int plant = 2; plant <= 34; plant += 2)
        for (int terms = 1; terms <= 3; terms++)
            for (int after = 0; after < 60; after += 23) {
                const int acting = plant + 1;
                double *values = doubles(2 * acting), *vectors = doubles(2 * acting * acting);
                double *output = doubles(acting), *filter = doubles(terms * TR_FILTER);
                double *root = doubles(terms), *asked = doubles(terms * (after + 2));
                for (int j = 0; j < acting; j++) {
                    /* Some pairs are two real modes; the last mode is the current's. */
                    const int pair = j < plant && plant % 3, twin = pair && j % 2;
                    values[2 * j] = -0.05 - 0.01 * (pair ? j / 2 : j);
                    values[2 * j + 1] = pair ? (twin ? -1.0 : 1.0) * (0.1 + 0.05 * (j / 2)) : 0.0;
                    for (int i = 0; i < acting; i++) {
                        double *part = vectors + 2 * (i * acting + j);
                        part[0] = twin ? part[-2] : 0.1 * part[0] + (i == j);
                        part[1] = twin ? -part[-1] : pair ? part[1] : 0.0;
                        if (i == plant) part[0] = j == plant, part[1] = 0.0;
                    }
                }
                for (int t = 0; t < terms; t++) {
                    root[t] = t == 1 ? 0.0 : fabs(root[t]);
                    filter[t * TR_FILTER] = t % 2, filter[t * TR_FILTER + 1] = -1.2, filter[t * TR_FILTER + 2] = 0.5;
                }
                const tr_device device = {plant,  terms,  after, after + 2, values, vectors,
                                          output, filter, root,  0.7,       2.0};
                const int n = states_of(&device);
                double *space = doubles((int)tr_device_workspace(&device));
                tr_stages found = {doubles(n * n), doubles(terms * n), doubles((n - 1) * n), doubles(n - 1), 0.0};
                const double condition = tr_device_stages(&device, asked, 0.8, space, &found);
                const int usable = condition < 1e4;
                if (n > MOST ? condition < INFINITY : usable && !agrees(&device, &found, asked, 0.8)) return 1;
                cases += usable;
                for (int i = 0; i < 2; i++) {
                    double *spoilt = i ? vectors : values, kept = *spoilt;
                    *spoilt = NAN;
                    if (tr_device_stages(&device, asked, 0.8, space, &found) < INFINITY) return 1;
                    *spoilt = kept;
                }
                free(values), free(vectors), free(output), free(filter), free(root), free(asked), free(space);
                free(found.A), free(found.C), free(found.end_gain), free(found.end_target);
            }
    printf("%d\n", cases);
    return cases < 20;
}
