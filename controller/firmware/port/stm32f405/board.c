/* An STM32F405 with a crystal, at 168 MHz: the functions of board.h in registers of RM0090. No silicon has run it yet.
 *
 *     PA15, PB3   encoder A, B (TIM2)               PC0  current monitor
 *     PA9, PA10   serial port out, in (USART1)      PC1  grip sensor
 *     PA4         command (DAC 1)                   PC2  accelerometer
 *     PB13        enable of the amplifier, high: on; wants 10 kOhm to ground for the time of booting
 *     PB14        alive: changes every tick, for a retriggerable monostable of 10 servo periods (1 ms) in the enable's line
 *     PB12        emergency stop: contact to ground, opens when pressed
 *
 * TIM4 starts the three conversions, and their end is the tick: nothing waits for a converter, and readings are 6 us old.
 */
#include "../board.h"
#include "../hardware.h"
#include "registers.h"

#if !COMMAND_BY_DAC || CONVERTER_BITS != 12
#error "this board has converters of 12 bits for command and inputs: converter.output = \"dac\", bits = 12 in the circuit file"
#endif

#define CRYSTAL_MHZ 8u
#define PLL_M (CRYSTAL_MHZ / 2u)
#define PLL_N 168u
#define PLL_P 2u
#define PLL_Q 7u
#define BAUD 4000000u /* telemetry of every tick is 340 kB/s */
#define PROCESSOR_HZ 168000000u
#define TIMER_HZ 84000000u
#define RX_BYTES ((TD_UPLOAD_FRAMES + 1) * TD_FRAME_LIMIT) /* all that may come while the loop checks a library */
#define PIN_ENABLE 13u
#define PIN_ALIVE 14u
#define PIN_STOP 12u
#define CHANNEL_CURRENT 10u
#define CHANNEL_GRIP 11u
#define CHANNEL_ACCELERATION 12u
#define STREAM_IN 2u
#define STREAM_OUT 7u
#define COUNTER ((volatile uint32_t *)0x080e0000u) /* the last sector, which the linker leaves free */
#define COUNTER_SECTOR 11u
#define COUNTER_WORDS 32768u
#define BLANK 0xffffffffu

static uint8_t coming[RX_BYTES], leaving[512];
static size_t taken; /* of the ring, by board_receive */

void ADC_IRQHandler(void);

static void set_mode(uint32_t port, uint32_t pin, uint32_t mode)
{
    GPIO_MODER(port) = (GPIO_MODER(port) & ~(3u << (2u * pin))) | mode << (2u * pin);
}

static void set_function(uint32_t port, uint32_t pin, uint32_t function)
{
    const uint32_t shift = 4u * (pin % 8u);

    GPIO_AFR(port, pin) = (GPIO_AFR(port, pin) & ~(15u << shift)) | function << shift;
    set_mode(port, pin, GPIO_OTHER);
}

/* Below 2.7 V neither the flash keeps up with the processor nor do the converters mean what they say. The detector needs
 * no option bytes, which a brown-out reset would; its interrupt is above the tick's. */
static void start_supply_watch(void)
{
    PWR_CR |= PWR_CR_PLS_2_7_V | PWR_CR_PVDE;
    while (PWR_CSR & PWR_CSR_PVDO)
        continue;
    EXTI_RTSR |= EXTI_PVD;
    EXTI_IMR |= EXTI_PVD;
    NVIC_ISER(IRQ_PVD) = 1u << IRQ_PVD;
}

/* Without its crystal the processor has no time that is good for anything: it stays here, outputs safe. One that stops
 * later is a non-maskable interrupt, and so a trap. */
static void start_clocks(void)
{
    _Static_assert(1000000u * CRYSTAL_MHZ / PLL_M * PLL_N / PLL_P == PROCESSOR_HZ, "CRYSTAL_MHZ: even, 2 to 26");
    FLASH_ACR = FLASH_ACR_FAST;
    RCC_CR |= RCC_CR_HSEON;
    while (!(RCC_CR & RCC_CR_HSERDY))
        continue;
    RCC_PLLCFGR = PLL_M | PLL_N << 6 | (PLL_P / 2u - 1u) << 16 | RCC_PLLCFGR_HSE | PLL_Q << 24;
    RCC_CR |= RCC_CR_PLLON;
    while (!(RCC_CR & RCC_CR_PLLRDY))
        continue;
    RCC_CFGR = RCC_CFGR_PPRE1_4 | RCC_CFGR_PPRE2_2 | RCC_CFGR_SW_PLL;
    while ((RCC_CFGR & RCC_CFGR_SWS) != RCC_CFGR_SWS_PLL)
        continue;
    RCC_CR |= RCC_CR_CSSON;
}

