/* transopt on a bare processor: what every board has in common. Registers are in the board's own file, see board.h;
 * limits and scales in hardware.h.
 *
 * No silicon has run this yet. Bring a device up as docs/howto/road.md says, motor power off first.
 */
#include "board.h"
#include "hardware.h"

#define NOTHING_IS_WIRED false /* true: without a motor, arms without having seen a test pulse of its own */
#define SAFE_TICKS 1000 /* from the first tick until the amplifier may be enabled */
#define SAFE_COUNTS ((uint32_t)OUTPUT_ZERO)
#define LOOP_S 0.5 /* a loop that is away for longer hangs: the longest check of a library takes a tenth of it */

static td_device device; /* td_device_start sets every byte */
static uint64_t ticks;
static uint32_t tick_began;
static uint32_t loop_ticks;          /* of LOOP_S */
static volatile uint32_t away_ticks; /* since the loop last came by */

/* The command of this tick, from within td_device_step; the core has seen to its limits. */
static void put(void *context, td_real command_A, bool enabled)
{
    const float counts = OUTPUT_ZERO + (float)command_A * OUTPUT_PER_A;
    const bool powered = enabled && ticks > SAFE_TICKS;
    uint32_t powered_counts;

    (void)context;
    powered_counts = (uint32_t)(counts < 0.0f ? 0.0f : (counts > (float)OUTPUT_MOST ? (float)OUTPUT_MOST : counts + 0.5f));
    board_put(powered ? powered_counts : SAFE_COUNTS, powered);
}

static float value_of(const td_scale *scale, int which)
{
    const int counts = (int)board_converted(which);

    return counts < scale->least || counts > scale->most ? NAN : ((float)counts - scale->zero_counts) * scale->per_count;
}

/* The servo period. */
void port_tick(void)
{
    const uint32_t now = board_cycles(), period = board_period_cycles();
    td_readings readings;
    td_output output;

    /* The watchdog is to bite where either hangs: a tick that does not come feeds nothing, nor does one that comes alone. */
    if (away_ticks < loop_ticks) {
        away_ticks++;
        board_alive(ticks & 1);
    }
    /* A lost tick is a fault: where a current flows its command was held for too long, where none does a record has no
     * row for it, and all that is read thereafter is taken to be earlier than it was. */
    readings.late = ticks > 0 && now - tick_began > period + period / 2;
    readings.host_stop = false;
    tick_began = now;
    readings.tick = ticks++;
    readings.encoder_counts = board_encoder();
    readings.current_A = value_of(&CURRENT_A, BOARD_CURRENT);
#if HAS_GRIP
    readings.grip_N = value_of(&GRIP_N, BOARD_GRIP);
#else
    readings.grip_N = NAN;
#endif
    readings.acceleration_m_s2 = value_of(&ACCELERATION_M_S2, BOARD_ACCELERATION);
    readings.emergency_stop = board_stop_pressed();
    td_device_step(&device, &readings, &output);
}

static void hold(void *context, bool held)
{
    (void)context;
    board_hold(held);
}

/* The coil's temperature over a reset. */
static void keep_heat(void)
{
    volatile uint32_t *const kept = board_kept();
    double winding_C, housing_C;
    float parts_C[2];
    uint32_t words[2];

    td_device_coil(&device, &winding_C, &housing_C);
    parts_C[0] = (float)winding_C;
    parts_C[1] = (float)housing_C;
    memcpy(words, parts_C, sizeof words);
    kept[0] = words[0];
    kept[1] = words[1];
    kept[2] = port_check_word(words[0], words[1]);
}

/* NaN without a sound check word: then the coil is taken to be as hot as it may be. */
static void kept_heat(double *winding_C, double *housing_C)
{
    const volatile uint32_t *const kept = board_kept();
    const uint32_t words[2] = {kept[0], kept[1]};
    const bool sound = kept[2] == port_check_word(words[0], words[1]);
    float parts_C[2];

    memcpy(parts_C, words, sizeof parts_C);
    *winding_C = sound ? (double)parts_C[0] : (double)NAN;
    *housing_C = sound ? (double)parts_C[1] : (double)NAN;
}

int main(void)
{
    static uint8_t coming[512], leaving[512]; /* a short hold; not on the stack, where DMA may not reach */
    td_port port = {0, HARDWARE, NOTHING_IS_WIRED, (double)NAN, (double)NAN, hold, put, NULL};
    size_t size = 0, sent = 0;

    board_start();
    board_put(SAFE_COUNTS, false);
    port.boot = board_next_boot();
    kept_heat(&port.winding_C, &port.housing_C);
    /* A port and a core of different sizes do not link; if they did all the same, nothing runs. */
    while (TD_DEVICE_BYTES != sizeof device)
        continue;
    td_device_start(&device, &port);
    loop_ticks = (uint32_t)(LOOP_S / HARDWARE.dt_s);
    board_start_ticks();
    for (;;) {
        board_wait();
        away_ticks = 0;
        keep_heat();
        td_device_receive(&device, coming, board_receive(coming, sizeof coming));
        if (sent == size) {
            size = td_device_send(&device, leaving, sizeof leaving);
            sent = 0;
        }
        sent += board_send(leaving + sent, size - sent);
    }
}
