/* Whatever a host sends and sensors read: what leaves the device keeps the hardware's limits. For libFuzzer.
 *
 * The fuzzer's bytes are a program: requests with sound checksums, configurations near a sound one and anywhere, any image,
 * any order, damaged bytes, restarts, and ticks with readings that are true, still, or absurd. Beside the device runs an
 * amplifier of its own with a pole anywhere in the hardware's range, late by as many ticks as a device may have, stated
 * or not, and a coil of its own with the hardware's numbers.
 * After every tick:
 *
 *     the command is a number, inside the hardware's range, and zero where the amplifier is not enabled
 *     it is enabled only while the device says that it is armed or plays, or while a pulse was granted
 *     the true current keeps the hardware's limit, and the coil its temperature
 *     a pulse keeps the hardware's size and length, comes after a rest, and only while a lease runs
 *     evidence of a pulse or of a trial came of a current that flowed and was read; a trial's is of the library in force
 *     a current that is read as another than the model expects ends a transient within 2 ms
 *     the library in force is the one that was sent, whatever was recorded into the memory of the next
 */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "fuzz_line.h"
#include "td_bytes.h"
#include "td_sha256.h"

#define MOST_TICKS 30000 /* of one input */
#define PUSH_M_S2_A 30 /* as the configuration predicts it */
#define MOST_SAMPLES 1100 /* of an image, and what follows */
#define PI 3.141592653589793
#define KELVIN 0.02 /* by which the coil here and the guard's implicit rule may differ */

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

td_device device;
td_hardware hardware;

static double true_A, winding_C, housing_C, pole_decay;
static double commanded_A[TD_DELAY_TICKS + 1]; /* of the last ticks, the newest first */
static int32_t late_ticks;                     /* by which the amplifier here answers them */
static bool simulated;
static uint64_t tick;
static uint32_t boots;
static double height_counts, speed_counts, grip_N;
static int32_t spent;
static int32_t pulsed_ticks, rested_ticks; /* of the pulse that goes out, and since the last one */
static double pulse_A, played_A, read_A;   /* the largest of the last pulses, and of the transients of the last arming */
static double model_A[TD_DELAY_TICKS + 1]; /* what the configuration's model expects without its delay, the newest first */
static int32_t wrong_ticks;
static bool was_playing;
static uint8_t had, tried_sha256[TD_HASH_BYTES]; /* bits of evidence at the last tick; library of the trial */

static void require(bool holds, const char *what)
{
    if (holds)
        return;
    fprintf(stderr, "tick %llu: %s; true current %.9g A, winding %.6g C\n", (unsigned long long)tick, what, true_A, winding_C);
    abort();
}

/* One tick later, a new value at its beginning. */
static void shift(double *row, double newest)
{
    memmove(row + 1, row, TD_DELAY_TICKS * sizeof *row);
    row[0] = newest;
}

/* The coil's two nodes, by Euler over one period; i: the largest over it. */
static void warm(double i_A)
{
    const double effective = fabs(i_A) + 0.02, R = hardware.R_ohm * (1 + 0.0039 * (winding_C - 25));
    const double down = (winding_C - housing_C) / hardware.R_wh_K_W, out = (housing_C - hardware.ambient_C) / hardware.R_ha_K_W;

    winding_C += hardware.dt_s * (R * effective * effective - down) / (hardware.tau_w_s / hardware.R_wh_K_W);
    housing_C += hardware.dt_s * (down - out) / (hardware.tau_h_s / hardware.R_ha_K_W);
}

static double larger(double one, double other)
{
    return other > one ? other : one;
}

/* Pulses: what goes out while the device says that it is idle. */
static void judge_pulse(const td_output *output)
{
    const double size = fabs((double)output->command_A);

    leased_ticks++;
    if (output->state != TD_STATE_IDLE || !(size > 0)) {
        pulsed_ticks = 0;
        if (rested_ticks < INT32_MAX)
            rested_ticks++;
        return;
    }
    require(size <= hardware.pulse_A * (1 + 1e-6), "a pulse beyond the hardware's");
    require(pulsed_ticks > 0 || rested_ticks >= floor(TD_REST_BETWEEN_PULSES_S / hardware.dt_s), "a pulse without a rest");
    require(++pulsed_ticks * hardware.dt_s <= hardware.pulse_s * (1 + 1e-6), "a pulse too long");
    require(leased_ticks * hardware.dt_s <= 1e-3 * TD_PULSE_LEASE_MS + 2 * hardware.dt_s, "a pulse without a lease");
    rested_ticks = 0;
    pulse_A = larger(size, pulse_A);
}

