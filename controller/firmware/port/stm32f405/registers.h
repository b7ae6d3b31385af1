/* The registers of an STM32F405 that board.c uses, by the names and addresses of ST's reference manual RM0090; those of
 * the core by ARM's Cortex-M4 generic user guide. */
#ifndef REGISTERS_H
#define REGISTERS_H

#include <stdint.h>

#define AT(address) (*(volatile uint32_t *)(address))

/* RM0090 7.3: reset and clock control. */
#define RCC_CR AT(0x40023800u)
#define RCC_CR_HSEON (1u << 16)
#define RCC_CR_HSERDY (1u << 17)
#define RCC_CR_CSSON (1u << 19)
#define RCC_CR_PLLON (1u << 24)
#define RCC_CR_PLLRDY (1u << 25)
#define RCC_PLLCFGR AT(0x40023804u)
#define RCC_PLLCFGR_HSE (1u << 22)
#define RCC_CFGR AT(0x40023808u)
#define RCC_CFGR_SW_PLL 2u
#define RCC_CFGR_SWS (3u << 2)
#define RCC_CFGR_SWS_PLL (2u << 2)
#define RCC_CFGR_PPRE1_4 (5u << 10) /* APB1 42 MHz, its timers 84 MHz */
#define RCC_CFGR_PPRE2_2 (4u << 13) /* APB2 84 MHz */
#define RCC_AHB1ENR AT(0x40023830u)
#define RCC_AHB1ENR_GPIOA (1u << 0)
#define RCC_AHB1ENR_GPIOB (1u << 1)
#define RCC_AHB1ENR_GPIOC (1u << 2)
#define RCC_AHB1ENR_DMA2 (1u << 22)
#define RCC_APB1ENR AT(0x40023840u)
#define RCC_APB1ENR_TIM2 (1u << 0)
#define RCC_APB1ENR_TIM4 (1u << 2)
#define RCC_APB1ENR_TIM5 (1u << 3)
#define RCC_APB1ENR_USART2 (1u << 17)
#define RCC_APB1ENR_PWR (1u << 28)
#define RCC_APB1ENR_DAC (1u << 29)
#define RCC_APB2ENR AT(0x40023844u)
#define RCC_APB2ENR_USART1 (1u << 4)
#define RCC_APB2ENR_ADC1 (1u << 8)

/* RM0090 5.4: power; the detector of a low supply, and the bit that lets the backup registers be written. */
#define PWR_CR AT(0x40007000u)
#define PWR_CR_PVDE (1u << 4)
#define PWR_CR_PLS_2_7_V (5u << 5)
#define PWR_CR_DBP (1u << 8)
#define PWR_CSR AT(0x40007004u)
#define PWR_CSR_PVDO (1u << 2) /* the supply is below the level */

/* RM0090 12.3: lines of the external interrupts; the detector's is 16. */
#define EXTI_IMR AT(0x40013c00u)
#define EXTI_RTSR AT(0x40013c08u)
#define EXTI_PVD (1u << 16)

/* RM0090 3.9: flash interface. */
#define FLASH_ACR AT(0x40023c00u)
#define FLASH_ACR_FAST (5u | 7u << 8) /* 5 wait states; prefetch, instruction and data cache */
#define FLASH_KEYR AT(0x40023c04u)
#define FLASH_SR AT(0x40023c0cu)
#define FLASH_SR_BSY (1u << 16)
#define FLASH_SR_ERRORS 0xf2u
#define FLASH_CR AT(0x40023c10u)
#define FLASH_CR_PG (1u << 0)
#define FLASH_CR_SER (1u << 1)
#define FLASH_CR_SECTOR(n) ((n) << 3)
#define FLASH_CR_WORDS (2u << 8) /* 32 bits at once: 2.7 V and more */
#define FLASH_CR_STRT (1u << 16)
#define FLASH_CR_LOCK (1u << 31)

/* RM0090 8.4: pins. */
#define GPIOA 0x40020000u
#define GPIOB 0x40020400u
#define GPIOC 0x40020800u
#define GPIO_MODER(port) AT((port) + 0x00u)
#define GPIO_OSPEEDR(port) AT((port) + 0x08u)
#define GPIO_PUPDR(port) AT((port) + 0x0cu)
#define GPIO_IDR(port) AT((port) + 0x10u)
#define GPIO_BSRR(port) AT((port) + 0x18u)
#define GPIO_AFR(port, pin) AT((port) + 0x20u + 4u * ((pin) / 8u))
enum { GPIO_INPUT, GPIO_OUTPUT, GPIO_OTHER, GPIO_ANALOGUE };

/* RM0090 18.4: general-purpose timers; TIM2 and TIM5 count 32 bits. */
#define TIM2 0x40000000u
#define TIM4 0x40000800u
#define TIM5 0x40000c00u
#define TIM_CR1(timer) AT((timer) + 0x00u)
#define TIM_CR1_CEN (1u << 0)
#define TIM_CR2(timer) AT((timer) + 0x04u)
#define TIM_CR2_MMS_UPDATE (2u << 4) /* its update is what it triggers others with */
#define TIM_SMCR(timer) AT((timer) + 0x08u)
#define TIM_SMCR_ENCODER_3 3u /* all four edges */
#define TIM_EGR(timer) AT((timer) + 0x14u)
#define TIM_EGR_UG (1u << 0)
#define TIM_CCMR1(timer) AT((timer) + 0x18u)
#define TIM_CCMR1_INPUTS (0x0101u | 0x3030u) /* both channels are inputs, 8 samples of the timer's clock to agree on */
#define TIM_CNT(timer) AT((timer) + 0x24u)
#define TIM_PSC(timer) AT((timer) + 0x28u)
#define TIM_ARR(timer) AT((timer) + 0x2cu)

