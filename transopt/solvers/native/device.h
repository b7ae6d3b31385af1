/* A device under one grip, and its stages in modal coordinates (device.c). */
#if !defined(DEVICE_H)
#define DEVICE_H
#include <stddef.h>

enum { TR_MOST_DEVICE = 32, TR_FILTER = 6 };

typedef struct {
    int plant, terms, stages; /* states of the plant, error terms, stages of the window */
    int after, stride;        /* instants after the window, and from one term's target there to the next one's */
    const double *flow;       /* (plant + 2, plant + 2) generator of plant, current and command, times the period */
    const double *output;     /* (plant + 1) acceleration by plant and current */
    const double *filter;     /* (terms, TR_FILTER) whether there is one, a1, a2, and its outputs by input and states */
    const double *root;       /* (terms) roots of the weights after the window */
    double input_scale, by;   /* unit of the command, root of the factor on the costs */
} tr_device;

typedef struct {
    double *A, *C, *end_gain, *end_target; /* (n, n), (terms, n), (n - 1, n), (n - 1) of `tr_problem` */
    double rest;                           /* of the cost after the window, for no state */
} tr_modes;

int tr_device_states(const tr_device *device);
/* Returns n, the number of states; 0 where there are too many, or a number is not finite. */
int tr_scaled(const tr_device *device, double *A, double *C);
size_t tr_modal_workspace(const tr_device *device);
/* `values` (n - 1) and `vectors` (n - 1, n - 1), complex: of A without its last row and column. `asked`: the targets after
 * the window, `unit` that of the outputs. Returns a bound of the condition of the modes, infinite where there are none. */
double tr_modal(const tr_device *device, const double *A, const double *C, const double *values, const double *vectors,
                const double *asked, double unit, double *space, tr_modes *found);
#endif
