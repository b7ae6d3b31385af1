/* A stylus in a hand that does as it is asked, in place of the converters of an emulated board. */
#ifndef STYLUS_H
#define STYLUS_H

#include <stdbool.h>
#include <stdint.h>

void stylus_start(void);

/* The next character of what the hand is asked. */
void stylus_hear(char one);

/* One servo period: the command that was in force before [A], this period's, and whether the amplifier is enabled. */
void stylus_advance(float before_A, float command_A, bool enabled);

int32_t stylus_counts(void);
float stylus_current_A(void);
float stylus_grip_N(void);
float stylus_acceleration_m_s2(void);
bool stylus_stop_pressed(void);

#endif
