/* The method for 8 problems side by side. */
#define WIDTH 8
#define ENTRIES 8
#include "stages.h"
