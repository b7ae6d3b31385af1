/* The device's core with a compiled plant, on a pseudo-terminal or a socket in real time.
 *
 * The program that `transopt-device` builds and starts. Its first line on standard output says where it can be
 * opened. While it runs it obeys lines on standard input: reset (power gone and back), quit.
 */
#define _XOPEN_SOURCE 700

#include <errno.h>
#include <fcntl.h>
#include <math.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

#include "link.h"
#include "plant.h"
#include "td_device.h"
#include "trouble.h"

#define CHUNK 8192
#define BEHIND_MOST_S 0.25 /* after a longer sleep of the machine time is not caught up */
#define LINE 128
#define DT_S 1e-4
/* The amplifier as controller/protocol/capacity.py has it, with the coil of a Maxon RE 25 (118743). */
static const td_hardware hardware = {DT_S, 10, 10, 0.1, 0.02, 50, 20e3, 50, true, 2.18, 3.1, 14, 12, 612, 100, 25};

typedef struct {
    const char *listen, *plant;
    double delay_ms, loss, corruption, reset_s;
    long seed, boot;
    bool simulated;
} options;

static td_device device;
static plant body;
static trouble to_device, to_host;
static uint32_t boots;
static double heat_C[2] = {25, 25}; /* of the coil, which begins cold and keeps its heat over a loss of power */
static uint64_t tick;
static volatile sig_atomic_t ended;

static void end(int signal_number)
{
    (void)signal_number;
    ended = 1;
}

static int fail(const char *what, const char *why)
{
    fprintf(stderr, "error: %s: %s\n", what, why);
    return 2;
}

static bool number_of(const char *name, const char *given, const char *text, double *value)
{
    char *rest;

    if (strcmp(name, given) != 0)
        return false;
    *value = strtod(text, &rest);
    if (*rest != '\0' || rest == text || !(*value >= 0) || !(*value < 1e12)) {
        fail(name, "wants a number >= 0");
        exit(2);
    }
    return true;
}

static bool parse(int argc, char **argv, options *said)
{
    double seed = 0, boot = 1, simulated = 0;
    int j;

    for (j = 1; j < argc; j++) {
        const char *name = argv[j], *text = j + 1 < argc ? argv[j + 1] : "";

        j++;
        if (strcmp(name, "--listen") == 0)
            said->listen = text;
        else if (strcmp(name, "--plant") == 0)
            said->plant = text;
        else if (!number_of(name, "--delay-ms", text, &said->delay_ms) &&
                 !number_of(name, "--loss", text, &said->loss) &&
                 !number_of(name, "--corruption", text, &said->corruption) &&
                 !number_of(name, "--reset-every", text, &said->reset_s) && !number_of(name, "--seed", text, &seed) &&
                 !number_of(name, "--boot", text, &boot) &&
                 !number_of(name, "--simulated", text, &simulated)) {
            fail(name, "no such option");
            return false;
        }
    }
    said->seed = (long)seed;
    said->boot = (long)boot;
    said->simulated = simulated > 0;
    return true;
}

/* Power gone and back: what it knew is lost, the hand and the stylus go on. */
static void start_device(const options *said)
{
    const td_port port = {(uint32_t)said->boot + boots++, hardware, said->simulated, heat_C[0], heat_C[1], NULL, NULL, NULL};

    td_device_start(&device, &port);
    tick = 0;
}

static void one_tick(void)
{
    td_readings readings;
    td_output output;

    plant_read(&body, tick++, &readings);
    td_device_step(&device, &readings, &output);
    td_device_coil(&device, &heat_C[0], &heat_C[1]);
    plant_advance(&body, (double)output.command_A);
}

static double now_s(void)
{
    struct timespec now;

    clock_gettime(CLOCK_MONOTONIC, &now);
    return (double)now.tv_sec + 1e-9 * (double)now.tv_nsec;
}

