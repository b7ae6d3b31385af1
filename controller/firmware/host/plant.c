#include "plant.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "td_bytes.h"

#define MAGIC 0x4c504e54u /* "TNPL" */
#define VERSION 2
#define HEAD_BYTES 40 /* magic, version, masses, segments, steps, ticks, flows, behind[2], ideal: u32 each */
#define HEAD_NUMBERS (PLANT_MOST_SEGMENTS + 11)
#define PI 3.141592653589793
enum { COMMAND, INTENTION, INTENTION_SPEED };

static uint32_t states(const plant *of)
{
    return 2 * of->masses + 4;
}

/* xorshift128+ (Vigna 2014), 53 bits. */
static double uniform(plant *of)
{
    uint64_t one = of->random[0];
    const uint64_t other = of->random[1];

    of->random[0] = other;
    one ^= one << 23;
    of->random[1] = one ^ other ^ (one >> 17) ^ (other >> 26);
    return (double)((of->random[1] + other) >> 11) * 0x1p-53;
}

static double normal(plant *of)
{
    const double size = sqrt(-2 * log(1 - uniform(of)));

    return size * cos(2 * PI * uniform(of));
}

static double *doubles(FILE *file, size_t count)
{
    double *numbers = malloc((count > 0 ? count : 1) * sizeof *numbers);
    uint8_t bytes[8];
    size_t j;

    for (j = 0; numbers != NULL && j < count; j++) {
        if (fread(bytes, 1, sizeof bytes, file) != sizeof bytes) {
            free(numbers);
            return NULL;
        }
        numbers[j] = td_get_f64(bytes);
    }
    return numbers;
}

static const char *read_head(plant *of, FILE *file)
{
    uint8_t head[HEAD_BYTES];
    double *numbers, *at;
    uint32_t j;

    if (fread(head, 1, sizeof head, file) != sizeof head || td_get_u32(head) != MAGIC ||
        td_get_u32(head + 4) != VERSION)
        return "is no plant file of this version";
    of->masses = td_get_u32(head + 8);
    of->segments = td_get_u32(head + 12);
    of->steps = td_get_u32(head + 16);
    of->ticks = td_get_u32(head + 20);
    of->flows = td_get_u32(head + 24);
    of->behind[0] = td_get_u32(head + 28);
    of->behind[1] = td_get_u32(head + 32);
    of->ideal = td_get_u32(head + 36) != 0;
    if (of->masses < 1 || states(of) > PLANT_MOST_STATES || of->segments < 1 || of->segments > PLANT_MOST_SEGMENTS ||
        of->steps < 1 || of->steps > 64 || of->ticks < 1 || of->ticks > 1u << 26 || of->flows < 1 ||
        of->flows > 1u << 16 || of->behind[0] >= PLANT_MOST_DELAY || of->behind[1] >= PLANT_MOST_DELAY)
        return "holds sizes that this program cannot take";
    at = numbers = doubles(file, HEAD_NUMBERS);
    if (numbers == NULL)
        return "ends too early";
    for (j = 0; j < PLANT_MOST_SEGMENTS; j++)
        of->step_s[j] = *at++;
    of->start_intention_m = *at++;
    of->command_limit_A = *at++;
    of->crossover_A = *at++;
    of->count_m = *at++;
    of->acceleration_limit_m_s2 = *at++;
    of->acceleration_keep = *at++;
    of->acceleration_fresh_m_s2 = *at++;
    of->acceleration_noise_m_s2 = *at++;
    of->grip_hysteresis = *at++;
    of->grip_noise_N = *at++;
    of->current_noise_A = *at;
    free(numbers);
    return NULL;
}

static const char *read_body(plant *of, FILE *file)
{
    const size_t width = states(of) + PLANT_INPUTS, maps = (size_t)of->flows * of->segments * states(of) * width;
    const size_t intentions = (size_t)of->ticks * of->segments * of->steps;
    size_t j;

    of->memory = doubles(file, width + maps + intentions + 2 * (size_t)of->ticks);
    if (of->memory == NULL)
        return "ends too early";
    memcpy(of->start, of->memory, width * sizeof *of->start);
    of->maps = of->memory + width;
    of->intention_m = of->maps + maps;
    of->grip_N = of->intention_m + intentions;
    of->flow = of->grip_N + of->ticks;
    for (j = 0; j < of->ticks; j++) {
        if (!(of->flow[j] >= 0 && of->flow[j] < of->flows))
            return "names a grip that it does not hold";
    }
    return NULL;
}

