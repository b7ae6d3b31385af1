/* The functions of board.h where QEMU 7.2's netduinoplus2 stands for the board: all that differs from a board is here.
 *
 * What the emulator has is used as it is: processor, SysTick, USART1 and USART2. What it lacks or does differently:
 *
 *     RCC, flash, DWT         read 0, and who waits for a clock waits for ever: nothing is set and nothing is awaited
 *     tick                    SysTick, since there is no trigger from a timer to a converter
 *     cycle counter           TIM5, which counts nanoseconds whatever its clock is set to, less what was waited for the host
 *     encoder, ADC, DAC, GPIO no encoder mode, a sawtooth, nothing, nothing: the stylus below is in their place
 *     DMA                     missing: bytes go one by one, those from the host by an interrupt each
 *     watchdog, backup        missing: the tick feeds nothing, and the coil was cold and is forgotten
 *     CCM                     missing, and 192 kB of SRAM in one piece: the linker puts the stack behind the first 128
 *     number of the start     what starts the emulator writes it to START
 *     time                    passes only while the host waits (`--port PORT,clock=PORT2`), in turns of five milliseconds
 *                             on USART3: what either has sent is there before a turn begins, however fast the emulator
 *
 * -icount shift=3 is 8 ns for an instruction, 1.3 cycles of the board.
 *
 * The stylus is the built-in device of transopt (controller/sim/default_device.py) on a level surface, integrated by the
 * semi-implicit Euler method in twelve steps a period, in the frame of the hand; the converters round what it does, and
 * add no noise. The hand does what its line, USART2, asks for, in the words in which transopt-play asks a person, so that
 * all that it prints may go there; and `please taps 0.2 0.3`, over and over while the amplifier is enabled.
 */
#include "../board.h"
#include "../hardware.h"
#include "registers.h"

#define START AT(0x2002fff0u) /* behind the stack; QEMU's -device loader puts it there */
#define RX_BYTES 16384u /* divides 2^16 */
#define PERIODS_PER_TURN ((uint32_t)(5e-3 / HARDWARE.dt_s + 0.5))
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
#define COLD_C 0x41c80000u /* 25 as a float */
#define HOME_M 20e-3f
#define TOUCH_S 0.3f
#define TAP_EVERY_S 0.1f /* after the one before, with the amplifier enabled */
#define HELD_N 3.0f
#define LOOSE_N 0.5f /* with which the stylus hangs in a hand that has let go */

void SysTick_Handler(void);
void USART1_IRQHandler(void);
void USART3_IRQHandler(void);

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
    bool stop, taps;
    float speeds_m_s[SPEEDS];
    int speed, speed_count;
    int idle_ticks; /* since the hand is at rest and the amplifier enabled */
} hand;

static struct {
    float command_A;
    bool enabled;
} amplifier;

static uint8_t coming[RX_BYTES];
static uint16_t taken;
static volatile uint16_t came, announced; /* bytes of the host, modulo 2^16 */
static volatile uint32_t gone; /* bytes to the host in this turn */
static volatile uint32_t turns; /* that the host has given */
static uint32_t waited; /* for them, as the cycle counter has it */
static volatile uint32_t periods; /* that have passed */
static volatile uint32_t kept[BOARD_KEPT];

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
}

