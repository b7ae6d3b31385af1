/* The method for 4 problems side by side. */
#define WIDTH 4
#define ENTRIES 4
#include "stages.h"
