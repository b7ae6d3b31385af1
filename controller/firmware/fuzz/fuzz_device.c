/* Whatever a host sends and sensors read: what leaves the device keeps the hardware's limits. For libFuzzer.
 *
 * The fuzzer's bytes are a program: requests with sound checksums, configurations near a sound one and anywhere, any image,
 * any order, damaged bytes, restarts, and ticks with readings that are true, still, or absurd. Beside the device runs an
 * amplifier of its own with a pole anywhere in the hardware's range, and a coil of its own with the hardware's numbers.
 * After every tick:
 *
 *     the command is a number, inside the hardware's range, and zero where the amplifier is not enabled
 *     it is enabled only while the device says that it is armed or plays, or while a pulse was granted
 *     the true current keeps the hardware's limit, and the coil its temperature
 */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "td_bytes.h"
#include "td_device.h"
#include "td_sha256.h"

#define MOST_TICKS 30000 /* of one input */
#define PI 3.141592653589793
#define IMAGE_ROOM 20000
#define KELVIN 0.02 /* by which the coil here and the guard's implicit rule may differ */

static td_device device;
static const uint8_t *program;
static size_t left;

static double true_A, winding_C, housing_C, pole_decay;
static td_hardware hardware;
static bool simulated;
static uint64_t tick;
static uint32_t boots;
static uint16_t sequence;
static double height_counts, speed_counts, grip_N;
static uint8_t configuration[TD_CONFIGURATION_BYTES], image[IMAGE_ROOM];
static uint8_t configuration_sha256[TD_HASH_BYTES], image_sha256[TD_HASH_BYTES];
static size_t image_size;
static int32_t spent;

static uint8_t byte(void)
{
    if (left == 0)
        return 0;
    left--;
    return *program++;
}

static uint32_t word(void)
{
    const uint32_t high = byte();

    return high << 8 | byte();
}

/* Numbers at which something may break, or any. */
static double odd(void)
{
    static const double numbers[] = {
        0, -1, 1, 0.5, -0.5, 2, 1e-3, 1e-9, 1e9, 1e39, -1e39, 1e300, -1e300, 5e-324, 1e-40, 10, 100, 3.4e38, 32767,
    };
    const uint8_t which = byte();
    uint8_t bytes[8];
    int j;

    if (which < sizeof numbers / sizeof numbers[0])
        return numbers[which];
    if (which == 100)
        return (double)NAN;
    if (which == 101)
        return (double)INFINITY;
    if (which < 160)
        return pow(10, (double)(which - 130) / 4) * (byte() & 1 ? -1 : 1);
    for (j = 0; j < 8; j++)
        bytes[j] = byte();
    return td_get_f64(bytes);
}

static void require(bool holds, const char *what)
{
    if (holds)
        return;
    fprintf(stderr, "tick %llu: %s; true current %.9g A, winding %.6g C\n", (unsigned long long)tick, what, true_A, winding_C);
    abort();
}

/* ------------------------------------------------------------------------------------------------ the line */

static void drain(void)
{
    uint8_t bytes[700];

    while (td_device_send(&device, bytes, sizeof bytes) > 0)
        ;
}

static void say(uint8_t kind, const uint8_t *body, size_t size)
{
    uint8_t payload[TD_PAYLOAD_LIMIT], frame[TD_FRAME_LIMIT];

    payload[TD_HEADER_KIND] = kind;
    payload[TD_HEADER_FLAGS] = 0;
    td_put_u16(payload + TD_HEADER_SEQUENCE, ++sequence);
    td_put_u32(payload + TD_HEADER_SESSION, 7);
    memcpy(payload + TD_HEADER_BYTES, body, size);
    td_device_receive(&device, frame, td_wire_encode(payload, TD_HEADER_BYTES + size, frame));
    drain();
}

static void hello(void)
{
    uint8_t body[TD_HELLO_BYTES];

    td_put_u32(body + TD_HELLO_MAGIC, TD_MAGIC);
    td_put_u16(body + TD_HELLO_PROTOCOL, TD_PROTOCOL);
    td_put_u32(body + TD_HELLO_NONCE, 1);
    say(TD_KIND_HELLO, body, sizeof body);
}

static void number(int place, double value)
{
    td_put_f64(configuration + TD_CONFIGURATION_VALUES + 8 * place, value);
}

