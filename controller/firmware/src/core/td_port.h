/* Where an Arduino tool states precision and capacities.
 *
 * Such a tool compiles every file under src/ by itself and knows no flags of ours, so that transopt_port.h has to reach
 * every source before anything depends on it. TRANSOPT_PORT asks for the same under other tools. A build that says
 * neither states what it wants by flags alone.
 */
#ifndef TD_PORT_H
#define TD_PORT_H

#if defined(ARDUINO) || defined(TRANSOPT_PORT)
#include "../transopt_port.h"
#endif

#endif
