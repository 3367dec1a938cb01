// Charts of a report's settings: error against what a setting costs, one chart a light. Each point says its whole setting
// where the pointer rests; the default has a ring, stairs join the front. A light "": the worst of all for each setting.
#pragma once
#include <string>
#include <vector>

#include "tools/chart/page/front.h"
#include "tools/chart/report.h"

namespace ff::chart {

Chart errorCostChart(const Report& report, const std::string& light, Cost cost);

inline Chart speedAccuracyChart(const Report& r, const std::string& light) { return errorCostChart(r, light, Cost::kRelightMs); }
inline Chart errorMemoryChart(const Report& r, const std::string& light) { return errorCostChart(r, light, Cost::kMemoryMiB); }
inline Chart errorDiskChart(const Report& r, const std::string& light) { return errorCostChart(r, light, Cost::kDiskMiB); }
inline Chart errorBakeChart(const Report& r, const std::string& light) { return errorCostChart(r, light, Cost::kBakeSeconds); }

// All four of every light, first those of speed; without those that would have no point.
std::vector<Chart> settingCharts(const Report& report);

}  // namespace ff::chart