/* A sound configuration, for this hardware. */
static void sound_configuration(void)
{
    static const struct {
        int place;
        double value;
    } stated[] = {
        {TD_CFG_LEAD_S, 3e-4}, {TD_CFG_GRIP_MIN_N, 0.5}, {TD_CFG_COUNT_M, 24.5e-6}, {TD_CFG_WINDOW_TICKS, 20},
        {TD_CFG_LEAST_SPEED_M_S, 0.02}, {TD_CFG_TOUCH_HEIGHT_M, 1e-4}, {TD_CFG_REARM_HEIGHT_M, 5e-4},
        {TD_CFG_REARM_S, 5e-3}, {TD_CFG_GRIP_FILTER_S, 5e-3}, {TD_CFG_GRIP_MARGIN_N, 0.1}, {TD_CFG_GRID_SLACK, 0.02},
        {TD_CFG_GRID_SLACK_N, 0.1}, {TD_CFG_GAIN_RATE_1_S, 10}, {TD_CFG_WITHHOLD_K, 5}, {TD_CFG_LEAST_SCALE, 0.25},
        {TD_CFG_ENCODER_LIMIT_COUNTS, 1000000}, {TD_CFG_FASTEST_M_S, 5}, {TD_CFG_CURRENT_RANGE_A, 50},
        {TD_CFG_OVER_CURRENT, 1.25}, {TD_CFG_NO_CURRENT_A, 0.5}, {TD_CFG_NO_CURRENT_PART, 0.25},
        {TD_CFG_NO_CURRENT_S, 1e-3}, {TD_CFG_STUCK_A_S, 15e-3}, {TD_CFG_STUCK_A, 0.5}, {TD_CFG_STUCK_S, 1},
        {TD_CFG_GRIP_OPEN_N, -1}, {TD_CFG_GRIP_SHORT_N, 60}, {TD_CFG_ENCODER_DIRECTION, 1},
        {TD_CFG_ACCELERATION_SCALE, 1}, {TD_CFG_HAS_ACCELEROMETER, 1}, {TD_CFG_GRIP_SCALE, 1},
        {TD_CFG_MONITOR_SCALE, 1}, {TD_CFG_AMPLIFIER_SCALE, 1}, {TD_CFG_PULSE_A, 0.05}, {TD_CFG_PULSE_TICKS, 20},
        {TD_CFG_PULSE_NODES, 1}, {TD_CFG_PULSE_GRIP_N_0, 3}, {TD_CFG_PULSE_ACCELERATION_0, 30},
        {TD_CFG_PULSE_PATH_M_0, 1e-4}, {TD_CFG_HAS_AMPLIFIER, 1}, {TD_CFG_AMPLIFIER_DELAY_S, 68e-6},
    };
    size_t j;

    memset(configuration, 0, sizeof configuration);
    td_put_u32(configuration, TD_CONFIGURATION_MAGIC);
    td_put_u16(configuration + 4, TD_CONFIGURATION_VERSION);
    td_put_u16(configuration + 6, TD_CFG_COUNT);
    for (j = 0; j < sizeof stated / sizeof stated[0]; j++)
        number(stated[j].place, stated[j].value);
    number(TD_CFG_DT_S, hardware.dt_s);
    number(TD_CFG_CURRENT_LIMIT_A, hardware.current_A);
    number(TD_CFG_AMPLIFIER_POLE_HZ, sqrt(hardware.pole_least_Hz * hardware.pole_most_Hz));
    number(TD_CFG_AMPLIFIER_COMMAND_LIMIT_A, hardware.command_A);
}

static void configure(uint8_t how, int changes)
{
    uint8_t body[4 + TD_CONFIGURATION_BYTES];

    sound_configuration();
    if (how & 8) {
        number(TD_CFG_HAS_WALL, 1);
        number(TD_CFG_WALL_STIFFNESS_N_M, 1000 * (double)byte());
        number(TD_CFG_WALL_DAMPING_N_S_M, byte());
        number(TD_CFG_WALL_FORCE_PER_CURRENT_N_A, 1.25);
        number(TD_CFG_WALL_DERIVATIVE_FILTER_HZ, 500);
    }
    if (how & 16)
        number(TD_CFG_HOST_STARTS, 1);
    if (how & 32)
        number(TD_CFG_HAS_AMPLIFIER, 0);
    if (how & 64) {
        number(TD_CFG_STUCK_S, 1000);
        number(TD_CFG_STUCK_A_S, 1e6);
        number(TD_CFG_NO_CURRENT_S, 1000);
        number(TD_CFG_OVER_CURRENT, hardware.over_current_A / hardware.current_A * 0.999);
    }
    if (how & 128) {
        number(TD_CFG_AMPLIFIER_SCALE, (byte() & 1 ? -1 : 1) * (0.2 + 4.8 * byte() / 255));
        number(TD_CFG_MONITOR_SCALE, (byte() & 1 ? -1 : 1) * (0.2 + 4.8 * byte() / 255));
    }
    for (; changes > 0; changes--)
        number(byte() % TD_CFG_COUNT, odd());
    memcpy(body + 4, configuration, sizeof configuration);
    td_put_u32(body, 0);
    say(TD_KIND_CONFIGURE, body, sizeof body);
    td_sha256_of(configuration, sizeof configuration, configuration_sha256);
    say(TD_KIND_CONFIGURE_COMMIT, configuration_sha256, TD_HASH_BYTES);
}

