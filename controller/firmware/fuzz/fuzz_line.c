#include "fuzz_line.h"

#include <math.h>
#include <string.h>

#include "td_bytes.h"
#include "td_sha256.h"

#define IMAGE_ROOM 20000
#define NEXT_TO_NOTHING_A 1e-6

int32_t leased_ticks, stated_late_ticks;

static const uint8_t *program;
static size_t left;
static uint16_t sequence;
static uint8_t configuration[TD_CONFIGURATION_BYTES], image[IMAGE_ROOM];
static uint8_t configuration_sha256[TD_HASH_BYTES], image_sha256[TD_HASH_BYTES];
static size_t image_size;

void line_begin(const uint8_t *data, size_t size)
{
    program = data;
    left = size;
    memset(configuration_sha256, 0, sizeof configuration_sha256);
    memset(image_sha256, 0, sizeof image_sha256);
}

void line_restart(void)
{
    sequence = 0;
}

bool more(void)
{
    return left > 0;
}

uint8_t byte(void)
{
    if (left == 0)
        return 0;
    left--;
    return *program++;
}

uint32_t word(void)
{
    const uint32_t high = byte();

    return high << 8 | byte();
}

/* Numbers at which something may break, or any. */
double odd(void)
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

void drain(void)
{
    uint8_t bytes[700];

    while (td_device_send(&device, bytes, sizeof bytes) > 0)
        ;
}

void say(uint8_t kind, const uint8_t *body, size_t size)
{
    uint8_t payload[TD_PAYLOAD_LIMIT], frame[TD_FRAME_LIMIT];

    if (kind == TD_KIND_LEASE || kind == TD_KIND_PULSE)
        leased_ticks = 0;
    payload[TD_HEADER_KIND] = kind;
    payload[TD_HEADER_FLAGS] = 0;
    td_put_u16(payload + TD_HEADER_SEQUENCE, ++sequence);
    td_put_u32(payload + TD_HEADER_SESSION, 7);
    memcpy(payload + TD_HEADER_BYTES, body, size);
    td_device_receive(&device, frame, td_wire_encode(payload, TD_HEADER_BYTES + size, frame));
    drain();
}

void hello(void)
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
        {TD_CFG_PULSE_PATH_M_0, 1e-4}, {TD_CFG_HAS_AMPLIFIER, 1},
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
    /* Half a tick beside whole ones, where that is not too much. */
    number(TD_CFG_AMPLIFIER_DELAY_S, hardware.dt_s * (stated_late_ticks < TD_DELAY_TICKS ? stated_late_ticks + 0.5 : TD_DELAY_TICKS));
    number(TD_CFG_AMPLIFIER_POLE_HZ, sqrt(hardware.pole_least_Hz * hardware.pole_most_Hz));
    number(TD_CFG_AMPLIFIER_COMMAND_LIMIT_A, hardware.command_A);
}

void configure(uint8_t how, int changes)
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
    if (how & 4)
        number(TD_CFG_PULSE_A, NEXT_TO_NOTHING_A);
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
        number(TD_CFG_AMPLIFIER_SCALE, (byte() & 1 ? -1 : 1) * 0.2 * pow(25, byte() / 255.0));
        number(TD_CFG_MONITOR_SCALE, (byte() & 1 ? -1 : 1) * 0.2 * pow(25, byte() / 255.0));
        /* A fifth of the limits goes with every scale. */
        if (byte() & 1) {
            number(TD_CFG_CURRENT_LIMIT_A, 0.19 * hardware.current_A);
            number(TD_CFG_AMPLIFIER_COMMAND_LIMIT_A, 0.19 * hardware.command_A);
        }
    }
    for (; changes > 0; changes--)
        number(byte() % TD_CFG_COUNT, odd());
    memcpy(body + 4, configuration, sizeof configuration);
    td_put_u32(body, 0);
    say(TD_KIND_CONFIGURE, body, sizeof body);
    td_sha256_of(configuration, sizeof configuration, configuration_sha256);
    say(TD_KIND_CONFIGURE_COMMIT, configuration_sha256, TD_HASH_BYTES);
}

