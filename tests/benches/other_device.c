/* A held haptic drive by its equations of motion, integrated with the classical Runge-Kutta method of fourth order.
 *
 * It shares nothing with the plants of transopt: no matrices, no exponential, no sampled model. Positions point out of
 * the object; all of them, and all velocities, are zero at rest.
 */
#include <math.h>
#include <stddef.h>

enum { MOTOR, MOTOR_V, STYLUS, STYLUS_V, HAND, HAND_V, MODE, MODE_V, CURRENT, SENSOR, STATES };

typedef struct {
    double force_per_current;                 /* N/A */
    double motor_mass, stylus_mass, hand_mass; /* kg */
    double transmission_stiffness, transmission_damping; /* N/m, N s/m, motor to stylus */
    double skin_stiffness, skin_damping;       /* stylus to hand */
    double arm_stiffness, arm_damping;         /* hand to ground */
    double amplifier_rate, sensor_rate;        /* rad/s */
    double mode_mass, mode_stiffness, mode_damping; /* a further mass on the stylus; mass 0: none */
    double friction, friction_speed;           /* N, m/s: Coulomb friction between motor and ground, smoothed */
    double half_gap;                           /* m: the transmission's spring is free within +- this */
    double skin_cubic;                         /* N/m^3 */
    double soft_limit;                         /* A: the amplifier gives S tanh(c / S); 0: it gives c */
    double drift;                              /* 1/s: skin and arm grow by this part in a second, about the run's middle */
} device;

static double rates(const device *d, const double *x, double command, double push, double since, double *dx)
{
    double grown = 1 + d->drift * since;
    double stretch = x[MOTOR] - x[STYLUS];
    double gap = stretch > d->half_gap ? d->half_gap : stretch < -d->half_gap ? -d->half_gap : stretch;
    double transmission = d->transmission_stiffness * (stretch - gap)
        + (stretch != gap || d->half_gap == 0 ? d->transmission_damping * (x[MOTOR_V] - x[STYLUS_V]) : 0);
    double pressed = x[STYLUS] - x[HAND];
    double skin = grown * (d->skin_stiffness * pressed + d->skin_damping * (x[STYLUS_V] - x[HAND_V]))
        + d->skin_cubic * pressed * pressed * pressed;
    double arm = grown * (d->arm_stiffness * x[HAND] + d->arm_damping * x[HAND_V]);
    double friction = d->friction > 0 ? d->friction * tanh(x[MOTOR_V] / d->friction_speed) : 0;
    double mode = d->mode_mass > 0
        ? d->mode_stiffness * (x[STYLUS] - x[MODE]) + d->mode_damping * (x[STYLUS_V] - x[MODE_V]) : 0;
    double given = d->soft_limit > 0 ? d->soft_limit * tanh(command / d->soft_limit) : command;
    double acceleration = (transmission - skin - mode) / d->stylus_mass;

    dx[MOTOR] = x[MOTOR_V];
    dx[MOTOR_V] = (d->force_per_current * x[CURRENT] - friction - transmission) / d->motor_mass;
    dx[STYLUS] = x[STYLUS_V];
    dx[STYLUS_V] = acceleration;
    dx[HAND] = x[HAND_V];
    dx[HAND_V] = (skin - arm + push) / d->hand_mass;
    dx[MODE] = x[MODE_V];
    dx[MODE_V] = d->mode_mass > 0 ? mode / d->mode_mass : 0;
    dx[CURRENT] = d->amplifier_rate * (given - x[CURRENT]);
    dx[SENSOR] = d->sensor_rate * (acceleration - x[SENSOR]);
    return acceleration;
}

/* From rest. `ticks` commands [A], each held for `steps` steps of `h` seconds and felt `late` steps after it is issued;
 * `push` [N] on the hand at the ticks, straight between them, or NULL. Every `stride` steps from the first instant on
 * a row of `out` is written: current [A], acceleration behind the sensor's pole [m/s^2], position of the motor [m],
 * acceleration of the stylus [m/s^2]; ticks * steps / stride rows. */
void simulate(const device *d, const double *command, const double *push, size_t ticks, size_t steps, size_t late,
              double h, size_t stride, double *out)
{
    static const double at[4] = {0, 0.5, 0.5, 1}, weight[4] = {1, 2, 2, 1};
    double x[STATES] = {0}, y[STATES], k[STATES], sum[STATES];
    size_t total = ticks * steps;
    for (size_t n = 0; n < total; n++) {
        double c = n < late ? 0 : command[(n - late) / steps];
        for (int i = 0; i < STATES; i++)
            sum[i] = k[i] = 0;
        for (int stage = 0; stage < 4; stage++) {
            double t = (n + at[stage]) / steps, force = 0;
            if (push) {
                size_t j = (size_t)t;
                size_t next = j + 1 < ticks ? j + 1 : ticks - 1;
                j = j < ticks ? j : ticks - 1;
                force = push[j] + (t - (double)j) * (push[next] - push[j]);
            }
            for (int i = 0; i < STATES; i++)
                y[i] = x[i] + at[stage] * h * k[i];
            double since = (t - 0.5 * ticks) * steps * h; /* the middle of the run */
            double acceleration = rates(d, y, c, force, since, k);
            if (stage == 0 && n % stride == 0) {
                *out++ = x[CURRENT];
                *out++ = x[SENSOR];
                *out++ = x[MOTOR];
                *out++ = acceleration;
            }
            for (int i = 0; i < STATES; i++)
                sum[i] += weight[stage] * k[i];
        }
        for (int i = 0; i < STATES; i++)
            x[i] += h / 6 * sum[i];
    }
}
