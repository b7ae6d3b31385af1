#pragma once

#include "Arduino.h"

#define SPI_MODE0 0

class SPISettings {
public:
    SPISettings(uint32_t clock_Hz, uint8_t bit_order, uint8_t mode);
};

class SPIClass {
public:
    void begin();
    void beginTransaction(SPISettings settings);
    uint16_t transfer16(uint16_t data);
};
extern SPIClass SPI;
