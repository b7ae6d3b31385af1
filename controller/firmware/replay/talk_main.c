/* Plays a file of a recorded conversation with the device and prints a hash of what it said and commanded; for
 * sanitizers and emulators.
 *
 * For each tick: u32 size, so many bytes that arrived, i32 encoder_counts, u32 emergency_stop, f64 grip_N,
 * f64 current_A, f64 acceleration_m_s2; a size of 2^32 - 1 is a new device and no tick. Exit code 1 for a file that
 * is not so.
 */
#include <stdio.h>
#include <stdlib.h>

#include "td_bytes.h"
#include "td_probe.h"

#define MOST_BYTES (1u << 20)
#define READINGS_BYTES 32
#define ANOTHER_DEVICE 0xffffffffu

/* Hardware() of controller/protocol/capacity.py. */
static const double hardware[TD_PROBE_HARDWARE] = {1e-4, 10, 10, 0.1, 0.02, 50, 20e3, 50}, cold[2] = {25, 25};
static td_probe probe;
static uint8_t arrived[MOST_BYTES], out[TD_OUTPUT_BYTES];

static void add(uint64_t *hash, const uint8_t *bytes, size_t size)
{
    for (; size > 0; size--)
        *hash = (*hash ^ *bytes++) * UINT64_C(1099511628211); /* FNV-1a */
}

static void step(uint64_t tick, const uint8_t *readings, uint64_t *hash)
{
    const double said[3] = {td_get_f64(readings + 8), td_get_f64(readings + 16), td_get_f64(readings + 24)};
    double answer[4], contacts[4 * TD_MAX_EVENTS];
    uint8_t events[TD_MAX_EVENTS], command[8];

    td_probe_step(&probe.device, tick, td_get_i32(readings), td_get_u32(readings + 4) != 0 ? 1 : 0, said, answer, events, contacts);
    td_put_f64(command, answer[0]);
    add(hash, command, sizeof command);
    add(hash, out, td_device_send(&probe.device, out, sizeof out));
}

int main(int argc, char **argv)
{
    FILE *file = argc == 2 ? fopen(argv[1], "rb") : NULL;
    uint64_t hash = UINT64_C(14695981039346656037), tick = 0;
    uint8_t head[4], readings[READINGS_BYTES];
    int failed = file == NULL;

    td_probe_start(&probe, 1, hardware, cold, true);
    while (!failed && fread(head, 1, sizeof head, file) == sizeof head) {
        const uint32_t size = td_get_u32(head);

        if (size == ANOTHER_DEVICE) {
            td_probe_start(&probe, 1, hardware, cold, true);
            tick = 0;
            continue;
        }
        failed = size > MOST_BYTES || fread(arrived, 1, size, file) != size ||
                 fread(readings, 1, sizeof readings, file) != sizeof readings;
        if (failed)
            break;
        td_device_receive(&probe.device, arrived, size);
        step(tick++, readings, &hash);
    }
    if (file != NULL)
        fclose(file);
    printf("%016llx\n", (unsigned long long)hash);
    return failed;
}
