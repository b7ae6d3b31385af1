#pragma once

#include "Arduino.h"

class QuadEncoder {
public:
    struct {
        uint16_t filterCount, filterSamplePeriod;
    } EncConfig;
    QuadEncoder(uint8_t channel, uint8_t pin_a, uint8_t pin_b, uint8_t pullups);
    void setInitConfig();
    void init();
    int32_t read();
};
