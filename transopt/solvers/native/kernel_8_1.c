/* The method for one problem, its states in registers of 8 numbers. */
#define WIDTH 8
#define ENTRIES 1
#include "stages.h"
