/* The functions of board.h where QEMU 7.2's netduinoplus2 stands for the board: all that differs from a board is here.
 *
 * What the emulator has is used as it is: processor, SysTick, USART1 and USART2. What it lacks or does differently:
 *
 *     RCC, flash, DWT         read 0, and who waits for a clock waits for ever: nothing is set and nothing is awaited
 *     tick                    SysTick, since there is no trigger from a timer to a converter
 *     cycle counter           TIM5, which counts nanoseconds whatever its clock is set to, less what was waited for the host
 *     encoder, ADC, DAC, GPIO no encoder mode, a sawtooth, nothing, nothing: stylus.c is in their place
 *     DMA                     missing: bytes go one by one, those from the host by an interrupt each
 *     watchdog, backup        missing: the tick feeds nothing, and the coil was cold and is forgotten
 *     CCM                     missing, and 192 kB of SRAM in one piece: the linker puts the stack behind the first 128
 *     hand                    what its line, USART2, asks of it
 *     number of the start     what starts the emulator writes it to START
 *     rate of the line        as fast as the loop sends; where the emulator's start wrote a rate to LINE_BAUD, no faster
 *     time                    passes only while the host waits (`--port PORT,clock=PORT2`), in turns of five milliseconds
 *                             on USART3: what either has sent is there before a turn begins, however fast the emulator
 *
 * -icount shift=3 is 8 ns for an instruction, 1.3 cycles of the board.
 */
#include "../board.h"
#include "../hardware.h"
#include "registers.h"
#include "stylus.h"

#if !COMMAND_BY_DAC || CONVERTER_BITS != 12
#error "this board has converters of 12 bits for command and inputs: converter.output = \"dac\", bits = 12 in the circuit file"
#endif

#define START AT(0x2002fff0u) /* behind the stack; QEMU's -device loader puts it there */
#define LINE_BAUD AT(0x2002fff4u) /* 0 without */
#define RX_BYTES 16384u /* divides 2^16 */
#define UART_BITS 10 /* for a byte */
#define DRIVER_BYTES 64 /* that a line which was silent takes at once */
#define PERIODS_PER_TURN ((uint32_t)(5e-3 / HARDWARE.dt_s + 0.5))
#define COLD_C 0x41c80000u /* 25 as a float */

void SysTick_Handler(void);
void USART1_IRQHandler(void);
void USART3_IRQHandler(void);

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

    periods++;
    port_tick();
    stylus_advance(before_A, amplifier.command_A, amplifier.enabled);
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
    stylus_start();
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
    return stylus_counts();
}

uint32_t board_converted(int input)
{
    if (input == BOARD_CURRENT)
        return counts_of(stylus_current_A(), &CURRENT_A);
#if HAS_GRIP
    if (input == BOARD_GRIP)
        return counts_of(stylus_grip_N(), &GRIP_N);
#endif
    return counts_of(stylus_acceleration_m_s2(), &ACCELERATION_M_S2);
}

bool board_stop_pressed(void)
{
    return stylus_stop_pressed();
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

    while (USART_SR(USART2) & USART_SR_RXNE)
        stylus_hear((char)USART_DR(USART2));
    while (size < room && taken != came)
        bytes[size++] = coming[taken++ % RX_BYTES];
    return size;
}

void USART1_IRQHandler(void)
{
    coming[came++ % RX_BYTES] = (uint8_t)USART_DR(USART1);
}

/* How many of `size` bytes the line takes now. */
static size_t line_room(size_t size)
{
    static uint32_t had;
    static float room;

    if (LINE_BAUD == 0)
        return size;
    room += (float)(periods - had) * (float)HARDWARE.dt_s * (float)LINE_BAUD / UART_BITS;
    had = periods;
    room = room < (float)DRIVER_BYTES ? room : (float)DRIVER_BYTES;
    size = (float)size < room ? size : (size_t)room;
    room -= (float)size;
    return size;
}

size_t board_send(const uint8_t *bytes, size_t size)
{
    const size_t room = line_room(size);
    size_t sent;

    for (sent = 0; sent < room; sent++)
        USART_DR(USART1) = bytes[sent];
    gone += (uint32_t)sent;
    return sent;
}

volatile uint32_t *board_kept(void)
{
    return kept;
}