/* The level before the direction. */
static void start_outputs(void)
{
    RCC_AHB1ENR |= RCC_AHB1ENR_GPIOA | RCC_AHB1ENR_GPIOB | RCC_AHB1ENR_GPIOC | RCC_AHB1ENR_DMA2;
    RCC_APB1ENR |= RCC_APB1ENR_TIM2 | RCC_APB1ENR_TIM4 | RCC_APB1ENR_TIM5 | RCC_APB1ENR_PWR | RCC_APB1ENR_DAC;
    RCC_APB2ENR |= RCC_APB2ENR_USART1 | RCC_APB2ENR_ADC1;
    (void)RCC_APB2ENR; /* a register's clock is on two of its periods later */
    GPIO_BSRR(GPIOB) = 1u << (PIN_ENABLE + 16u);
    set_mode(GPIOB, PIN_ENABLE, GPIO_OUTPUT);
    set_mode(GPIOB, PIN_ALIVE, GPIO_OUTPUT);
    DAC_DHR12R1 = (uint32_t)OUTPUT_ZERO;
    set_mode(GPIOA, 4u, GPIO_ANALOGUE);
    DAC_CR = DAC_CR_EN1;
}

/* TIM4 counts 16 bits: periods above 0.78 ms are divided before it. What is written comes into force by the update, which
 * starts no conversion as long as the converter does not listen to it. */
static void set_period(void)
{
    const uint32_t counts = (uint32_t)(HARDWARE.dt_s * TIMER_HZ + 0.5), divider = (counts - 1u) / 65536u + 1u;

    TIM_PSC(TIM4) = divider - 1u;
    TIM_ARR(TIM4) = (counts + divider / 2u) / divider - 1u;
    TIM_EGR(TIM4) = TIM_EGR_UG;
}

static void start_inputs(void)
{
    GPIO_PUPDR(GPIOB) = (GPIO_PUPDR(GPIOB) & ~(3u << (2u * PIN_STOP))) | 1u << (2u * PIN_STOP);
    set_mode(GPIOB, PIN_STOP, GPIO_INPUT);
    set_function(GPIOA, 15u, 1u);
    set_function(GPIOB, 3u, 1u);
    TIM_CCMR1(TIM2) = TIM_CCMR1_INPUTS;
    TIM_SMCR(TIM2) = TIM_SMCR_ENCODER_3;
    TIM_ARR(TIM2) = BLANK;
    TIM_CR1(TIM2) = TIM_CR1_CEN;
    set_period();
    set_mode(GPIOC, 0u, GPIO_ANALOGUE);
    set_mode(GPIOC, 1u, GPIO_ANALOGUE);
    set_mode(GPIOC, 2u, GPIO_ANALOGUE);
    ADC_CCR = ADC_CCR_BY_4;
    ADC1_SMPR1 = ADC_SMPR1_28_CYCLES(CHANNEL_CURRENT) | ADC_SMPR1_28_CYCLES(CHANNEL_GRIP) |
                 ADC_SMPR1_28_CYCLES(CHANNEL_ACCELERATION);
    ADC1_JSQR = ADC_JSQR_THREE(CHANNEL_CURRENT, CHANNEL_GRIP, CHANNEL_ACCELERATION); /* BOARD_CURRENT and so on */
    ADC1_CR1 = ADC_CR1_SCAN | ADC_CR1_JEOCIE;
    ADC1_CR2 = ADC_CR2_ADON | ADC_CR2_JEXTSEL_TIM4 | ADC_CR2_JEXTEN_RISING;
}

/* Bytes come and go by DMA: at 4 Mbaud ten of them come while the longest tick keeps everything else out of the way. */
static void start_serial(void)
{
    const uint32_t eighths = TIMER_HZ / BAUD; /* of a period, with 8 samples of a bit */

    _Static_assert(TIMER_HZ % BAUD == 0, "BAUD: no divider of 84 MHz gives it exactly");
    GPIO_OSPEEDR(GPIOA) |= 2u << (2u * 9u); /* edges for 4 Mbaud */
    set_function(GPIOA, 9u, 7u);
    set_function(GPIOA, 10u, 7u);
    USART_BRR(USART1) = (eighths / 8u) << 4 | eighths % 8u;
    USART_CR3(USART1) = USART_CR3_DMA;
    USART_CR1(USART1) = USART_CR1_OVER8 | USART_CR1_UE | USART_CR1_TE | USART_CR1_RE;
    DMA2_SPAR(STREAM_IN) = (uint32_t)&USART_DR(USART1);
    DMA2_SM0AR(STREAM_IN) = (uint32_t)coming;
    DMA2_SNDTR(STREAM_IN) = RX_BYTES;
    DMA2_SCR(STREAM_IN) = DMA_SCR_CHANNEL_4 | DMA_SCR_MEMORY_GROWS | DMA_SCR_CIRCULAR | DMA_SCR_EN;
    DMA2_SPAR(STREAM_OUT) = (uint32_t)&USART_DR(USART1);
    DMA2_SM0AR(STREAM_OUT) = (uint32_t)leaving;
}