void upload(uint8_t how, int changes)
{
    const uint32_t speeds = how & 1 ? 2 : 1, grips = how & 2 ? 2 : 1, samples = 20 + 4 * (uint32_t)byte(), nodes = speeds * grips;
    const uint8_t size = byte(), shape = byte();
    const uint32_t cool_bits = how & 32 ? 8 : (how & 64 ? 16 : 0), full = cool_bits == 8 ? 127 : 32767;
    /* What stands for long keeps the current limit, a single sample may be as large as the command's. */
    const double most_A = shape & 64 || hardware.current_A > hardware.command_A ? hardware.command_A : hardware.current_A;
    const double scale_A = most_A / 32767 * (size & 1 ? 1 : pow(10, -size / 32.0));
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
    td_put_u32(image + TD_IMAGE_COOL_BITS, cool_bits);
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
    for (j = 0; cool_bits != 0 && j < nodes; j++, at += 8)
        td_put_f64(at, how & 128 ? odd() : scale_A * 32767 / full * (j + 1) / nodes);
    for (k = 0; k < nodes; k++) {
        for (j = 0; j < samples; j++, at += 2) {
            const uint32_t period = 1 + (shape & 31u);
            const bool on = j + 2 < samples && (!(shape & 64) || j % (4 * period) < period);
            const int16_t count = !on ? 0 : (j / period & 1 && !(shape & 128) ? -32767 : 32767);

            td_put_u16(at, (uint16_t)count);
        }
    }
    /* The cool commands last longer at a time, at the size of their scales. */
    for (k = 0; cool_bits != 0 && k < nodes; k++) {
        for (j = 0; j < samples; j++, at += cool_bits / 8) {
            const uint32_t count = j + 2 >= samples ? 0 : (j & 32u ? 0 - full : full);

            if (cool_bits == 8)
                *at = (uint8_t)count;
            else
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

static void ask_arm(uint8_t trial, double gain)
{
    uint8_t body[TD_ARM_BYTES];

    body[TD_ARM_TRIAL] = trial;
    td_put_u16(body + TD_ARM_LEASE_MS, 1000);
    td_put_f64(body + TD_ARM_GAIN, gain);
    memcpy(body + TD_ARM_CONFIGURATION_SHA256, configuration_sha256, TD_HASH_BYTES);
    memcpy(body + TD_ARM_LIBRARY_SHA256, image_sha256, TD_HASH_BYTES);
    say(TD_KIND_ARM, body, sizeof body);
}

void arm(void)
{
    const uint8_t how = byte();

    ask_arm(how & 1, how & 2 ? odd() : (how & 1 ? 0.1 : 1));
}

void arm_trial(void)
{
    ask_arm(1, 0.1);
}

void pulse(void)
{
    const uint8_t how = byte();
    const double size_A = how & 8 ? NEXT_TO_NOTHING_A : 0.05;
    static const uint8_t some[] = {0, 1, 3, 15};
    uint8_t body[TD_PULSE_BYTES];

    td_put_f64(body + TD_PULSE_CURRENT_A, how & 1 ? odd() : (how & 2 ? -size_A : size_A));
    td_put_u16(body + TD_PULSE_TICKS, how & 4 ? (uint16_t)word() : 20);
    body[TD_PULSE_PAIRS] = some[how >> 4 & 3];
    say(TD_KIND_PULSE, body, sizeof body);
}

void one_number(uint8_t kind)
{
    uint8_t body[8];

    td_put_f64(body, kind == TD_KIND_GAIN && (byte() & 1) ? 1 : odd());
    say(kind, body, sizeof body);
}

void lease(void)
{
    static uint64_t host_us;
    uint8_t body[TD_LEASE_BYTES];

    td_put_u64(body + TD_LEASE_HOST_US, ++host_us);
    say(TD_KIND_LEASE, body, sizeof body);
}

void anything(void)
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
