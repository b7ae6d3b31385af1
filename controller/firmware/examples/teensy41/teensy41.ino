/* transopt on a Teensy 4.1: one motor with a current amplifier, an encoder, an accelerometer, a grip sensor.
 *
 * No silicon has run this sketch yet; it is compiled and run against stubs of what it uses. Bring a device up as
 * docs/howto/road.md says, motor power off first.
 *
 * The timer's interrupt runs once per servo period: readings, td_device_step, and in it the command before anything is
 * booked. Everything else happens outside of it: bytes from and to the host, hashing and checking of libraries.
 *
 * Libraries: QuadEncoder (mjs513/Teensy-4.x-Quad-Encoder-Library), Watchdog_t4 (tonton81/WDT_T4); EEPROM and SPI come
 * with Teensyduino.
 */
#include <EEPROM.h>
#include <QuadEncoder.h>
#include <SPI.h>
#include <Watchdog_t4.h>
#include <string.h>
#include <transopt_device.h>

/* Everything that follows from datasheets: period, limits, coil, scales. `transopt-play device circuit` writes it. */
#include "hardware.h"
#if COMMAND_BY_DAC && CONVERTER_BITS != 12
#error "the MCP4921 takes 12 bits: converter.bits = 12 in the circuit file, or output = \"pwm\""
#elif CONVERTER_BITS > 12
#error "the Teensy converts 12 bits: converter.bits = 12 in the circuit file"
#endif

/* ========================================== the one block to change: the pins ================================== */

#ifndef NOTHING_IS_WIRED
#define NOTHING_IS_WIRED 0 /* 1: a board without a motor, which arms without having seen a test pulse of its own */
#endif

const uint8_t PIN_ENCODER_A = 0; /* of the hardware decoder: 0 to 5, 7, 30, 31, 33 */
const uint8_t PIN_ENCODER_B = 1;
const uint8_t PIN_STOP = 9;    /* emergency stop: contact to ground, opens when pressed; a broken wire is a stop */
const uint8_t PIN_ENABLE = 6;  /* the amplifier's enable, high: on; wants 10 kOhm to ground for the time of booting */
const uint8_t PIN_ALIVE = 8;   /* changes every tick: for a retriggerable monostable of 10 periods in its line */
const uint8_t PIN_DAC_CS = 10; /* SPI: 11 data, 13 clock; its LDAC to ground */
const uint8_t PIN_PWM = 22;    /* if COMMAND_BY_DAC is 0 */
const uint8_t PIN_ACCELERATION = A0, PIN_GRIP = A1, PIN_CURRENT = A2; /* + pushes out of the object, all three */

/* ============================================================================================================== */

const uint32_t SAFE_TICKS = 1000;  /* from the first tick until the amplifier may be enabled */
const float WATCHDOG_S = 0.5f;     /* its shortest */
const float LOOP_S = 0.5f;         /* a loop that is away for longer hangs: the longest check takes a tenth of it */
const uint8_t TIMER_PRIORITY = 16; /* above USB and everything else but faults */

DMAMEM static td_device device; /* RAM2: td_device_start sets every byte */
static QuadEncoder encoder(1, PIN_ENCODER_A, PIN_ENCODER_B, 1);
static WDT_T4<WDT1> watchdog;
static IntervalTimer timer;
static uint64_t ticks;
static uint32_t tick_began, late_cycles, loop_ticks;
static volatile uint32_t away_ticks; /* since the loop last came by */

/* The coil's temperature over a reset: three general-purpose registers of the battery-backed domain, which lie one after
 * the other (SNVS_LPGPR0 to 2, by the name that Teensyduino's imxrt.h gives them). A check word tells them from what a
 * battery left that was empty. */
#ifdef __arm__
static volatile uint32_t *const KEPT = &SNVS_LPGPR0;
#else
static volatile uint32_t KEPT[3];
#endif
const uint32_t KEPT_MARK = 0x74656D70u;

static void put_counts(float counts)
{
    const uint16_t whole = (uint16_t)(counts < 0.0f ? 0.0f : (counts > (float)OUTPUT_MOST ? (float)OUTPUT_MOST : counts + 0.5f));
#if COMMAND_BY_DAC
    digitalWriteFast(PIN_DAC_CS, LOW);
    SPI.transfer16(0x3000 | whole); /* gain 1, on */
    digitalWriteFast(PIN_DAC_CS, HIGH);
#else
    analogWrite(PIN_PWM, whole);
#endif
}

static void put_nothing()
{
    digitalWriteFast(PIN_ENABLE, LOW);
    put_counts(OUTPUT_ZERO);
}

/* The command of this tick, from within td_device_step; the core has seen to its limits. */
static void put_command(void *, td_real command_A, bool enabled)
{
    if (!enabled || ticks <= SAFE_TICKS) {
        put_nothing();
        return;
    }
    put_counts(OUTPUT_ZERO + (float)command_A * OUTPUT_PER_A);
    digitalWriteFast(PIN_ENABLE, HIGH);
}

static uint32_t bits_of(float value)
{
    uint32_t bits;

    memcpy(&bits, &value, sizeof bits);
    return bits;
}

static float float_of(uint32_t bits)
{
    float value;

    memcpy(&value, &bits, sizeof value);
    return value;
}

static void keep_heat()
{
    double winding_C, housing_C;

    td_device_coil(&device, &winding_C, &housing_C);
    KEPT[0] = bits_of((float)winding_C);
    KEPT[1] = bits_of((float)housing_C);
    KEPT[2] = KEPT[0] ^ (KEPT[1] << 7 | KEPT[1] >> 25) ^ KEPT_MARK;
}