void board_start(void)
{
    start_outputs();
    start_supply_watch();
    start_clocks();
    TIM_ARR(TIM5) = BLANK;
    TIM_CR1(TIM5) = TIM_CR1_CEN;
    PWR_CR |= PWR_CR_DBP;
    start_inputs();
    start_serial();
}

static void flash_wait(void)
{
    while (FLASH_SR & FLASH_SR_BSY)
        continue;
}

/* The sector holds the numbers of all starts one behind the other; full it is erased, which takes two seconds. */
uint32_t board_next_boot(void)
{
    uint32_t used = 0, next;

    while (used < COUNTER_WORDS && COUNTER[used] != BLANK)
        used++;
    next = used > 0 ? COUNTER[used - 1] + 1u : 1u;
    next = next == BLANK ? 1u : next;
    FLASH_KEYR = 0x45670123u;
    FLASH_KEYR = 0xcdef89abu;
    FLASH_SR = FLASH_SR_ERRORS; /* writing ones clears them */
    if (used == COUNTER_WORDS) {
        FLASH_CR = FLASH_CR_WORDS | FLASH_CR_SER | FLASH_CR_SECTOR(COUNTER_SECTOR);
        FLASH_CR |= FLASH_CR_STRT;
        flash_wait();
        used = 0;
    }
    FLASH_CR = FLASH_CR_WORDS | FLASH_CR_PG;
    COUNTER[used] = next;
    flash_wait();
    FLASH_CR = FLASH_CR_LOCK;
    return next;
}

void board_start_ticks(void)
{
    IWDG_KR = IWDG_KR_START;
    IWDG_KR = IWDG_KR_UNLOCK;
    IWDG_PR = 0;
    IWDG_RLR = 400; /* of 4 periods of the oscillator: 34 to 94 ms */
    NVIC_IPR(IRQ_ADC) = TICK_PRIORITY;
    NVIC_ISER(IRQ_ADC) = 1u << (IRQ_ADC % 32u);
    TIM_CR2(TIM4) = TIM_CR2_MMS_UPDATE;
    TIM_CR1(TIM4) = TIM_CR1_CEN;
}

void ADC_IRQHandler(void)
{
    ADC1_SR = ~ADC_SR_JEOC;
    port_tick();
}

/* The processor's own counter stands still while it sleeps; a timer's clock does not. */
uint32_t board_cycles(void)
{
    return TIM_CNT(TIM5);
}

uint32_t board_period_cycles(void)
{
    return (uint32_t)(HARDWARE.dt_s * TIMER_HZ + 0.5);
}

void board_alive(bool level)
{
    IWDG_KR = IWDG_KR_FEED;
    GPIO_BSRR(GPIOB) = 1u << (PIN_ALIVE + (level ? 0u : 16u));
}

int32_t board_encoder(void)
{
    return (int32_t)TIM_CNT(TIM2);
}

uint32_t board_converted(int input)
{
    return ADC1_JDR((uint32_t)input);
}

bool board_stop_pressed(void)
{
    return (GPIO_IDR(GPIOB) >> PIN_STOP & 1u) != 0;
}

void board_put(uint32_t counts, bool enabled)
{
    if (!enabled)
        GPIO_BSRR(GPIOB) = 1u << (PIN_ENABLE + 16u);
    DAC_DHR12R1 = counts;
    if (enabled)
        GPIO_BSRR(GPIOB) = 1u << PIN_ENABLE;
}

void board_hold(bool held)
{
    set_basepri(held ? TICK_PRIORITY : 0u);
}

void board_wait(void)
{
    __asm volatile("wfi");
}

size_t board_receive(uint8_t *bytes, size_t room)
{
    const size_t end = (RX_BYTES - DMA2_SNDTR(STREAM_IN)) % RX_BYTES;
    size_t size = 0;

    __asm volatile("dmb" : : : "memory"); /* what has come is read after the counter that says so */
    while (size < room && taken != end) {
        bytes[size++] = coming[taken++];
        taken = taken < RX_BYTES ? taken : 0;
    }
    return size;
}

size_t board_send(const uint8_t *bytes, size_t size)
{
    if (size == 0 || (DMA2_SCR(STREAM_OUT) & DMA_SCR_EN))
        return 0;
    size = size < sizeof leaving ? size : sizeof leaving;
    memcpy(leaving, bytes, size);
    DMA2_HIFCR = DMA2_HIFCR_7;
    DMA2_SNDTR(STREAM_OUT) = (uint32_t)size;
    __asm volatile("dsb" : : : "memory"); /* what is sent is in memory before it is sent */
    DMA2_SCR(STREAM_OUT) = DMA_SCR_CHANNEL_4 | DMA_SCR_MEMORY_GROWS | DMA_SCR_OUT | DMA_SCR_EN;
    return size;
}

volatile uint32_t *board_kept(void)
{
    return RTC_BKPR;
}
