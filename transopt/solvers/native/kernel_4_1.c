/* The method for one problem, its states in registers of 4 numbers. */
#define WIDTH 4
#define ENTRIES 1
#include "stages.h"