/* Evidence: only of what flowed and was read. */
static void judge_evidence(const td_readings *readings, const td_output *output)
{
    const uint8_t bits = device.evidence.bits;
    const double usual_A = hardware.pulse_A < TD_PULSE_USUAL_A ? hardware.pulse_A : TD_PULSE_USUAL_A;
    const double least_A = TD_TRIAL_HARDWARE_PART * hardware.current_A;

    if (was_playing) {
        played_A = larger(fabs(true_A), played_A);
        read_A = larger(fabs((double)readings->current_A), read_A);
    }
    if (bits & ~had & TD_PULSE_SOUND)
        require(pulse_A >= TD_PULSE_LEAST_PART * usual_A, "evidence of a pulse that was none");
    if (bits & ~had & TD_TRIAL_FINISHED) {
        /* The amplifier here has another pole than the model: it may give less. */
        require(played_A >= 0.5 * least_A && read_A >= 0.99 * least_A, "evidence of a trial of nothing");
        memcpy(tried_sha256, device.store.library_sha256, TD_HASH_BYTES);
    }
    if (bits & TD_TRIAL_FINISHED)
        require(memcmp(tried_sha256, device.store.library_sha256, TD_HASH_BYTES) == 0, "evidence of another library");
    had = bits;
    if (output->state == TD_STATE_IDLE)
        played_A = read_A = 0;
}

/* The current that is read beside the one that the configuration's own model expects; a little wider than the rule. */
static void judge_current(const td_readings *readings, const td_output *output)
{
    const td_calibration *calibration = &device.store.config.calibration;
    const double read = (double)calibration->monitor_scale * (double)readings->current_A;
    const double decay = (double)device.store.config.decay, expected_A = model_A[device.store.config.late_ticks];

    if (!device.store.configured) {
        memset(model_A, 0, sizeof model_A);
        return;
    }
    if (was_playing && output->state != TD_STATE_FAULT && fabs(read - expected_A) > 0.32 + 0.31 * fabs(expected_A))
        wrong_ticks++;
    else
        wrong_ticks = 0;
    require(wrong_ticks * hardware.dt_s <= TD_WRONG_CURRENT_S + 2 * hardware.dt_s, "another current than was commanded");
    shift(model_A, decay * model_A[0] + (1 - decay) * (double)output->command_A * (double)calibration->amplifier_scale);
    was_playing = output->state == TD_STATE_PLAYING;
}

static void judge_library(void)
{
    const td_store *store = &device.store;
    uint8_t digest[TD_SHA256_BYTES];

    if (store->size == 0)
        return;
    td_sha256_of(store->images[store->current], store->size, digest);
    require(memcmp(digest, store->library_sha256, sizeof digest) == 0, "another library than was sent");
}

static void step(uint8_t mode)
{
    td_readings readings;
    td_output output;
    const bool pulsing = device.pulse.left > 0;
    double command, before = true_A;

    memset(&output, 0, sizeof output);
    height_counts += speed_counts;
    readings.tick = tick++;
    readings.encoder_counts = (int32_t)floor(height_counts);
    readings.grip_N = (td_real)grip_N;
    readings.current_A = (td_real)true_A;
    readings.acceleration_m_s2 = (td_real)(PUSH_M_S2_A * true_A);
    readings.emergency_stop = readings.late = readings.host_stop = false;
    if (mode == 1) {
        readings.current_A = (td_real)odd();
        readings.grip_N = (td_real)odd();
        readings.acceleration_m_s2 = (td_real)odd();
        readings.encoder_counts = (int32_t)(word() << 16 | word());
    } else if (mode == 2) {
        readings.current_A = 0; /* a monitor that shows nothing */
    } else if (mode == 3) {
        readings.emergency_stop = byte() & 1;
        readings.late = byte() & 1;
    }
    td_device_step(&device, &readings, &output);
    command = (double)output.command_A;
    require(!isnan(command) && !isnan((double)output.transient_A) && !isnan((double)output.feedback_A), "a number that is none");
    require(fabs(command) <= hardware.command_A * (1 + 1e-6), "beyond the command's range");
    require(output.enabled || !(fabs(command) > 0), "a command without power");
    require(!output.enabled || output.state == TD_STATE_ARMED || output.state == TD_STATE_PLAYING ||
                (pulsing && output.state == TD_STATE_IDLE),
            "power though neither armed nor pulsing");
    judge_pulse(&output);
    judge_evidence(&readings, &output);
    judge_current(&readings, &output);
    shift(commanded_A, command);
    true_A = pole_decay * true_A + (1 - pole_decay) * commanded_A[late_ticks];
    require(fabs(true_A) <= hardware.current_A * (1 + 1e-6), "beyond the true current");
    if (hardware.has_coil) {
        warm(fabs(true_A) > fabs(before) ? true_A : before);
        require(winding_C <= hardware.limit_C + KELVIN, "beyond the coil's temperature");
    }
    if (device.port.simulated == false && (output.state == TD_STATE_ARMED || output.state == TD_STATE_PLAYING))
        require(device.evidence.bits & TD_PULSE_SOUND, "armed without a sound pulse");
}

