/* A port without its registers: every function of board.h, what it has to do and what it may take. Copy it beside
 * stm32f405/board.c and fill it in from the bottom up in the order of board.h; as it stands every sensor is dead, no
 * current is ever put out, and a host that connects is told so.
 *
 * Budgets are cycles of the processor that has 16800 of them in a servo period; on another clock take the microseconds.
 * The functions of the tick take 400 cycles (2.4 us) together at most.
 */
#include "board.h"

/* Any time. First the enable's pin low, its level before its direction, and the converter at no current; then clocks.
 * Where a crystal or a supply does not come up: stay here. */
void board_start(void)
{
}

/* 2 s. From flash, EEPROM, or anything that outlives a loss of power; a number that was there before looks to the host as
 * if the device had never been off. */
uint32_t board_next_boot(void)
{
    return 1;
}

/* Any time. A timer that calls port_tick every HARDWARE.dt_s at the highest priority, jitter below 1 us; best is one that
 * starts the converters, whose end is the tick. The watchdog: 100 ms at most. */
void board_start_ticks(void)
{
}

/* 10 cycles (0.06 us). */
uint32_t board_cycles(void)
{
    return 0;
}

/* 10 cycles (0.06 us). */
uint32_t board_period_cycles(void)
{
    return 16800;
}

/* 40 cycles (0.25 us). */
void board_alive(bool level)
{
    (void)level;
}

/* 20 cycles (0.12 us): a counter in hardware; interrupts of every edge are 16000 a second at 0.4 m/s. */
int32_t board_encoder(void)
{
    return 0;
}

/* 20 cycles (0.12 us) each of three: what has been converted already. Waiting for a converter is a microsecond each. */
uint32_t board_converted(int input)
{
    (void)input;
    return 0; /* the rail: no number, which is a fault */
}

/* 10 cycles (0.06 us). */
bool board_stop_pressed(void)
{
    return true;
}

/* 60 cycles (0.36 us), where the converter is in the processor; one on SPI at 20 MHz takes 0.9 us for its 16 bits: let
 * DMA send them. What it takes is delay of the amplifier to the design. */
void board_put(uint32_t counts, bool enabled)
{
    (void)counts;
    (void)enabled;
}

/* 10 cycles (0.06 us). Mask the tick's interrupt, do not drop it; barriers, so that it is out from the next line on. */
void board_hold(bool held)
{
    (void)held;
}

/* One servo period: the processor's instruction that waits for an interrupt, or nothing. */
void board_wait(void)
{
}

/* 20 us for 512 bytes. By DMA or an interrupt into (TD_UPLOAD_FRAMES + 1) * TD_FRAME_LIMIT bytes. */
size_t board_receive(uint8_t *bytes, size_t room)
{
    (void)bytes;
    (void)room;
    return 0;
}

/* 20 us for 512 bytes. By DMA or an interrupt from a copy. */
size_t board_send(const uint8_t *bytes, size_t size)
{
    (void)bytes;
    (void)size;
    return 0;
}

/* 1 us. Registers on the battery; without one variables that the start does not set, which outlive a reset alone. */
volatile uint32_t *board_kept(void)
{
    static volatile uint32_t kept[BOARD_KEPT];

    return kept;
}