static void upload(uint8_t how, int changes)
{
    const uint32_t speeds = how & 1 ? 2 : 1, grips = how & 2 ? 2 : 1, samples = 20 + 4 * (uint32_t)byte(), nodes = speeds * grips;
    const uint8_t size = byte(), shape = byte();
    /* What stands for long keeps the current limit, a single sample may be as large as the command's. */
    const double most_A = shape & 64 || hardware.current_A > hardware.command_A ? hardware.command_A : hardware.current_A;
    const double scale_A = most_A / 32767 * (size & 1 ? 1 : (1 + size) / 256.0);
    uint8_t body[TD_DATA_BYTES + TD_DATA_LIMIT], *at = image + TD_IMAGE_BYTES;
    uint32_t j, k, offset;

    memset(image, 0, sizeof image);
    td_put_u32(image + TD_IMAGE_MAGIC, TD_IMAGE_MAGIC_VALUE);
    td_put_u16(image + TD_IMAGE_VERSION, TD_IMAGE_VERSION_VALUE);
    td_put_u16(image + TD_IMAGE_FLAGS, how >> 2 & 3);
    td_put_u16(image + TD_IMAGE_SPEEDS, (uint16_t)speeds);
    td_put_u16(image + TD_IMAGE_GRIPS, (uint16_t)grips);
    td_put_u32(image + TD_IMAGE_SAMPLES, samples);
    td_put_u32(image + TD_IMAGE_TAIL_SAMPLES, 2);
    td_put_f64(image + TD_IMAGE_DT_S, hardware.dt_s);
    td_put_f64(image + TD_IMAGE_LEAD_S, 3e-4);
    td_put_f64(image + TD_IMAGE_SCALE_A, scale_A);
    td_put_f64(image + TD_IMAGE_GRIP_MIN_N, 0.5);
    for (j = 0; j < speeds; j++, at += 8)
        td_put_f64(at, 0.1 + 0.3 * j);
    for (j = 0; j < grips; j++, at += 8)
        td_put_f64(at, 1 + 4 * j);
    for (j = 0; j < nodes; j++, at += 8)
        td_put_f64(at, how & 16 ? odd() : 0);
    for (k = 0; k < nodes; k++) {
        for (j = 0; j < samples; j++, at += 2) {
            const uint32_t period = 1 + (shape & 31u);
            const bool on = j + 2 < samples && (!(shape & 64) || j % (4 * period) < period);
            const int16_t count = !on ? 0 : (j / period & 1 && !(shape & 128) ? -32767 : 32767);

            td_put_u16(at, (uint16_t)count);
        }
    }
    image_size = (size_t)(at - image);
    for (; changes > 0; changes--) {
        if (byte() & 1)
            td_put_f64(image + TD_IMAGE_DT_S + 8 * (byte() & 3), odd());
        else
            image[word() % image_size] = byte();
    }
    td_sha256_of(image, image_size, image_sha256);
    td_put_u32(body, (uint32_t)image_size);
    memcpy(body + TD_UPLOAD_BEGIN_SHA256, image_sha256, TD_HASH_BYTES);
    say(TD_KIND_UPLOAD_BEGIN, body, TD_UPLOAD_BEGIN_BYTES);
    for (offset = 0; offset < image_size; offset += TD_DATA_LIMIT) {
        const size_t size = image_size - offset < TD_DATA_LIMIT ? image_size - offset : TD_DATA_LIMIT;

        td_put_u32(body + TD_DATA_OFFSET, offset);
        memcpy(body + TD_DATA_DATA, image + offset, size);
        say(TD_KIND_DATA, body, TD_DATA_BYTES + size);
    }
    say(TD_KIND_COMMIT, body, 0);
}

