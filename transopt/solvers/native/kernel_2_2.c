/* The method for 2 problems side by side. */
#define WIDTH 2
#define ENTRIES 2
#include "stages.h"
