/* The stylus is the built-in device of transopt (controller/sim/true_device.py) on a level surface, integrated by the
 * semi-implicit Euler method in twelve steps a period, in the frame of the hand. It has no noise.
 *
 * The hand does what a line asks that begins with `please`, in the words in which transopt-play asks a person, so that
 * all that it prints may go there; and `please taps 0.2 0.3`, over and over while the amplifier is enabled.
 */
#include "stylus.h"

#include <stddef.h>
#include <string.h>

#include "../hardware.h"

#define LINE 80
#define KNOTS 40
#define SPEEDS 16
#define DT_S ((float)HARDWARE.dt_s)
#define EARLY 8 /* steps of a period before the amplifier's delay has passed, and after */
#define LATE 4
#define DELAY_S 68e-6f
#define POLE_1_S 6597.3445f /* 1050 Hz */
#define SENSOR_1_S 15707.963f /* 2500 Hz */
#define FORCE_N_A 1.25f
#define MOTOR_KG 0.014f
#define STYLUS_KG 0.026f
#define HAND_KG 0.010f
#define TRANSMISSION_N_M 6e4f
#define TRANSMISSION_N_S_M 8.0f
#define GRAVITY_M_S2 9.81f
#define COUNT_M 24.5e-6
#define HOME_M 20e-3f
#define TOUCH_S 0.3f
#define HALT_S 0.05f
#define TAP_EVERY_S 0.1f /* after the one before, with the amplifier enabled */
#define HELD_N 3.0f
#define LOOSE_N 0.5f /* with which the stylus hangs in a hand that has let go */

static struct {
    float u[3], v[3]; /* motor, stylus, hand: place and velocity in the frame of the hand's intention */
    float current_A, felt_m_s2;
} chain;

/* The hand's intention: straight lines between knots of velocity, at rest after the last. */
static struct {
    double z_m;
    float v_m_s, grip_N;
    struct {
        float after_s, v_m_s;
    } knots[KNOTS];
    int first, last, ticks; /* ticks that are left of the first knot */
    float v0_m_s;
    double end_m; /* where it will be after the last knot, and how fast */
    float end_m_s;
    bool stop;
    float speeds_m_s[SPEEDS];
    int speed, speed_count;
    int idle_ticks; /* since the hand is at rest and the amplifier enabled */
} hand;

static float size_of(float value)
{
    return value < 0 ? -value : value;
}

/* ---------------------------------------------------------------------------------------------------- the stylus */

static void chain_step(float h, float command_A, float carried_m_s2)
{
    const float grip_N = hand.grip_N > LOOSE_N ? hand.grip_N : LOOSE_N;
    const float rod_N = TRANSMISSION_N_M * (chain.u[0] - chain.u[1]) + TRANSMISSION_N_S_M * (chain.v[0] - chain.v[1]);
    const float skin_N = (3000.0f + 2000.0f * grip_N) * (chain.u[1] - chain.u[2]) +
                         (6.0f + 3.0f * grip_N) * (chain.v[1] - chain.v[2]);
    const float arm_N = (160.0f + 110.0f * grip_N) * chain.u[2] + (6.0f + 3.0f * grip_N) * chain.v[2];
    const float stylus_m_s2 = (rod_N - skin_N) / STYLUS_KG;

    chain.current_A += h * POLE_1_S * (1 - 0.5f * h * POLE_1_S) * (command_A - chain.current_A);
    chain.felt_m_s2 += h * SENSOR_1_S * (1 - 0.5f * h * SENSOR_1_S) * (stylus_m_s2 - chain.felt_m_s2);
    chain.v[0] += h * ((FORCE_N_A * chain.current_A - rod_N) / MOTOR_KG - carried_m_s2);
    chain.v[1] += h * (stylus_m_s2 - carried_m_s2);
    chain.v[2] += h * ((skin_N - arm_N) / HAND_KG - carried_m_s2);
    chain.u[0] += h * chain.v[0];
    chain.u[1] += h * chain.v[1];
    chain.u[2] += h * chain.v[2];
}

/* -------------------------------------------------------------------------------------------------------- the hand */

static void then(float after_s, float v_m_s)
{
    if (hand.last == KNOTS)
        return;
    hand.knots[hand.last].after_s = after_s;
    hand.knots[hand.last++].v_m_s = v_m_s;
    hand.end_m += 0.5 * (double)(after_s * (hand.end_m_s + v_m_s));
    hand.end_m_s = v_m_s;
}

/* One servo period; its acceleration. */
static float hand_advance(void)
{
    float before_m_s = hand.v_m_s, part;

    if (hand.first == hand.last) {
        hand.first = hand.last = 0;
        hand.v_m_s = hand.end_m_s = 0;
        hand.end_m = hand.z_m;
        return 0;
    }
    if (hand.ticks == 0) {
        hand.ticks = (int)(hand.knots[hand.first].after_s / DT_S + 0.5f);
        hand.v0_m_s = hand.v_m_s;
    }
    part = DT_S / hand.knots[hand.first].after_s;
    hand.ticks--;
    hand.v_m_s += part * (hand.knots[hand.first].v_m_s - hand.v0_m_s);
    if (hand.ticks == 0)
        hand.v_m_s = hand.knots[hand.first++].v_m_s;
    hand.z_m += 0.5 * (double)(DT_S * (before_m_s + hand.v_m_s));
    return (hand.v_m_s - before_m_s) / DT_S;
}

/* So far outwards, as a person goes. */
static void go(float way_m)
{
    const float speed_m_s = way_m < 0 ? -0.1f : 0.1f;

    if (size_of(way_m) < 1e-6f)
        return;
    if (size_of(way_m) <= 0.01f) { /* a triangle */
        then(0.1f, way_m / 0.1f);
        then(0.1f, 0);
        return;
    }
    then(0.05f, speed_m_s);
    then(way_m / speed_m_s - 0.05f, speed_m_s);
    then(0.05f, 0);
}

