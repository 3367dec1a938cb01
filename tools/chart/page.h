// Writes a report for people: one self-contained HTML page (inline SVG, hover shows the setting, no scripts from
// elsewhere), a CSV of all settings, and each chart as SVG and PNG.
#pragma once
#include <string>

#include "formats/result.h"
#include "tools/chart/report.h"

namespace ff::chart {

// One chart as a standalone SVG document.
std::string svgChart(const Chart& chart);

// The page, the CSV (one line a setting and light) and the charts as files: FOLDER/NAME.html, NAME.csv, CHART.svg,
// CHART.png. PNGs are drawn by rsvg-convert (Debian: librsvg2-bin); where it is absent they are left out and
// `left_out` says so in one line. The same report gives the same bytes. Errors: kIo.
struct Written {
  std::vector<std::string> files;
  std::string left_out;
};
Result<Written> writePage(const Report& report, const std::string& folder, const std::string& name);

}  // namespace ff::chart
