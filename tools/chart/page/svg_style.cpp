#include "tools/chart/page/svg_style.h"

namespace ff::chart {
namespace {

std::string colourRules(const std::array<const char*, 7>& colours) {
  std::string css;
  for (size_t i = 0; i < colours.size(); ++i) css += ".ffc .c" + std::to_string(i) + "{color:" + colours[i] + "}";
  return css;
}

}  // namespace

std::string chartStyle() {
  return ".ffc{font-family:system-ui,-apple-system,\"Segoe UI\",Roboto,\"Helvetica Neue\",Arial,\"Liberation Sans\","
         "sans-serif;font-size:12px}"
         ".ffc .paper{fill:#fff}.ffc text{fill:#3c4043}.ffc .title{font-size:15px;font-weight:600;fill:#111}"
         ".ffc .quiet{fill:#6b7075}.ffc .strong{font-weight:600;fill:#111}"
         ".ffc .grid{stroke:#e7e9eb;stroke-width:1}.ffc .minor{stroke:#f3f4f5;stroke-width:1}"
         ".ffc .axis{stroke:#8a9096;stroke-width:1}.ffc .target{stroke:#555b61;stroke-width:1.2;stroke-dasharray:6 4}"
         ".ffc .halo{paint-order:stroke;stroke:#fff;stroke-width:4px;stroke-linejoin:round}"
         ".ffc .line{fill:none;stroke:currentColor;stroke-width:2;stroke-linejoin:round;stroke-linecap:round}"
         ".ffc .reference{fill:none;stroke:#9aa0a6;stroke-width:1.4;stroke-linejoin:round}"
         ".ffc .bar{fill:none;stroke:currentColor;stroke-width:1.1;opacity:.75}"
         ".ffc .lead{stroke:currentColor;stroke-width:1;opacity:.6}.ffc .lead.quiet{stroke:#9aa0a6}"
         ".ffc .shape{fill:currentColor;stroke:#fff;stroke-width:1}"
         ".ffc .ring{fill:none;stroke:currentColor;stroke-width:1.8}"
         ".ffc .hit{fill:transparent;stroke:none}"
         ".ffc .point .shape{transform-box:fill-box;transform-origin:center}"
         ".ffc .point:hover .shape{transform:scale(1.7);stroke:#111}.ffc .point:hover .hit{fill:currentColor;"
         "fill-opacity:.15}" +
         colourRules(kSeriesColours) +
         "@media (prefers-color-scheme:dark){.ffc .paper{fill:#17191c}.ffc text{fill:#d5d8db}.ffc .title,.ffc .strong"
         "{fill:#fff}.ffc .quiet{fill:#a0a6ac}.ffc .grid{stroke:#2e3237}.ffc .minor{stroke:#212428}.ffc .axis"
         "{stroke:#7d848b}.ffc .target{stroke:#b9bec3}.ffc .halo,.ffc .shape{stroke:#17191c}.ffc .reference{stroke:"
         "#7d848b}.ffc .point:hover .shape{stroke:#fff}" +
         colourRules(kSeriesColoursOnDark) + "}";
}

}  // namespace ff::chart
