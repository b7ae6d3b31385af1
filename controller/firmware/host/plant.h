/* A true device in a user's hand, linear: the simulator's exact flow (controller/sim/simulator.py), step by step from a
 * file of matrices and of the hand's trajectory, which controller/sim/plant_file.py writes. */
#ifndef PLANT_H
#define PLANT_H

#include <stdbool.h>
#include <stdint.h>

#include "td_interface.h"

#define PLANT_MOST_STATES 16
#define PLANT_INPUTS 5
#define PLANT_MOST_SEGMENTS 2
#define PLANT_MOST_DELAY 16 /* servo periods */

typedef struct {
    /* As the file has it. */
    uint32_t masses, segments, steps, ticks, flows;
    uint32_t behind[PLANT_MOST_SEGMENTS];   /* servo periods by which a segment's command is older than the newest */
    double step_s[PLANT_MOST_SEGMENTS];
    double start[PLANT_MOST_STATES + PLANT_INPUTS], start_intention_m;
    double command_limit_A, crossover_A;    /* range (0: none) and dead band of the amplifier */
    bool ideal;                             /* no amplifier: the current is the command */
    double count_m, acceleration_limit_m_s2, acceleration_keep, acceleration_fresh_m_s2, acceleration_noise_m_s2;
    double grip_hysteresis, grip_noise_N, current_noise_A;
    const double *maps;                     /* (flows, segments, states, states + inputs) */
    const double *intention_m;              /* (ticks, segments * steps) at the ends of the steps */
    const double *grip_N;                   /* (ticks,) */
    const double *flow;                     /* (ticks,) which of the flows */
    double *memory;
    /* As it moves. */
    double x[PLANT_MOST_STATES + PLANT_INPUTS], before_m;
    double commands_A[PLANT_MOST_DELAY];    /* the newest first */
    double wander_m_s2, felt_N;
    uint64_t random[2];
    uint32_t at; /* tick within the trajectory, which begins anew after its end */
} plant;

/* NULL, or one line that says what is wrong with the file. `seed`: of the sensors' noise. */
const char *plant_load(plant *of, const char *path, uint64_t seed);
void plant_free(plant *of);

/* What the sensors say now; `tick` is the device's. */
void plant_read(plant *of, uint64_t tick, td_readings *readings);

/* One servo period with this command, issued now and held. */
void plant_advance(plant *of, double command_A);

#endif
