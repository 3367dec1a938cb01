// Writes a report for people: one self-contained HTML page (inline SVG, hover shows the setting, no scripts from
// elsewhere), a CSV of all settings, and each chart as SVG and PNG.
#pragma once
#include <string>

#include "formats/result.h"
#include "tools/chart/report.h"

namespace ff::chart {

// One chart as a standalone SVG document, of the width of whatever it is put into, for light and dark pages. Points that
// are not measured, and such as a logarithmic axis cannot show, are left out; the chart says how many. Error bars that
// would lie under their dot are not drawn. Any text may go in.
std::string svgChart(const Chart& chart);

// The page, the CSV (one line a setting and light) and the charts as files: FOLDER/NAME.html, NAME.csv, CHART.svg,
// CHART.png. PNGs are drawn by rsvg-convert (Debian: librsvg2-bin); where it is absent they are left out and
// `left_out` says so in one line. A last fact named "command" goes to the foot of the page; pictures are found from
// FOLDER. The folder is made if missing, each file appears whole, the page last. The same report gives the same bytes.
// Errors: kIo.
struct Written {
  std::vector<std::string> files;
  std::string left_out;
};
Result<Written> writePage(const Report& report, const std::string& folder, const std::string& name);

}  // namespace ff::chart
