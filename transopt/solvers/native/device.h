/* A device under one grip, and its stages in modal coordinates (device.c). */
#if !defined(DEVICE_H)
#define DEVICE_H
#include <stddef.h>

enum { TR_MOST_DEVICE = 32, TR_FILTER = 7 };

typedef struct {
    int plant, terms;              /* states of the plant, error terms */
    int after, stride;             /* instants after the window, and from one term's target there to the next one's */
    const double *values, *vectors; /* (plant + 1, 2), (plant + 1, plant + 1, 2) eigenvalues, real and imaginary part, of
                                      the generator of plant and current, times the period; its vectors in columns */
    const double *output;          /* (plant + 1) acceleration by plant and current */
    const double *filter;          /* (terms, TR_FILTER) whether there is one, a1, a2, its outputs by input and states,
                                      and the states by the input */
    const double *root;            /* (terms) roots of the weights after the window */
    double rate, by;               /* the amplifier's, times the period; root of the factor on the costs */
} tr_device;

typedef struct {
    double *A, *C, *end_gain, *end_target; /* (n, n), (terms, n), (n - 1, n), (n - 1) of `tr_problem` */
    double rest;                           /* of the cost after the window, for no state */
} tr_stages;

/* Doubles of workspace. */
size_t tr_device_workspace(const tr_device *device);

/* The stages of a device, in modal coordinates: modes in pairs, real ones, the current, the held command. Returns a bound
 * of the condition of the coordinates; infinite where the device has none, or is too large or not finite.
 *
 * `asked` are the terms' targets after the window, `stride` apart, and `unit` is that of the outputs. */
double tr_device_stages(const tr_device *device, const double *asked, double unit, double *space, tr_stages *found);
#endif
