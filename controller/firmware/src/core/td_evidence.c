#include "td_evidence.h"

#include <math.h>
#include <string.h>

void td_evidence_start(td_evidence *evidence)
{
    memset(evidence, 0, sizeof *evidence);
    evidence->current_ratio = evidence->acceleration_ratio = (double)NAN;
    evidence->path_ratio = evidence->speed_ratio = (double)NAN;
}
