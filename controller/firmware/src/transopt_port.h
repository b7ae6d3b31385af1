/* What holds for the core wherever an Arduino tool compiles it: precision, capacities, and no liberties with numbers.
 *
 * Every source of the core includes it by way of td_port.h, and every sketch by way of transopt_device.h, so that all
 * agree on the layout of td_device. Change capacities here, or with -D for the whole build (PlatformIO's build_flags),
 * as plain whole numbers. A sketch and a library that were compiled with different ones do not link.
 */
#ifndef TRANSOPT_PORT_H
#define TRANSOPT_PORT_H

/* Hardware that computes with float only. Double would be right, and several times as slow. */
#if (defined(__ARM_FP) && !(__ARM_FP & 8)) || (defined(__riscv_flen) && __riscv_flen < 64)
#ifndef TD_REAL_FLOAT
#define TD_REAL_FLOAT
#endif
#endif

/* Hardware that computes with neither (RP2040, Cortex-M3), or does not say (Xtensa): a tick takes many periods. */
#if (defined(__arm__) && !defined(__ARM_FP)) || (defined(__riscv) && !defined(__riscv_flen)) || defined(__AVR__)
#ifndef TD_SOFTWARE_FLOAT
#error "this processor has no floating-point unit and is too slow for the servo; -DTD_SOFTWARE_FLOAT compiles it all the same"
#endif
#elif defined(__XTENSA__) && !defined(TD_REAL_FLOAT)
#error "doubles are computed in software here: compile with -DTD_REAL_FLOAT"
#endif

#ifndef TD_MAX_LIBRARY_SAMPLES
#if defined(__IMXRT1062__)
/* Teensy 4.0 and 4.1: 459 of the 524 kB of RAM2. */
#define TD_MAX_LIBRARY_SAMPLES 94208
#define TD_MAX_SPEEDS 32
#define TD_MAX_GRIPS 16
#define TD_MAX_RECORDS 512
#elif defined(__arm__)
/* Others: 106 kB, for 192 kB and more of RAM. */
#define TD_MAX_LIBRARY_SAMPLES 16384
#define TD_MAX_SPEEDS 16
#define TD_MAX_GRIPS 8
#define TD_MAX_RECORDS 128
#endif
#endif

/* The same bits on every processor: a * b + c in two roundings, NaN that are seen, constants in double precision. */
#if defined(__FAST_MATH__) || (defined(__FINITE_MATH_ONLY__) && __FINITE_MATH_ONLY__)
#error "compile without -ffast-math: the device finds dead sensors by their NaN"
#endif
#ifdef __cplusplus
static_assert(sizeof(0.1) == sizeof(double), "compile without -fsingle-precision-constant");
#else
_Static_assert(sizeof(0.1) == sizeof(double), "compile without -fsingle-precision-constant");
#if defined(__GNUC__) && !defined(__clang__)
#pragma GCC optimize("fp-contract=off")
#elif defined(__clang__)
#pragma STDC FP_CONTRACT OFF
#endif
#endif

#endif
