// What it costs to keep the dense matrices up to date, by how many nodes enter and leave at once.
#pragma once
#include "formats/result.h"
#include "tools/chart/report.h"

namespace ff::chart {

// On synthetic form factors (walks.h) of twice as many patches as places; all matrices in turn within a round, medians of
// the rounds. Errors: kUsage (too little memory).
Result<Chart> blockSizeChart(uint32_t places, int rounds);

}  // namespace ff::chart
