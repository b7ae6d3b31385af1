// What the sketch uses of Teensyduino, as far as its declarations go; stub.cpp lets it run on the host.
#pragma once

#include <math.h>
#include <stddef.h>
#include <stdint.h>

#define DMAMEM
#define SNVS_LPGPR0 (*(volatile uint32_t *)0x400d4100) /* as in imxrt.h: IMXRT_SNVS_ADDRESS and its offset 0x100 */
#define HIGH 1
#define LOW 0
#define INPUT_PULLUP 2
#define OUTPUT 1
#define MSBFIRST 1

enum { A0 = 14, A1, A2 };
enum IRQ_NUMBER_t { IRQ_PIT = 122 };

extern uint32_t F_CPU_ACTUAL;
extern uint32_t ARM_DWT_CYCCNT;

void NVIC_ENABLE_IRQ(IRQ_NUMBER_t number);
void NVIC_DISABLE_IRQ(IRQ_NUMBER_t number);
void pinMode(uint8_t pin, uint8_t mode);
void digitalWriteFast(uint8_t pin, uint8_t value);
uint8_t digitalReadFast(uint8_t pin);
int analogRead(uint8_t pin);
void analogReadResolution(unsigned int bits);
void analogReadAveraging(unsigned int readings);
void analogWrite(uint8_t pin, int value);
void analogWriteFrequency(uint8_t pin, float frequency_Hz);
uint32_t analogWriteResolution(uint32_t bits);
void delay(uint32_t duration_ms);

extern "C" void yield(void);

class IntervalTimer {
public:
    bool begin(void (*called)(), float period_us);
    void priority(uint8_t number);
};

class usb_serial_class {
public:
    void begin(long baud);
    int available();
    int availableForWrite();
    size_t readBytes(char *bytes, size_t size);
    size_t write(const uint8_t *bytes, size_t size);
    void send_now();
};
extern usb_serial_class Serial;

void setup();
void loop();
