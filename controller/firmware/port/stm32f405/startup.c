/* From reset to main: the floating-point unit, variables, the vectors of an STM32F405 (RM0090 12.2). */
#include <stdint.h>

#include "registers.h"

/* Of the linker's script. */
extern uint32_t td_stack_top[], td_data_begin[], td_data_end[], td_bss_begin[], td_bss_end[];
extern const uint32_t td_data_stored[];

int main(void);
void td_reset(void);
void td_trap(void);
void ADC_IRQHandler(void) __attribute__((weak, alias("td_trap")));
void USART1_IRQHandler(void) __attribute__((weak, alias("td_trap")));
void USART3_IRQHandler(void) __attribute__((weak, alias("td_trap")));
void SysTick_Handler(void) __attribute__((weak, alias("td_trap")));

void td_reset(void)
{
    const uint32_t *from = td_data_stored;
    uint32_t *to;

    CPACR |= CPACR_FPU_ON;
    __asm volatile("dsb\n\tisb");
    for (to = td_data_begin; to < td_data_end; to++)
        *to = *from++;
    for (to = td_bss_begin; to < td_bss_end; to++)
        *to = 0;
    main();
    td_trap();
}

/* What the processor complains about, a crystal that stops, a supply that falls, and what nobody has asked for: a reset, by
 * which all pins let go and the enable falls at once. It wants no watchdog, which does not run before the first tick. */
void td_trap(void)
{
    __asm volatile("cpsid i\n\tdsb");
    AIRCR = AIRCR_SYSRESETREQ;
    for (;;)
        __asm volatile("dsb");
}

__attribute__((section(".vectors"), used)) static const struct {
    uint32_t *stack;
    void (*core[15])(void);
    void (*interrupts[82])(void);
} vectors = {
    td_stack_top,
    {td_reset, td_trap, td_trap, td_trap, td_trap, td_trap, 0, 0, 0, 0, td_trap, td_trap, 0, td_trap, SysTick_Handler},
    {[IRQ_PVD] = td_trap, [IRQ_ADC] = ADC_IRQHandler, [IRQ_USART1] = USART1_IRQHandler, [IRQ_USART3] = USART3_IRQHandler},
};