/* NaN without a sound check word: then the coil is taken to be as hot as it may be. */
static double kept_heat(int which)
{
    const bool sound = KEPT[2] == (KEPT[0] ^ (KEPT[1] << 7 | KEPT[1] >> 25) ^ KEPT_MARK);

    return sound ? (double)float_of(KEPT[which]) : (double)NAN;
}

static float value_of(uint8_t pin, const td_scale &scale)
{
    const int counts = analogRead(pin);

    return counts < scale.least || counts > scale.most ? NAN : ((float)counts - scale.zero_counts) * scale.per_count;
}

/* The servo period. */
static void tick()
{
    const uint32_t now = ARM_DWT_CYCCNT;
    td_readings readings;
    td_output output;

    /* The watchdog is to bite where either hangs: a tick that does not come feeds nothing, nor does one that comes alone. */
    if (away_ticks < loop_ticks) {
        away_ticks = away_ticks + 1;
        watchdog.feed();
        digitalWriteFast(PIN_ALIVE, ticks & 1);
    }
    /* A lost tick is a fault: where a current flows its command was held for too long, where none does a record has no
     * row for it, and all that is read thereafter is taken to be earlier than it was. */
    readings.late = ticks > 0 && now - tick_began > late_cycles;
    readings.host_stop = false;
    tick_began = now;
    readings.tick = ticks++;
    readings.encoder_counts = encoder.read();
    readings.current_A = value_of(PIN_CURRENT, CURRENT_A);
#if HAS_GRIP
    readings.grip_N = value_of(PIN_GRIP, GRIP_N);
#else
    readings.grip_N = NAN;
#endif
    readings.acceleration_m_s2 = value_of(PIN_ACCELERATION, ACCELERATION_M_S2);
    readings.emergency_stop = digitalReadFast(PIN_STOP) == HIGH;
    td_device_step(&device, &readings, &output);
}

/* Keep the tick out while what it shares is changed. */
static void hold(void *, bool held)
{
    if (held)
        NVIC_DISABLE_IRQ(IRQ_PIT);
    else
        NVIC_ENABLE_IRQ(IRQ_PIT);
#ifdef __arm__
    asm volatile("dsb\n\tisb" ::: "memory"); /* from the very next instruction on */
#endif
}

/* What analogRead does while it waits: nothing, since in the tick nothing else may run. */
void yield()
{
}

/* Another number at every start, by which the host sees that there was one. */
static uint32_t next_boot()
{
    uint32_t boot;

    EEPROM.get(0, boot);
    boot++;
    EEPROM.put(0, boot);
    return boot;
}

/* Nothing runs: outputs stay safe, and the host finds no device. */
static void give_up()
{
    put_nothing();
    for (;;)
        delay(1000);
}

void setup()
{
    WDT_timings_t timings;

    /* Outputs first, the level before the direction. */
    digitalWriteFast(PIN_ENABLE, LOW);
    pinMode(PIN_ENABLE, OUTPUT);
#if COMMAND_BY_DAC
    digitalWriteFast(PIN_DAC_CS, HIGH);
    pinMode(PIN_DAC_CS, OUTPUT);
    SPI.begin();
    SPI.beginTransaction(SPISettings(20000000, MSBFIRST, SPI_MODE0)); /* nobody else is on this bus */
#else
    analogWriteFrequency(PIN_PWM, PWM_HZ);
    analogWriteResolution(CONVERTER_BITS);
#endif
    put_nothing();
    pinMode(PIN_ALIVE, OUTPUT);
    pinMode(PIN_STOP, INPUT_PULLUP);
    analogReadResolution(CONVERTER_BITS);
    analogReadAveraging(1);
    encoder.setInitConfig();
    encoder.EncConfig.filterCount = 5; /* 8 alike, 33 ns apart: edges come 2.5 us apart at the fastest */
    encoder.EncConfig.filterSamplePeriod = 5;
    encoder.init();

    const td_port port = {
        next_boot(), HARDWARE, NOTHING_IS_WIRED != 0, kept_heat(0), kept_heat(1), hold, put_command, nullptr,
    };

    td_device_start(&device, &port);
    Serial.begin(115200); /* USB: as fast as it goes, whatever is asked for */
    late_cycles = (uint32_t)(1.5 * HARDWARE.dt_s * F_CPU_ACTUAL);
    loop_ticks = (uint32_t)(LOOP_S / HARDWARE.dt_s);
    away_ticks = 0;
    timings.timeout = WATCHDOG_S;
    timings.trigger = 0;
    watchdog.begin(timings);
    timer.priority(TIMER_PRIORITY);
    if (!timer.begin(tick, (float)(1e6 * HARDWARE.dt_s)))
        give_up();
}

void loop()
{
    static uint8_t bytes[512]; /* as much as one USB packet, and a short hold */
    const int waiting = Serial.available(), room = Serial.availableForWrite();

    away_ticks = 0;
    keep_heat();
    if (waiting > 0) {
        const size_t wanted = (size_t)waiting < sizeof bytes ? (size_t)waiting : sizeof bytes;

        td_device_receive(&device, bytes, Serial.readBytes((char *)bytes, wanted));
    }
    if (room > 0) {
        const size_t size = td_device_send(&device, bytes, (size_t)room < sizeof bytes ? (size_t)room : sizeof bytes);

        if (size > 0) {
            Serial.write(bytes, size);
            Serial.send_now();
        }
    }
}