static void steps(void)
{
    const uint8_t mode = byte() & 7;
    int32_t count = mode == 1 ? 1 + (byte() & 15) : 8 * (1 + byte());

    for (; count > 0 && spent < MOST_TICKS; count--, spent++) {
        step(mode);
        if (count % 512 == 0)
            lease();
        if (count % 64 == 0 && mode != 4)
            drain();
    }
}

static void record(void)
{
    const uint8_t every = byte();
    uint8_t body[TD_TELEMETRY_BYTES];

    td_put_u16(body + TD_TELEMETRY_EVERY, every & 15);
    td_put_u16(body + TD_TELEMETRY_BEFORE, every & 16 ? (uint16_t)word() : 0);
    say(TD_KIND_TELEMETRY, body, sizeof body);
}

static void move(void)
{
    const uint8_t how = byte();

    speed_counts = how < 64 ? 0 : ((double)how - 160) / 10;
    if (how & 1)
        height_counts = 200;
    grip_N = byte() & 3 ? 3 : (double)byte() / 16;
}

/* All that leads to waveforms in one breath, and some of them: started by the host, or by a contact. */
static void play(void)
{
    const uint8_t how = byte(), shape = byte();
    int32_t j, count;

    hello();
    say(TD_KIND_DISARM, &how, 0);
    say(TD_KIND_RESET, &how, 0);
    configure((uint8_t)((how & 0xe8) | (how & 8 ? 0 : 16)), how & 1);
    upload(shape & 16, shape & 1);
    speed_counts = 0;
    for (j = 0; j < 30; j++, spent++)
        step(0);
    arm();
    for (count = byte() & 15; count > 0 && spent < MOST_TICKS; count--) {
        const uint8_t sign = byte() & 1, mode = how & 2 ? 0 : 2;

        say(TD_KIND_START, &sign, 1);
        lease();
        speed_counts = how & 8 ? (count & 1 ? -1.2 : 1.2) : 0;
        for (j = 4 * byte(); j > 0 && spent < MOST_TICKS; j--, spent++)
            step(mode);
        drain();
        if (how & 4) {
            say(TD_KIND_DISARM, &how, 0);
            configure((uint8_t)((how & 0xe8) | 16), 0);
            arm();
        }
    }
}

/* Configured and at rest, and some pulses: without a pause, or without a lease. */
static void pulses(void)
{
    const uint8_t how = byte();
    int32_t j, count;

    hello();
    say(TD_KIND_DISARM, &how, 0);
    say(TD_KIND_RESET, &how, 0);
    configure((uint8_t)(16 | (how & 132)), 0);
    speed_counts = 0;
    for (j = 0; j < 30; j++, spent++)
        step(0);
    for (count = byte() & 7; count > 0 && spent < MOST_TICKS; count--) {
        pulse_A = 0;
        pulse();
        for (j = 64 * byte(); j > 0 && spent < MOST_TICKS; j--, spent++) {
            if (j % 512 == 0 && !(how & 8))
                lease();
            step(0);
        }
    }
}

/* All that leads to evidence in one breath, as the check does it: pulses, a trial, at times another library after it. */
static void prove(void)
{
    const uint8_t how = byte(), sign = 0;
    uint8_t body[TD_PULSE_BYTES];
    int32_t j;

    hello();
    say(TD_KIND_DISARM, &how, 0);
    say(TD_KIND_RESET, &how, 0);
    configure((uint8_t)(16 | (how & 128)), 0);
    upload(how & 16, 0);
    speed_counts = 0;
    for (j = 0; j < 30; j++, spent++)
        step(0);
    td_put_f64(body + TD_PULSE_CURRENT_A, 0.05);
    td_put_u16(body + TD_PULSE_TICKS, 20);
    body[TD_PULSE_PAIRS] = 1;
    pulse_A = 0;
    say(TD_KIND_PULSE, body, sizeof body);
    for (j = 0; j < 2 * (int32_t)(TD_REST_BETWEEN_PULSES_S / hardware.dt_s) + 200 && spent < MOST_TICKS; j++, spent++) {
        if (j % 512 == 0 && !(how & 8))
            lease();
        step(0);
    }
    if (how & 1)
        return;
    arm_trial();
    say(TD_KIND_START, &sign, 1);
    for (j = 0; j < MOST_SAMPLES && spent < MOST_TICKS; j++, spent++)
        step(how & 2 ? 2 : 0);
    if (how & 4) {
        say(TD_KIND_DISARM, &how, 0);
        upload(how & 16, 0);
        step(0);
    }
}