/* One servo period; its acceleration. */
static float hand_advance(void)
{
    float before_m_s = hand.v_m_s, part;

    if (hand.first == hand.last) {
        hand.first = hand.last = 0;
        hand.v_m_s = 0;
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
    const float straight_s = (float)hand.z_m / speed_m_s + 0.015f, depth_m = speed_m_s * (0.03f + straight_s);

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

    go(-(float)hand.z_m);
    for (j = 0; j < 3; j++) {
        then(TOUCH_S, 0);
        go(3e-3f);
        go(-3e-3f);
    }
    then(TOUCH_S, 0);
    go(HOME_M);
}

/* The speeds [m/s] that these words name. */
static void take_speeds(const char *words)
{
    hand.speed_count = hand.speed = 0;
    while (*words != '\0' && hand.speed_count < SPEEDS) {
        float value = 0, place = 1;
        bool point = false, digits = false;

        while (*words == ' ')
            words++;
        for (; (*words >= '0' && *words <= '9') || *words == '.'; words++) {
            digits = true;
            point = point || *words == '.';
            if (*words != '.')
                value = 10 * value + (float)(*words - '0');
            if (*words != '.' && point)
                place *= 10;
        }
        if (!digits || !(value / place >= 0.05f && value / place <= 1.0f))
            return;
        hand.speeds_m_s[hand.speed_count++] = value / place;
    }
}

static bool begins(const char *line, const char *words)
{
    return strncmp(line, words, strlen(words)) == 0;
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
    if (begins(line, "press")) {
        hand.stop = true;
    } else if (begins(line, "release")) {
        hand.stop = false;
    } else if (begins(line, "let go")) {
        hand.grip_N = 0;
    } else if (begins(line, "hold") || begins(line, "put the weight")) {
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
        go(HOME_M - (float)hand.z_m);
    } else if (begins(line, "shake")) {
        for (j = 0; j < 9; j++)
            then(1.0f / 6.0f, j % 2 ? -0.06f : 0.06f);
        then(1.0f / 6.0f, 0);
    }
}

static void listen(void)
{
    static char line[LINE];
    static size_t size;

    while (USART_SR(USART2) & USART_SR_RXNE) {
        const char one = (char)USART_DR(USART2);

        if (one == '\r' || one == '\n') {
            line[size] = '\0';
            size = 0;
            obey(line);
        } else if (size + 1 < sizeof line) {
            line[size++] = one;
        }
    }
}

/* Told so it taps while the amplifier is enabled, at one speed after the other. */
static void tap_in_turn(void)
{
    const bool idle = hand.first == hand.last && amplifier.enabled && hand.speed_count > 0;

    hand.idle_ticks = idle ? hand.idle_ticks + 1 : 0;
    if (hand.idle_ticks < (int)(TAP_EVERY_S / DT_S))
        return;
    tap(hand.speeds_m_s[hand.speed]);
    hand.speed = (hand.speed + 1) % hand.speed_count;
}

/* ------------------------------------------------------------------------------------------------------ the period */

/* How many bytes the host has sent before the turn that it gives. */
void USART3_IRQHandler(void)
{
    static uint32_t low;
    static bool second;
    const uint32_t one = USART_DR(USART3);

    if (second) {
        announced += (uint16_t)(one << 8 | low);
        turns++;
    }
    low = one;
    second = !second;
}

/* Say how many bytes went out since the last; then the next turn, and all that the host sent before it. The period that
 * began then begins anew behind it. */
static void wait_for_turn(uint32_t began)
{
    static uint32_t had;

    SYST_CSR = 0;
    USART_DR(USART3) = gone & 0xffu;
    USART_DR(USART3) = gone >> 8 & 0xffu;
    gone = 0;
    __asm volatile("cpsid i"); /* so that what comes now is not taken before the processor sleeps, and wakes it */
    while (turns == had || (int16_t)(announced - came) > 0)
        __asm volatile("wfi\n\tcpsie i\n\tisb\n\tcpsid i" : : : "memory");
    __asm volatile("cpsie i");
    had++;
    waited += TIM_CNT(TIM5) - began;
    SYST_CVR = 0;
    ICSR = ICSR_PENDSTCLR;
    SYST_CSR = SYST_CSR_ON;
}

void SysTick_Handler(void)
{
    const uint32_t began = TIM_CNT(TIM5);
    const float before_A = amplifier.command_A;
    float carried_m_s2;
    int j;

    periods++;
    port_tick();
    tap_in_turn();
    carried_m_s2 = hand_advance();
    for (j = 0; j < EARLY; j++)
        chain_step(DELAY_S / EARLY, before_A, carried_m_s2);
    for (j = 0; j < LATE; j++)
        chain_step((DT_S - DELAY_S) / LATE, amplifier.command_A, carried_m_s2);
    if (periods % PERIODS_PER_TURN == 0)
        wait_for_turn(began);
}

static uint32_t counts_of(float value, const td_scale *scale)
{
    const float counts = value / scale->per_count + scale->zero_counts + 0.5f;

    return (uint32_t)(counts < 0.0f ? 0.0f : (counts > 4095.0f ? 4095.0f : counts));
}

void board_start(void)
{
    hand.z_m = (double)HOME_M;
    hand.grip_N = HELD_N;
    kept[0] = kept[1] = COLD_C;
    kept[2] = port_check_word(COLD_C, COLD_C);
    NVIC_IPR(IRQ_USART1) = 0; /* within the tick too */
    NVIC_ISER(IRQ_USART1) = 1u << (IRQ_USART1 % 32u);
    USART_CR1(USART1) = USART_CR1_UE | USART_CR1_TE | USART_CR1_RE | USART_CR1_RXNEIE;
    USART_CR1(USART2) = USART_CR1_UE | USART_CR1_RE;
    NVIC_IPR(IRQ_USART3) = 0;
    NVIC_ISER(IRQ_USART3) = 1u << (IRQ_USART3 % 32u);
    USART_CR1(USART3) = USART_CR1_UE | USART_CR1_TE | USART_CR1_RE | USART_CR1_RXNEIE;
    TIM_ARR(TIM5) = 0xffffffffu;
    TIM_CR1(TIM5) = TIM_CR1_CEN;
}

uint32_t board_next_boot(void)
{
    return START;
}

void board_start_ticks(void)
{
    SHPR3_SYSTICK = TICK_PRIORITY;
    SYST_RVR = (uint32_t)(HARDWARE.dt_s * 168e6 + 0.5) - 1u;
    SYST_CVR = 0;
    SYST_CSR = SYST_CSR_ON;
}

uint32_t board_cycles(void)
{
    return TIM_CNT(TIM5) - waited;
}

uint32_t board_period_cycles(void)
{
    return (uint32_t)(HARDWARE.dt_s * 1e9 + 0.5);
}

void board_alive(bool level)
{
    (void)level;
}

int32_t board_encoder(void)
{
    const double counts = (hand.z_m + (double)chain.u[0]) / COUNT_M;

    return (int32_t)(counts < 0 ? counts - 0.5 : counts + 0.5);
}

uint32_t board_converted(int input)
{
    if (input == BOARD_CURRENT)
        return counts_of(chain.current_A, &CURRENT_A);
    if (input == BOARD_GRIP)
        return counts_of(hand.grip_N, &GRIP_N);
    return counts_of(chain.felt_m_s2 + GRAVITY_M_S2, &ACCELERATION_M_S2);
}

bool board_stop_pressed(void)
{
    return hand.stop;
}

void board_put(uint32_t counts, bool enabled)
{
    amplifier.enabled = enabled;
    amplifier.command_A = enabled ? ((float)counts - OUTPUT_ZERO) / OUTPUT_PER_A : 0;
}

void board_hold(bool held)
{
    set_basepri(held ? TICK_PRIORITY : 0u);
}

void board_wait(void)
{
    const uint32_t before = periods;

    while (periods == before)
        continue;
}

size_t board_receive(uint8_t *bytes, size_t room)
{
    size_t size = 0;

    listen();
    while (size < room && taken != came)
        bytes[size++] = coming[taken++ % RX_BYTES];
    return size;
}

void USART1_IRQHandler(void)
{
    coming[came++ % RX_BYTES] = (uint8_t)USART_DR(USART1);
}

size_t board_send(const uint8_t *bytes, size_t size)
{
    size_t sent;

    for (sent = 0; sent < size; sent++)
        USART_DR(USART1) = bytes[sent];
    gone += (uint32_t)sent;
    return sent;
}

volatile uint32_t *board_kept(void)
{
    return kept;
}
