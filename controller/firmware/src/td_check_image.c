#include "transopt_port.h"

#include "../core/td_check_image.c"
