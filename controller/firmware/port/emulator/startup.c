/* A bare Cortex-M for QEMU's MPS2 boards: vectors, floating-point unit, then newlib's start, whose files, arguments
 * and exit code go over semihosting. Not for silicon. */
#include <stdint.h>

#define CPACR (*(volatile uint32_t *)0xe000ed88u) /* coprocessors: the floating-point unit's are 10 and 11 */
#define FPU_ON (15u << 20)

extern uint32_t td_stack_top[]; /* of the linker's script */
extern void _start(void);
void td_reset(void);
void td_trap(void);

void td_reset(void)
{
    CPACR |= FPU_ON;
    __asm volatile("dsb\n\tisb");
    _start();
}

/* Whatever the processor complains about ends the run with a code that is no success. */
void td_trap(void)
{
    register uint32_t operation __asm("r0") = 0x18;    /* SYS_EXIT */
    register uint32_t reason __asm("r1") = 0x20023;    /* ADP_Stopped_RunTimeErrorUnknown */

    for (;;)
        __asm volatile("bkpt 0xab" : : "r"(operation), "r"(reason) : "memory");
}

/* The stack, then reset and what traps; no interrupts. */
__attribute__((section(".vectors"), used)) static const struct {
    uint32_t *stack;
    void (*handlers[15])(void);
} vectors = {
    td_stack_top,
    {td_reset, td_trap, td_trap, td_trap, td_trap, td_trap, 0, 0, 0, 0, td_trap, td_trap, 0, td_trap, td_trap},
};