static void restart(bool kept)
{
    td_port port;
    double was_C[2];

    memset(&port, 0, sizeof port);
    td_device_coil(&device, &was_C[0], &was_C[1]);
    port.boot = ++boots;
    port.hardware = hardware;
    port.simulated = simulated;
    port.winding_C = kept ? was_C[0] : (double)NAN;
    port.housing_C = kept ? was_C[1] : (double)NAN;
    td_device_start(&device, &port);
    line_restart();
    true_A = 0; /* an amplifier without power for the time of a restart */
    memset(commanded_A, 0, sizeof commanded_A);
    memset(model_A, 0, sizeof model_A);
    pulse_A = played_A = read_A = 0;
    pulsed_ticks = wrong_ticks = 0;
    was_playing = false;
    had = 0;
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    uint8_t how;
    double part;

    line_begin(data, size);
    how = byte();
    part = byte() / 255.0;
    memset(&hardware, 0, sizeof hardware);
    hardware.dt_s = how & 1 ? 5e-5 : 1e-4;
    hardware.current_A = how & 2 ? 1.5 : 6;
    hardware.command_A = how & 4 ? 3 : 10;
    hardware.pulse_A = 0.1;
    hardware.pulse_s = 0.02;
    hardware.pole_least_Hz = how & 8 ? 100 : 700;
    hardware.pole_most_Hz = how & 16 ? 10000 : 1600;
    hardware.over_current_A = 2 * hardware.current_A;
    hardware.has_coil = !(how & 32);
    hardware.R_ohm = 2.18;
    hardware.R_wh_K_W = 3.1;
    hardware.R_ha_K_W = 14;
    hardware.tau_w_s = how & 64 ? 0.3 : 12;
    hardware.tau_h_s = 612;
    hardware.limit_C = 100;
    hardware.ambient_C = 30;
    simulated = (how & 128) != 0;
    pole_decay = exp(-2 * PI * hardware.pole_least_Hz * pow(hardware.pole_most_Hz / hardware.pole_least_Hz, part) * hardware.dt_s);
    how = byte();
    late_ticks = how % (TD_DELAY_TICKS + 1);
    stated_late_ticks = how & 128 ? how / 8 % (TD_DELAY_TICKS + 1) : late_ticks;
    tick = 0;
    spent = leased_ticks = rested_ticks = 0;
    boots = 0;
    height_counts = 200;
    speed_counts = 0;
    grip_N = 3;
    restart(false);
    /* As the guard takes it when it knows nothing. */
    td_device_coil(&device, &winding_C, &housing_C);
    while (more() && spent < MOST_TICKS) {
        switch (byte() & 31) {
        case 0: hello(); break;
        case 1: how = byte(); configure(how, how & 7); break;
        case 2: how = byte(); upload(how, how >> 5); break;
        case 3: arm(); break;
        case 4: { const uint8_t body = byte() & 1; say(TD_KIND_START, &body, 1); break; }
        case 5: say(TD_KIND_DISARM, data, 0); break;
        case 6: say(TD_KIND_RESET, data, 0); break;
        case 7: one_number(TD_KIND_GAIN); break;
        case 8: record(); break;
        case 9: pulse(); break;
        case 10: one_number(TD_KIND_SURFACE); break;
        case 11: say(TD_KIND_EVIDENCE, data, 0); break;
        case 12: lease(); break;
        case 13: say(TD_KIND_EMERGENCY_STOP, data, 0); break;
        case 14: anything(); break;
        case 15: restart((byte() & 1) != 0 || hardware.has_coil); break;
        case 16: move(); break;
        case 17: case 18: case 19: case 20: case 21: case 22: play(); break;
        case 23: case 24: prove(); break;
        case 25: case 26: pulses(); break;
        default: steps(); break;
        }
    }
    judge_library();
    return 0;
}
