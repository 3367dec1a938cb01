// A report as one HTML document and as CSV, in memory.
#pragma once
#include <string>
#include <vector>

#include "tools/chart/report.h"

namespace ff::chart {

// Needs nothing from elsewhere; without scripts only sorting is lost, and that points speak at once. `picture_data`: of report.pictures, in their order,
// data URIs.
std::string htmlPage(const Report& report, const std::vector<std::string>& picture_data);

// One line a setting and light (a setting without figures: one line), full precision, not measured: empty. The columns do
// not depend on the report. Quoting as in RFC 4180; lines end with \n.
std::string csvTable(const Report& report);

}  // namespace ff::chart
