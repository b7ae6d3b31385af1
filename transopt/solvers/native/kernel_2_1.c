/* The method for one problem, its states in registers of 2 numbers. */
#define WIDTH 2
#define ENTRIES 1
#include "stages.h"
