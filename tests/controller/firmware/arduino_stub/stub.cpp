// A Teensy of variables, for ctypes: pins, inputs and the bytes of the USB line are set and read from outside.
#include "Arduino.h"
#include "EEPROM.h"
#include "QuadEncoder.h"
#include "SPI.h"
#include "Watchdog_t4.h"

#include <deque>
#include <stdlib.h>

uint32_t F_CPU_ACTUAL = 600000000, ARM_DWT_CYCCNT, stub_fed;
double stub_watchdog_s;
uint8_t stub_eeprom[64];
EEPROMClass EEPROM;
SPIClass SPI;
usb_serial_class Serial;

static uint8_t levels[64], modes[64];
static int analogue[64], pwm[64], encoder_counts;
static uint16_t dac;
static bool tick_masked, in_tick, pin_was_high_before_output;
static void (*timer)();
static float timer_us;
static std::deque<uint8_t> to_device, to_host;

// What may not happen ends the program, for the test to see.
static void require(bool holds)
{
    if (!holds)
        abort();
}

void NVIC_ENABLE_IRQ(IRQ_NUMBER_t) { tick_masked = false; }
void NVIC_DISABLE_IRQ(IRQ_NUMBER_t)
{
    require(!tick_masked);
    tick_masked = true;
}
void pinMode(uint8_t pin, uint8_t mode)
{
    pin_was_high_before_output |= mode == OUTPUT && pin == 6 && levels[pin];
    modes[pin] = mode;
}
void digitalWriteFast(uint8_t pin, uint8_t value) { levels[pin] = value; }
uint8_t digitalReadFast(uint8_t pin) { return levels[pin]; }
int analogRead(uint8_t pin)
{
    yield();
    return analogue[pin];
}
void analogReadResolution(unsigned int bits) { require(bits == 12); }
void analogReadAveraging(unsigned int) {}
void analogWrite(uint8_t pin, int value) { pwm[pin] = value; }
void analogWriteFrequency(uint8_t, float) {}
uint32_t analogWriteResolution(uint32_t bits) { return bits; }
void delay(uint32_t) { exit(7); } // only what has given up waits

bool IntervalTimer::begin(void (*called)(), float period_us)
{
    timer = called;
    timer_us = period_us;
    return true;
}
void IntervalTimer::priority(uint8_t) {}

QuadEncoder::QuadEncoder(uint8_t, uint8_t, uint8_t, uint8_t) {}
void QuadEncoder::setInitConfig() {}
void QuadEncoder::init() {}
int32_t QuadEncoder::read() { return encoder_counts; }

SPISettings::SPISettings(uint32_t, uint8_t, uint8_t) {}
void SPIClass::begin() {}
void SPIClass::beginTransaction(SPISettings) {}
uint16_t SPIClass::transfer16(uint16_t data)
{
    require(levels[10] == LOW);
    dac = data;
    return 0;
}

void usb_serial_class::begin(long) {}
int usb_serial_class::available()
{
    require(!in_tick);
    return (int)to_device.size();
}
int usb_serial_class::availableForWrite() { return 4096; }
size_t usb_serial_class::readBytes(char *bytes, size_t size)
{
    require(!in_tick && !tick_masked && size <= to_device.size());
    for (size_t j = 0; j < size; j++) {
        bytes[j] = (char)to_device.front();
        to_device.pop_front();
    }
    return size;
}
size_t usb_serial_class::write(const uint8_t *bytes, size_t size)
{
    require(!in_tick && !tick_masked);
    to_host.insert(to_host.end(), bytes, bytes + size);
    return size;
}
void usb_serial_class::send_now() {}

extern "C" {

void stub_setup(void) { setup(); }
void stub_loop(void) { loop(); }

// One period later, or as much later as is said.
void stub_tick(float periods)
{
    require(timer != nullptr && !tick_masked);
    ARM_DWT_CYCCNT += (uint32_t)(periods * timer_us * 600.0f);
    in_tick = true;
    timer();
    in_tick = false;
}

void stub_set_pin(int pin, int level) { levels[pin] = (uint8_t)level; }
int stub_pin(int pin) { return levels[pin]; }
int stub_pin_mode(int pin) { return modes[pin]; }
bool stub_enable_rose_early(void) { return pin_was_high_before_output; }
void stub_set_analogue(int pin, int counts) { analogue[pin] = counts; }
void stub_set_encoder(int counts) { encoder_counts = counts; }
int stub_pwm(int pin) { return pwm[pin]; }
int stub_dac(void) { return dac; }
uint32_t stub_feedings(void) { return stub_fed; }
double stub_watchdog(void) { return stub_watchdog_s; }
float stub_period_us(void) { return timer_us; }
void stub_receive(const uint8_t *bytes, size_t size) { to_device.insert(to_device.end(), bytes, bytes + size); }
size_t stub_send(uint8_t *bytes, size_t room)
{
    size_t size = 0;

    for (; size < room && !to_host.empty(); size++) {
        bytes[size] = to_host.front();
        to_host.pop_front();
    }
    return size;
}
}
