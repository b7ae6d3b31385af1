#include "transopt_port.h"

#include "../core/td_sha256.c"