/* Lines on standard input; whether to go on. */
static bool obey(const options *said)
{
    static char line[LINE];
    static size_t size;
    char one;
    ssize_t got;

    while ((got = read(STDIN_FILENO, &one, 1)) == 1) {
        if (one != '\n') {
            if (size + 1 < sizeof line)
                line[size++] = one;
            continue;
        }
        line[size] = '\0';
        size = 0;
        if (strcmp(line, "quit") == 0)
            return false;
        if (strcmp(line, "reset") == 0)
            start_device(said);
    }
    /* It does not outlive who started it. */
    return got < 0;
}

/* Bytes both ways, through the line's troubles. */
static void exchange(port_link *link)
{
    static uint8_t bytes[CHUNK], leaving[CHUNK];
    static size_t leaving_size, left;
    size_t size;

    while ((size = link_receive(link, bytes, sizeof bytes)) > 0)
        trouble_enter(&to_device, bytes, size, now_s());
    while ((size = trouble_leave(&to_device, bytes, sizeof bytes, now_s())) > 0)
        td_device_receive(&device, bytes, size);
    for (;;) {
        if (left == leaving_size) {
            while ((size = td_device_send(&device, bytes, sizeof bytes)) > 0)
                trouble_enter(&to_host, bytes, size, now_s());
            leaving_size = trouble_leave(&to_host, leaving, sizeof leaving, now_s());
            left = 0;
        }
        size = link_send(link, leaving + left, leaving_size - left);
        if (size == 0)
            return;
        left += size;
    }
}

static int run_real_time(const options *said, port_link *link)
{
    double started_s = now_s(), reset_at_s = said->reset_s > 0 ? started_s + said->reset_s : (double)INFINITY;
    uint64_t passed = 0;

    fcntl(STDIN_FILENO, F_SETFL, fcntl(STDIN_FILENO, F_GETFL, 0) | O_NONBLOCK);
    while (!ended && obey(said)) {
        double time_s = now_s();

        if (time_s - started_s - (double)passed * DT_S > BEHIND_MOST_S)
            started_s = time_s - (double)passed * DT_S;
        if (time_s >= reset_at_s) {
            start_device(said);
            reset_at_s = time_s + said->reset_s;
        }
        exchange(link);
        for (; (double)(passed + 1) * DT_S <= time_s - started_s; passed++)
            one_tick();
        exchange(link);
        link_wait(link, 1);
    }
    return 0;
}

int main(int argc, char **argv)
{
    options said = {NULL, NULL, 0, 0, 0, 0, 0, 1, false};
    static port_link link = {-1, -1, -1, false};
    char name[LINK_NAME], where[LINK_NAME] = "pseudo-terminal";
    const char *wrong;
    struct sigaction action;
    int result;

    if (!parse(argc, argv, &said))
        return 2;
    if (said.plant == NULL)
        return fail("--plant FILE", "is missing");
    wrong = plant_load(&body, said.plant, (uint64_t)said.seed);
    if (wrong != NULL)
        return fail(said.plant, wrong);
    memset(&action, 0, sizeof action);
    action.sa_handler = end;
    sigaction(SIGTERM, &action, NULL);
    sigaction(SIGINT, &action, NULL);
    trouble_start(&to_device, 1e-3 * said.delay_ms, said.loss, said.corruption, 2 * (uint64_t)said.seed);
    trouble_start(&to_host, 1e-3 * said.delay_ms, said.loss, said.corruption, 2 * (uint64_t)said.seed + 1);
    start_device(&said);
    if (said.listen != NULL)
        snprintf(where, sizeof where, "--listen %s", said.listen);
    wrong = said.listen != NULL ? link_listen(&link, said.listen, name) : link_open_terminal(&link, name);
    if (wrong != NULL)
        return fail(where, wrong);
    printf("%s\n", name);
    fflush(stdout);
    result = run_real_time(&said, &link);
    link_close(&link);
    plant_free(&body);
    return result;
}