static void arm(void)
{
    const uint8_t how = byte();
    uint8_t body[TD_ARM_BYTES];

    body[TD_ARM_TRIAL] = how & 1;
    td_put_u16(body + TD_ARM_LEASE_MS, 1000);
    td_put_f64(body + TD_ARM_GAIN, how & 2 ? odd() : (how & 1 ? 0.1 : 1));
    memcpy(body + TD_ARM_CONFIGURATION_SHA256, configuration_sha256, TD_HASH_BYTES);
    memcpy(body + TD_ARM_LIBRARY_SHA256, image_sha256, TD_HASH_BYTES);
    say(TD_KIND_ARM, body, sizeof body);
}

static void pulse(void)
{
    const uint8_t how = byte();
    uint8_t body[TD_PULSE_BYTES];

    td_put_f64(body + TD_PULSE_CURRENT_A, how & 1 ? odd() : (how & 2 ? -0.05 : 0.05));
    td_put_u16(body + TD_PULSE_TICKS, how & 4 ? (uint16_t)word() : 20);
    body[TD_PULSE_PAIRS] = how >> 4 & 3;
    say(TD_KIND_PULSE, body, sizeof body);
}

static void one_number(uint8_t kind)
{
    uint8_t body[8];

    td_put_f64(body, kind == TD_KIND_GAIN && (byte() & 1) ? 1 : odd());
    say(kind, body, sizeof body);
}

static void lease(void)
{
    const uint8_t body[TD_LEASE_BYTES] = {0};

    say(TD_KIND_LEASE, body, sizeof body);
}

static void anything(void)
{
    uint8_t body[64], kind = byte();
    size_t size = byte() % sizeof body, j;

    for (j = 0; j < size; j++)
        body[j] = byte();
    if (kind & 128)
        td_device_receive(&device, body, size);
    else
        say(kind, body, size);
}

/* ------------------------------------------------------------------------------------------------ the world */

/* The coil's two nodes, by Euler over one period; i: the largest over it. */
static void warm(double i_A)
{
    const double effective = fabs(i_A) + 0.02, R = hardware.R_ohm * (1 + 0.0039 * (winding_C - 25));
    const double down = (winding_C - housing_C) / hardware.R_wh_K_W, out = (housing_C - hardware.ambient_C) / hardware.R_ha_K_W;

    winding_C += hardware.dt_s * (R * effective * effective - down) / (hardware.tau_w_s / hardware.R_wh_K_W);
    housing_C += hardware.dt_s * (down - out) / (hardware.tau_h_s / hardware.R_ha_K_W);
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
    readings.acceleration_m_s2 = 0;
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
    true_A = pole_decay * true_A + (1 - pole_decay) * command;
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
    sequence = 0;
    true_A = 0; /* an amplifier without power for the time of a restart */
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    uint8_t how;
    double part;

    program = data;
    left = size;
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
    tick = 0;
    spent = 0;
    boots = 0;
    height_counts = 200;
    speed_counts = 0;
    grip_N = 3;
    memset(configuration_sha256, 0, sizeof configuration_sha256);
    memset(image_sha256, 0, sizeof image_sha256);
    restart(false);
    /* As the guard takes it when it knows nothing. */
    td_device_coil(&device, &winding_C, &housing_C);
    while (left > 0 && spent < MOST_TICKS) {
        switch (byte() & 31) {
        case 0: hello(); break;
        case 1: how = byte(); configure(how, how & 7); break;
        case 2: how = byte(); upload(how, how >> 5); break;
        case 3: arm(); break;
        case 4: { const uint8_t body = byte() & 1; say(TD_KIND_START, &body, 1); break; }
        case 5: say(TD_KIND_DISARM, data, 0); break;
        case 6: say(TD_KIND_RESET, data, 0); break;
        case 7: one_number(TD_KIND_GAIN); break;
        case 8: { uint8_t body[2]; td_put_u16(body, byte()); say(TD_KIND_TELEMETRY, body, 2); break; }
        case 9: pulse(); break;
        case 10: one_number(TD_KIND_SURFACE); break;
        case 11: say(TD_KIND_EVIDENCE, data, 0); break;
        case 12: lease(); break;
        case 13: say(TD_KIND_EMERGENCY_STOP, data, 0); break;
        case 14: anything(); break;
        case 15: restart((byte() & 1) != 0 || hardware.has_coil); break;
        case 16: move(); break;
        case 17: case 18: case 19: case 20: case 21: case 22: play(); break;
        default: steps(); break;
        }
    }
    return 0;
}
