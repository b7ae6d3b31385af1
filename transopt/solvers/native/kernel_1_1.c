/* The method for one problem, number by number. */
#define WIDTH 1
#define ENTRIES 1
#include "stages.h"
