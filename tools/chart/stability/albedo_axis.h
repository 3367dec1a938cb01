// What the experiments on albedo share: the albedos tried and the axis they are drawn on.
#pragma once
#include <algorithm>
#include <cmath>
#include <string>
#include <utility>
#include <vector>

#include "tools/chart/stability/breaking_point.h"

namespace ff::chart {

inline constexpr int kMaxIterations = 200000;
inline constexpr int kViewerIterations = 64;  // ffview's default before a picture

inline std::vector<float> albedosOf(bool quick) {
  if (quick) return {0.5f, 0.9f, 0.98f, 0.999f, 0.9999f};
  return {0.5f, 0.7f, 0.8f, 0.9f, 0.95f, 0.98f, 0.99f, 0.995f, 0.998f, 0.999f, 0.9995f, 0.9999f};
}

inline double rounded(float albedo) { return std::round(static_cast<double>(albedo) * 1e4) / 1e4; }

// One more point of a method's line, which begins with its first; then: what the program does at the hardest so far.
inline void addPoint(std::vector<Measured>& by_method, const std::string& scene, const std::string& method, double albedo,
                     double error, std::string then) {
  auto at = std::find_if(by_method.begin(), by_method.end(), [&](const Measured& m) { return m.method == method; });
  if (at == by_method.end()) {
    by_method.push_back({.scene = scene, .method = method, .knob = "albedo", .unit = "", .points = {}, .then = {}});
    at = by_method.end() - 1;
  }
  at->points.push_back({albedo, error});
  at->then = std::move(then);
}

inline Chart albedoChart(std::string id, std::string title, std::string y_label, std::string note) {
  Chart chart;
  chart.id = std::move(id);
  chart.title = std::move(title);
  chart.x_label = "light multiplied by 1 / (1 - albedo)";
  chart.y_label = std::move(y_label);
  chart.note = std::move(note);
  chart.log_x = chart.log_y = true;
  chart.x_marks = {{10, "albedo 0.9"}, {100, "0.99"}, {1000, "0.999"}};
  return chart;
}

// The same curve over 1 / (1 - albedo), which a logarithmic axis can show.
inline Series overMultiplication(const Measured& m) {
  Series series = seriesOf(m, m.method);
  for (Series::Point& p : series.points) p.x = 1 / (1 - p.x);
  return series;
}

}  // namespace ff::chart