/* RM0090 13.13: converters in. */
#define ADC1_SR AT(0x40012000u)
#define ADC_SR_JEOC (1u << 2)
#define ADC1_CR1 AT(0x40012004u)
#define ADC_CR1_JEOCIE (1u << 7)
#define ADC_CR1_SCAN (1u << 8)
#define ADC1_CR2 AT(0x40012008u)
#define ADC_CR2_ADON (1u << 0)
#define ADC_CR2_JEXTSEL_TIM4 (9u << 16) /* TIM4's trigger starts the injected conversions */
#define ADC_CR2_JEXTEN_RISING (1u << 20)
#define ADC1_SMPR1 AT(0x4001200cu)
#define ADC_SMPR1_28_CYCLES(channel) (2u << (3u * ((channel) - 10u)))
#define ADC1_JSQR AT(0x40012038u)
#define ADC_JSQR_THREE(first, second, third) (2u << 20 | (third) << 15 | (second) << 10 | (first) << 5)
#define ADC1_JDR(number) AT(0x4001203cu + 4u * (number)) /* from 0 */
#define ADC_CCR AT(0x40012304u)
#define ADC_CCR_BY_4 (1u << 16) /* 21 MHz */

/* RM0090 14.5: converter out. */
#define DAC_CR AT(0x40007400u)
#define DAC_CR_EN1 (1u << 0)
#define DAC_DHR12R1 AT(0x40007408u)

/* RM0090 30.6: serial ports. */
#define USART1 0x40011000u
#define USART2 0x40004400u
#define USART3 0x40004800u
#define USART_SR(port) AT((port) + 0x00u)
#define USART_SR_RXNE (1u << 5)
#define USART_SR_TXE (1u << 7)
#define USART_DR(port) AT((port) + 0x04u)
#define USART_BRR(port) AT((port) + 0x08u)
#define USART_CR1(port) AT((port) + 0x0cu)
#define USART_CR1_RE (1u << 2)
#define USART_CR1_TE (1u << 3)
#define USART_CR1_RXNEIE (1u << 5)
#define USART_CR1_UE (1u << 13)
#define USART_CR1_OVER8 (1u << 15)
#define USART_CR3(port) AT((port) + 0x14u)
#define USART_CR3_DMA (3u << 6) /* both ways */

/* RM0090 10.5: DMA2, whose streams 2 and 7 serve USART1 on channel 4; it does not reach the CCM. */
#define DMA2_LIFCR AT(0x40026408u)
#define DMA2_HIFCR AT(0x4002640cu)
#define DMA2_HIFCR_7 (0x3du << 22)
#define DMA2_SCR(stream) AT(0x40026410u + 0x18u * (stream))
#define DMA_SCR_EN (1u << 0)
#define DMA_SCR_OUT (1u << 6)
#define DMA_SCR_CIRCULAR (1u << 8)
#define DMA_SCR_MEMORY_GROWS (1u << 10)
#define DMA_SCR_CHANNEL_4 (4u << 25)
#define DMA2_SNDTR(stream) AT(0x40026414u + 0x18u * (stream))
#define DMA2_SPAR(stream) AT(0x40026418u + 0x18u * (stream))
#define DMA2_SM0AR(stream) AT(0x4002641cu + 0x18u * (stream))

/* RM0090 21.4: independent watchdog, by its own oscillator of 17 to 47 kHz. */
#define IWDG_KR AT(0x40003000u)
#define IWDG_KR_UNLOCK 0x5555u
#define IWDG_KR_FEED 0xaaaau
#define IWDG_KR_START 0xccccu
#define IWDG_PR AT(0x40003004u)
#define IWDG_RLR AT(0x40003008u)

/* RM0090 26.6: the backup registers of the real-time clock, on the battery. */
#define RTC_BKPR ((volatile uint32_t *)0x40002850u)

/* The core. */
#define NVIC_ISER(number) AT(0xe000e100u + 4u * ((number) / 32u))
#define NVIC_IPR(number) (*(volatile uint8_t *)(0xe000e400u + (number)))
#define SYST_CSR AT(0xe000e010u)
#define SYST_CSR_ON 7u /* counts the processor's clock, and interrupts */
#define SYST_RVR AT(0xe000e014u)
#define SYST_CVR AT(0xe000e018u)
#define ICSR AT(0xe000ed04u)
#define ICSR_PENDSTCLR (1u << 25) /* SysTick's tick that waits */
#define AIRCR AT(0xe000ed0cu)
#define AIRCR_SYSRESETREQ 0x05fa0004u /* with the key that a write wants */
#define SHPR3_SYSTICK (*(volatile uint8_t *)0xe000ed23u)
#define CPACR AT(0xe000ed88u)
#define CPACR_FPU_ON (15u << 20)

#define IRQ_PVD 1u
#define IRQ_ADC 18u
#define IRQ_USART1 37u
#define IRQ_USART3 39u
#define TICK_PRIORITY 0x40u /* of four bits, the upper ones of the byte; what hold() keeps out */

/* Keep interrupts of this priority and below out, from the next instruction on; 0: none. */
static inline void set_basepri(uint32_t priority)
{
    __asm volatile("msr basepri, %0\n\tdsb\n\tisb" : : "r"(priority) : "memory");
}

#endif