/* From where it is straight in at the speed, on for 30 ms, to rest, and back. */
static void tap(float speed_m_s)
{
    const float straight_s = (float)hand.end_m / speed_m_s + 0.015f, depth_m = speed_m_s * (0.03f + straight_s);

    then(0.03f, -speed_m_s);
    then(straight_s, -speed_m_s);
    then(0.03f, 0);
    then(0.02f, 0);
    then(0.1f, depth_m / 0.1f);
    then(0.1f, 0);
}

static void touch_three_times(void)
{
    int j;

    go(-(float)hand.end_m);
    for (j = 0; j < 3; j++) {
        then(TOUCH_S, 0);
        go(3e-3f);
        go(-3e-3f);
    }
    then(TOUCH_S, 0);
    go(HOME_M);
}

/* The decimal number at the beginning of these words, which are moved on behind it; 0 without one. */
static float take_number(const char **words)
{
    float value = 0, place = 1;
    bool point = false;

    while (**words == ' ')
        ++*words;
    for (; (**words >= '0' && **words <= '9') || **words == '.'; ++*words) {
        point = point || **words == '.';
        if (**words != '.')
            value = 10 * value + (float)(**words - '0');
        if (**words != '.' && point)
            place *= 10;
    }
    return value / place;
}

/* The speeds [m/s] that these words name. */
static void take_speeds(const char *words)
{
    hand.speed_count = hand.speed = 0;
    while (*words != '\0' && hand.speed_count < SPEEDS) {
        const float speed_m_s = take_number(&words);

        if (!(speed_m_s >= 0.05f && speed_m_s <= 1.0f))
            return;
        hand.speeds_m_s[hand.speed_count++] = speed_m_s;
    }
}

/* The grip [N] that these words name, as `at 3 N`; the usual one without. */
static float grip_of(const char *words)
{
    const char *named = strstr(words, " at ");
    float grip_N;

    if (named == NULL)
        return HELD_N;
    named += strlen(" at ");
    grip_N = take_number(&named);
    return grip_N > 0 ? grip_N : HELD_N;
}

static bool begins(const char *line, const char *words)
{
    return strncmp(line, words, strlen(words)) == 0;
}

/* Leave what was being done, and come to rest. */
static void halt(void)
{
    hand.first = hand.last = hand.ticks = 0;
    hand.end_m = hand.z_m;
    hand.end_m_s = hand.v_m_s;
    if (hand.v_m_s < 0 || hand.v_m_s > 0)
        then(HALT_S, 0);
}

static void obey(const char *line)
{
    int j;

    while (*line == ' ')
        line++;
    if (!begins(line, "please "))
        return;
    line += strlen("please ");
    hand.speed_count = 0;
    halt();
    if (begins(line, "press")) {
        hand.stop = true;
    } else if (begins(line, "release")) {
        hand.stop = false;
    } else if (begins(line, "let go")) {
        hand.grip_N = 0;
    } else if (begins(line, "hold")) {
        hand.grip_N = grip_of(line);
    } else if (begins(line, "put the weight")) {
        hand.grip_N = HELD_N;
    } else if (begins(line, "taps ")) {
        take_speeds(line + strlen("taps "));
    } else if (begins(line, "tap")) {
        tap(0.2f);
    } else if (begins(line, "touch")) {
        touch_three_times();
    } else if (begins(line, "move")) {
        go(10e-3f);
    } else if (begins(line, "let the stylus")) {
        go(HOME_M - (float)hand.end_m);
    } else if (begins(line, "shake")) {
        for (j = 0; j < 9; j++)
            then(1.0f / 6.0f, j % 2 ? -0.06f : 0.06f);
        then(1.0f / 6.0f, 0);
    }
}

void stylus_hear(char one)
{
    static char line[LINE];
    static size_t size;

    if (one == '\r' || one == '\n') {
        line[size] = '\0';
        size = 0;
        obey(line);
    } else if (size + 1 < sizeof line) {
        line[size++] = one;
    }
}

/* Told so it taps while the amplifier is enabled, at one speed after the other. */
static void tap_in_turn(bool enabled)
{
    const bool idle = hand.first == hand.last && enabled && hand.speed_count > 0;

    hand.idle_ticks = idle ? hand.idle_ticks + 1 : 0;
    if (hand.idle_ticks < (int)(TAP_EVERY_S / DT_S))
        return;
    tap(hand.speeds_m_s[hand.speed]);
    hand.speed = (hand.speed + 1) % hand.speed_count;
}

void stylus_start(void)
{
    hand.z_m = hand.end_m = (double)HOME_M;
    hand.grip_N = HELD_N;
}

void stylus_advance(float before_A, float command_A, bool enabled)
{
    float carried_m_s2;
    int j;

    tap_in_turn(enabled);
    carried_m_s2 = hand_advance();
    for (j = 0; j < EARLY; j++)
        chain_step(DELAY_S / EARLY, before_A, carried_m_s2);
    for (j = 0; j < LATE; j++)
        chain_step((DT_S - DELAY_S) / LATE, command_A, carried_m_s2);
}

int32_t stylus_counts(void)
{
    const double counts = (hand.z_m + (double)chain.u[0]) / COUNT_M;

    return (int32_t)(counts < 0 ? counts - 0.5 : counts + 0.5);
}

float stylus_current_A(void)
{
    return chain.current_A;
}

float stylus_grip_N(void)
{
    return hand.grip_N;
}

float stylus_acceleration_m_s2(void)
{
    return chain.felt_m_s2 + GRAVITY_M_S2;
}

bool stylus_stop_pressed(void)
{
    return hand.stop;
}
