#include "tools/chart/page/setting_charts.h"

#include <cmath>

#include "tools/chart/page/figure_text.h"

namespace ff::chart {
namespace {

struct Words {
  const char *id, *title, *x_label, *than;
};

Words wordsOf(Cost cost) {
  switch (cost) {
    case Cost::kRelightMs: return {"speed-accuracy", "Speed against accuracy", "time to relight, ms a frame", "faster"};
    case Cost::kMemoryMiB: return {"error-memory", "Error against memory", "local matrix and its strips in memory, MiB", "smaller"};
    case Cost::kDiskMiB: return {"error-disk", "Error against bytes on disk", "rows of all levels on disk, MiB", "smaller"};
    case Cost::kBakeSeconds: return {"error-bake", "Error against baking time", "baking time, s", "sooner baked"};
  }
  return {};
}

std::string figureText(const char* before, const Figure& f, double scale, const char* after) {
  return std::isfinite(f.value) ? before + withError(f, scale) + after : std::string();
}

std::string hoverOf(const Setting& s, const std::string& only_light) {
  std::string text = s.name;
  for (const Accuracy& a : s.accuracy) {
    if (!only_light.empty() && a.light != only_light) continue;
    text += "\n" + a.light + ": error " + withError(a.rel_l2, 100) + " %" + figureText(", median ", a.median, 100, " %") +
            figureText(", 95th ", a.p95, 100, " %") + figureText(", 99th ", a.p99, 100, " %") +
            figureText(", energy ", a.energy, 100, " %");
  }
  text += "\nrelight " + withError(s.relight_ms) + " ms" + figureText(", a tile ", s.update_ms_per_tile, 1, " ms") +
          figureText(", memory ", costOf(s, Cost::kMemoryMiB), 1, " MiB") +
          figureText(", disk ", costOf(s, Cost::kDiskMiB), 1, " MiB") +
          figureText(", bake ", costOf(s, Cost::kBakeSeconds), 1, " s");
  for (size_t i = 0; i < s.knobs.size(); ++i)
    text += (i % 4 == 0 ? "\n" : ", ") + s.knobs[i].first + " " + s.knobs[i].second;
  return s.note.empty() ? text : text + "\n" + s.note;
}

Series::Point pointOf(const Report& report, const Setting& s, const std::string& light, Cost cost) {
  const Figure x = costOf(s, cost), y = errorOf(report, s, light);
  Series::Point p;
  p.x = x.value;
  p.x_error = x.error;
  p.y = 100 * y.value;
  p.y_error = 100 * y.error;
  p.hover = hoverOf(s, light);
  p.marked = s.is_default;
  if (s.is_default) p.label = "default";
  return p;
}

bool hasPoints(const Chart& chart) {
  for (const Series& series : chart.series)
    for (const Series::Point& p : series.points)
      if (series.dots && std::isfinite(p.x) && std::isfinite(p.y)) return true;
  return false;
}

}  // namespace

Chart errorCostChart(const Report& report, const std::string& light, Cost cost) {
  const Words words = wordsOf(cost);
  Chart chart;
  chart.id = std::string(words.id) + "-" + (light.empty() ? "worst" : fileWord(light));
  chart.title = std::string(words.title) + ", " + (light.empty() ? "worst light" : light);
  chart.x_label = words.x_label;
  chart.y_label = "relative L2 error against the path tracer, %";
  chart.note = std::string("Lower left is better. The stairs are the front: nothing measured is both ") + words.than +
               " and more accurate. The ring is the default; every other point differs from it by the knob that the legend names.";
  chart.log_x = chart.log_y = true;

  Series stairs{"front", {}, true, true, false};
  for (const size_t i : front(report, light, cost)) {
    Series::Point p = pointOf(report, report.settings[i], light, cost);
    p.label.clear();
    stairs.points.push_back(std::move(p));
  }
  chart.series.push_back(std::move(stairs));
  for (const Setting& s : report.settings) {
    const std::string group = s.is_default || s.varies.empty() ? "default" : s.varies;
    auto at = chart.series.begin() + 1;
    while (at != chart.series.end() && at->name != group) ++at;
    if (at == chart.series.end()) at = chart.series.insert(at, Series{group, {}, false});
    at->points.push_back(pointOf(report, s, light, cost));
  }
  return chart;
}

std::vector<Chart> settingCharts(const Report& report) {
  std::vector<Chart> charts;
  for (const Cost cost : {Cost::kRelightMs, Cost::kMemoryMiB, Cost::kDiskMiB, Cost::kBakeSeconds})
    for (const std::string& light : lightsOf(report))
      if (Chart chart = errorCostChart(report, light, cost); hasPoints(chart)) charts.push_back(std::move(chart));
  return charts;
}

}  // namespace ff::chart
