#pragma once

#include <string.h>

#include "Arduino.h"

extern uint8_t stub_eeprom[64];

struct EEPROMClass {
    template <typename T> T &get(int at, T &value)
    {
        memcpy(&value, stub_eeprom + at, sizeof value);
        return value;
    }
    template <typename T> const T &put(int at, const T &value)
    {
        memcpy(stub_eeprom + at, &value, sizeof value);
        return value;
    }
};
extern EEPROMClass EEPROM;
