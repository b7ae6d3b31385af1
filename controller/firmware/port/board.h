/* What a board has to do for the device: one file fills in these functions, port/main.c calls them, nothing else is
 * needed. port_template.c has each with its budget and without its registers; stm32f405/board.c is a whole one.
 *
 * Cycles are those of a Cortex-M4F at 168 MHz, which has 16800 of them in a period of 0.1 ms. The longest tick of the
 * core takes nearly all of them, the mean one a third (docs/results/firmware.md): what the functions of the tick take
 * together makes the tick behind the longest one late by so much, and a tick is too late from half a period on.
 */
#ifndef BOARD_H
#define BOARD_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

enum { BOARD_CURRENT, BOARD_GRIP, BOARD_ACCELERATION, BOARD_INPUTS };
enum { BOARD_KEPT = 3 }; /* words that are still there after a reset */

/* ---- once, at the start ---- */

/* The outputs first, safe before anything else; then clocks, converters, encoder, serial port. No tick comes yet. */
void board_start(void);

/* Another number at every start. */
uint32_t board_next_boot(void);

/* From here on port_tick is called once per servo period, at a priority above everything else, and the watchdog runs. */
void board_start_ticks(void);

/* ---- in the tick ---- */

/* A counter that goes up through all 32 bits (SysTick has 24 and goes down: every turn of it would be a late tick) and never
 * stops, not while the processor sleeps in board_wait either, and how much it counts in one servo period. */
uint32_t board_cycles(void);
uint32_t board_period_cycles(void);

/* Feed the watchdog, and give the monostable in the enable's line its edge. Not called once the loop has been away for
 * half a second: the amplifier then loses its enable, and the watchdog starts everything anew. */
void board_alive(bool level);

/* What the encoder has counted since the start, all four edges. */
int32_t board_encoder(void);

/* The newest conversion of an input, 12 bits, at most one servo period old. */
uint32_t board_converted(int input);

/* A pressed emergency stop, or its broken wire. */
bool board_stop_pressed(void);

/* The command, 12 bits, and whether the amplifier may be on: enabled last where it is, first where it is not. */
void board_put(uint32_t counts, bool enabled);

/* ---- in the loop, which the tick interrupts ---- */

/* Keep the tick out, and let it in again; one that came meanwhile is made up for. In force from the next instruction. */
void board_hold(bool held);

/* Until there may be something to do: for a tick at most, or not at all. */
void board_wait(void);

/* Bytes that have come from the host, at most `room`, and how many; and as many of these as the line takes now. Neither
 * waits. Nothing may be lost while the loop is away for 50 ms: the check of the largest library takes 28 ms of an M4F at
 * 168 MHz, 42 ms with the ticks that interrupt it. They never wait for long: a loop that is away for half a second counts
 * as hanging. */
size_t board_receive(uint8_t *bytes, size_t room);
size_t board_send(const uint8_t *bytes, size_t size);

/* The words that a reset leaves alone, a loss of power too if there is a battery; anything at first. */
volatile uint32_t *board_kept(void);

/* ---- of main.c ---- */

/* One servo period; the board calls it. */
void port_tick(void);

/* The last of the kept words, by which two temperatures are told from what lies in a memory that had no power. */
static inline uint32_t port_check_word(uint32_t winding, uint32_t housing)
{
    return winding ^ (housing << 7 | housing >> 25) ^ 0x74656d70u;
}

#endif
