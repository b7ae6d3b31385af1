#include "transopt_port.h"

#include "../core/td_wire.c"