const char *plant_load(plant *of, const char *path, uint64_t seed)
{
    FILE *file = fopen(path, "rb");
    const char *wrong;
    int j;

    memset(of, 0, sizeof *of);
    if (file == NULL)
        return "cannot be read";
    wrong = read_head(of, file);
    if (wrong == NULL)
        wrong = read_body(of, file);
    fclose(file);
    if (wrong != NULL) {
        plant_free(of);
        return wrong;
    }
    memcpy(of->x, of->start, sizeof of->x);
    of->before_m = of->start_intention_m;
    of->random[0] = seed + 1;
    of->random[1] = UINT64_C(0x9e3779b97f4a7c15);
    for (j = 0; j < 20; j++) /* until a small seed has spread */
        uniform(of);
    of->wander_m_s2 = of->acceleration_noise_m_s2 * normal(of);
    of->felt_N = of->grip_N[0];
    return NULL;
}

void plant_free(plant *of)
{
    free(of->memory);
    of->memory = NULL;
}

static double within(double value, double limit)
{
    return value < -limit ? -limit : (value > limit ? limit : value);
}

void plant_read(plant *of, uint64_t tick, td_readings *readings)
{
    const double current_A = of->x[2 * of->masses], sensed_m_s2 = of->x[2 * of->masses + 1];
    const double held_N = of->grip_N[of->at], slack_N = of->grip_hysteresis * held_N;
    double grip_N, felt_m_s2;

    of->wander_m_s2 = of->acceleration_keep * of->wander_m_s2 + of->acceleration_fresh_m_s2 * normal(of);
    of->felt_N = held_N + within(of->felt_N - held_N, slack_N);
    grip_N = of->felt_N + of->grip_noise_N * normal(of);
    readings->tick = tick;
    readings->encoder_counts = (int32_t)floor(of->x[0] / of->count_m + 0.5);
    readings->grip_N = (td_real)(grip_N > 0 ? grip_N : 0);
    readings->current_A = (td_real)(current_A + of->current_noise_A * normal(of));
    /* At an end of the range a port reads no number. */
    felt_m_s2 = sensed_m_s2 + of->wander_m_s2;
    readings->acceleration_m_s2 = (td_real)(fabs(felt_m_s2) <= of->acceleration_limit_m_s2 ? felt_m_s2 : (double)NAN);
    readings->emergency_stop = readings->late = readings->host_stop = false;
}

/* What the amplifier's pole follows: the command cut at its range, less the crossover's dead band. */
static double felt(const plant *of, double command_A)
{
    if (of->command_limit_A > 0)
        command_A = within(command_A, of->command_limit_A);
    return command_A - within(command_A, of->crossover_A);
}

static void advance_step(plant *of, const double *map, double command_A, double after_m, double step_s)
{
    const uint32_t S = states(of), width = S + PLANT_INPUTS;
    double next[PLANT_MOST_STATES];
    uint32_t row, column;

    of->x[S + COMMAND] = command_A;
    of->x[S + INTENTION] = of->before_m;
    of->x[S + INTENTION_SPEED] = (after_m - of->before_m) / step_s;
    of->before_m = after_m;
    for (row = 0; row < S; row++) {
        next[row] = 0;
        for (column = 0; column < width; column++)
            next[row] += map[row * width + column] * of->x[column];
    }
    memcpy(of->x, next, S * sizeof *next);
}

void plant_advance(plant *of, double command_A)
{
    const uint32_t S = states(of);
    const size_t map = (size_t)S * (S + PLANT_INPUTS);
    const double *maps = of->maps + (size_t)of->flow[of->at] * of->segments * map;
    const double *intention_m = of->intention_m + (size_t)of->at * of->segments * of->steps;
    uint32_t segment, step;

    memmove(of->commands_A + 1, of->commands_A, (PLANT_MOST_DELAY - 1) * sizeof *of->commands_A);
    of->commands_A[0] = command_A;
    for (segment = 0; segment < of->segments; segment++) {
        const double follows_A = felt(of, of->commands_A[of->behind[segment]]);

        if (of->ideal)
            of->x[2 * of->masses] = follows_A;
        for (step = 0; step < of->steps; step++)
            advance_step(of, maps + segment * map, follows_A, *intention_m++, of->step_s[segment]);
    }
    of->at = of->at + 1 < of->ticks ? of->at + 1 : 0;
}
