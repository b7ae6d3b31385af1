/* Instructions from one call of the core to its return, for programs linked with --wrap of these names.
 *
 * Under `qemu -icount shift=0` one instruction takes one virtual nanosecond, so that SysTick, at the board's 25 MHz,
 * counts in steps of 40 of them: exact on average, by up to 40 off in a single call. Instructions, not cycles:
 * what caches, memory and the pipeline make of them only silicon tells.
 */
#include <stdio.h>

#include "td_device.h"

#define SYST_CSR (*(volatile uint32_t *)0xe000e010u)
#define SYST_RVR (*(volatile uint32_t *)0xe000e014u)
#define SYST_CVR (*(volatile uint32_t *)0xe000e018u)
#define SYST_ON 5u /* counts the processor's clock */
#define SYST_MOST 0xffffffu
#define PER_STEP 40u
#define STACK_WORDS 16384
#define PAINT 0x5ca1ab1eu

typedef struct {
    const char *name;
    uint32_t calls;
    uint64_t steps;
    uint32_t most; /* of one call */
} counter;

static counter servo = {"servo", 0, 0, 0}, device = {"device", 0, 0, 0}, receive = {"receive", 0, 0, 0},
               held = {"held", 0, 0, 0}, command = {"command", 0, 0, 0};
/* Of the device's tick: what its servo takes, and what the device adds to it until the command is out and until the end. */
static counter inner = {"inner", 0, 0, 0}, command_own = {"command_own", 0, 0, 0}, device_own = {"device_own", 0, 0, 0};
static uint32_t tick_since; /* when the device's tick began */
static uint32_t answer_steps, inner_steps; /* of the servo within it: until its answer, and both its halves */
static uint32_t empty_steps, empty_calls; /* of nothing, measured in the same way */

static uint32_t elapsed(uint32_t since)
{
    return (since - SYST_CVR) & SYST_MOST; /* it counts down */
}

static void add_steps(counter *to, uint32_t steps)
{
    to->calls++;
    to->steps += steps;
    if (steps > to->most)
        to->most = steps;
}

static void add(counter *to, uint32_t since)
{
    add_steps(to, elapsed(since));
}

void __real_td_servo_step(td_servo *to, const td_readings *readings, td_output *output);
void __wrap_td_servo_step(td_servo *to, const td_readings *readings, td_output *output);
void __real_td_servo_answer(td_servo *to, const td_readings *readings, td_output *output);
void __wrap_td_servo_answer(td_servo *to, const td_readings *readings, td_output *output);
void __real_td_servo_applied(td_servo *to, td_real command_A);
void __wrap_td_servo_applied(td_servo *to, td_real command_A);
void __real_td_device_step(td_device *to, const td_readings *readings, td_output *output);
void __wrap_td_device_step(td_device *to, const td_readings *readings, td_output *output);
void __real_td_device_receive(td_device *to, const uint8_t *bytes, size_t size);
void __wrap_td_device_receive(td_device *to, const uint8_t *bytes, size_t size);
void __real_td_device_begin(td_device *to, const td_port *port, const size_t *bytes);
void __wrap_td_device_begin(td_device *to, const td_port *port, const size_t *bytes);
int __real_main(int argc, char **argv);
int __wrap_main(int argc, char **argv);

void __wrap_td_servo_step(td_servo *to, const td_readings *readings, td_output *output)
{
    const uint32_t since = SYST_CVR;

    __real_td_servo_step(to, readings, output);
    add(&servo, since);
}

void __wrap_td_servo_answer(td_servo *to, const td_readings *readings, td_output *output)
{
    const uint32_t since = SYST_CVR;

    __real_td_servo_answer(to, readings, output);
    answer_steps = inner_steps = elapsed(since);
}

void __wrap_td_servo_applied(td_servo *to, td_real command_A)
{
    const uint32_t since = SYST_CVR;

    __real_td_servo_applied(to, command_A);
    inner_steps += elapsed(since);
}

void __wrap_td_device_step(td_device *to, const td_readings *readings, td_output *output)
{
    uint32_t steps;

    answer_steps = inner_steps = 0;
    tick_since = SYST_CVR;
    __real_td_device_step(to, readings, output);
    steps = elapsed(tick_since);
    add_steps(&device, steps);
    add_steps(&inner, inner_steps);
    add_steps(&device_own, steps > inner_steps ? steps - inner_steps : 0);
}

void __wrap_td_device_receive(td_device *to, const uint8_t *bytes, size_t size)
{
    const uint32_t since = SYST_CVR;

    __real_td_device_receive(to, bytes, size);
    if (size > 0)
        add(&receive, since);
}

/* For how long the device keeps the timer's interrupt out. */
static td_port watched;
static uint32_t held_since;

static void watch_hold(void *context, bool hold)
{
    if (!hold)
        add(&held, held_since);
    watched.hold(context, hold);
    if (hold)
        held_since = SYST_CVR;
}

/* How long after the tick's beginning the command goes out. */
static void watch_put(void *context, td_real command_A, bool enabled)
{
    const uint32_t steps = elapsed(tick_since);

    add_steps(&command, steps);
    add_steps(&command_own, steps > answer_steps ? steps - answer_steps : 0);
    if (watched.put != NULL)
        watched.put(context, command_A, enabled);
}

void __wrap_td_device_begin(td_device *to, const td_port *port, const size_t *bytes)
{
    td_port through = *port;

    watched = *port;
    through.hold = watch_hold;
    through.put = watch_put;
    __real_td_device_begin(to, &through, bytes);
}

/* The stack is painted before and looked at after. */
static uint32_t *paint(void)
{
    uint32_t *const top = (uint32_t *)__builtin_frame_address(0) - 64, *at;

    for (at = top - STACK_WORDS; at < top; at++)
        *(volatile uint32_t *)at = PAINT;
    return top;
}

static unsigned long painted_over(const uint32_t *top)
{
    const uint32_t *at = top - STACK_WORDS;

    while (at < top && *(const volatile uint32_t *)at == PAINT)
        at++;
    return (unsigned long)(top - at) * sizeof *at;
}

static void print(const counter *from)
{
    if (from->calls > 0)
        printf("%s %lu calls, %.1f instructions on average, %lu at most\n", from->name, (unsigned long)from->calls,
               (double)PER_STEP * ((double)from->steps / from->calls - (double)empty_steps / empty_calls),
               (unsigned long)(PER_STEP * from->most));
}

int __wrap_main(int argc, char **argv)
{
    uint32_t *const top = paint();
    int result;

    SYST_RVR = SYST_MOST;
    SYST_CVR = 0;
    SYST_CSR = SYST_ON;
    for (empty_calls = 0; empty_calls < 4096; empty_calls++) {
        const uint32_t since = SYST_CVR;

        empty_steps += elapsed(since);
    }
    result = __real_main(argc, argv);
    print(&servo);
    print(&device);
    print(&receive);
    print(&held);
    print(&command);
    print(&inner);
    print(&command_own);
    print(&device_own);
    printf("stack %lu bytes\n", painted_over(top));
    printf("device %lu bytes\n", (unsigned long)sizeof(td_device));
    return result;
}
