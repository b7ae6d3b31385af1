#pragma once

#include "Arduino.h"

enum WDT_DEV_TABLE { WDT1, WDT2, WDT3 };

struct WDT_timings_t {
    double trigger = 5;
    double timeout = 10;
};

extern double stub_watchdog_s;
extern uint32_t stub_fed;

template <WDT_DEV_TABLE device> class WDT_T4 {
public:
    void begin(WDT_timings_t timings) { stub_watchdog_s = timings.timeout; }
    void feed() { stub_fed++; }
};
