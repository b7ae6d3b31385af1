/* Precision and capacities under an Arduino tool.
 *
 * Such a tool compiles every file under src/ separately and without flags of ours, so every source must include
 * transopt_port.h before anything depends on it. TRANSOPT_PORT requests the same with other tools. Any other build sets
 * precision and capacities by flags.
 */
#ifndef TD_PORT_H
#define TD_PORT_H

#if defined(ARDUINO) || defined(TRANSOPT_PORT)
#include "../transopt_port.h"
#endif

#endif
