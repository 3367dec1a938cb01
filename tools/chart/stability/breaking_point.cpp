#include "tools/chart/stability/breaking_point.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <limits>

#include "tools/chart/page/figure_text.h"

namespace ff::chart {
namespace {

std::string withUnit(const Measured& m, double at) { return numberText(at) + (m.unit.empty() ? "" : " " + m.unit); }

std::string firstPast(const Measured& m, double limit) {
  for (const Measured::Point& p : m.points)
    if (!(p.error <= limit)) return withUnit(m, p.at);
  return m.points.empty() ? "not run" : "never to " + withUnit(m, m.points.back().at);
}

}  // namespace

std::string numberText(double x) {
  char text[32];
  if (x == std::floor(x) && std::abs(x) < 1e15) {
    std::snprintf(text, sizeof text, "%.0f", x);
    std::string s = text;
    const size_t first = s[0] == '-' ? 1 : 0;
    for (size_t at = s.size(); at > first + 3;) s.insert(at -= 3, 1, ',');
    return s;
  }
  std::snprintf(text, sizeof text, std::abs(x) >= 0.01 && std::abs(x) < 1 ? "%.5g" : "%.3g", x);
  return text;
}

std::string percentText(double x) {
  if (!std::isfinite(x)) return "not finite";
  const double p = 100 * std::abs(x);
  if (p > 0 && p < 1e-4) return shortNumber(100 * x) + " %";
  char text[32];
  std::snprintf(text, sizeof text, p >= 1000 ? "%.1e %%" : p >= 99.5 ? "%.0f %%" : "%.2g %%", 100 * x);
  return text;
}

std::string passes(const Measured& m, double limit) { return firstPast(m, limit); }
std::string notFinite(const Measured& m) { return firstPast(m, std::numeric_limits<double>::max()); }

std::string worst(const Measured& m) {
  double most = 0;
  for (const Measured::Point& p : m.points) most = std::max(most, std::isnan(p.error) ? INFINITY : p.error);
  return m.points.empty() ? "" : percentText(most);
}

Series seriesOf(const Measured& m, const std::string& name) {
  Series series;
  series.name = name;
  for (const Measured::Point& p : m.points) {
    const bool past = !(p.error <= kMaxDrawn);
    series.points.push_back({.x = p.at,
                             .y = past ? kMaxDrawn : std::max(p.error, kLeastDrawn),
                             .hover = name + ", " + m.knob + " " + withUnit(m, p.at) + ": " + percentText(p.error),
                             .label = std::isfinite(p.error) ? "" : "not finite"});
    if (past) break;
  }
  return series;
}

Table breakingTable(std::span<const Measured> measured) {
  Table table;
  table.id = "where-it-breaks";
  table.title = "Where it breaks";
  table.note =
      "Relative L2 error of reflected radiosity unless the case says otherwise; each number is the first of those "
      "tried, "
      "from easy to hard.";
  table.columns = {"case, and the number",      "method", "past 1 %", "past 5 %", "not finite", "worst",
                   "what the program does then"};
  for (const Measured& m : measured)
    table.rows.push_back(
        {m.scene + ": " + m.knob, m.method, passes(m, 0.01), passes(m, 0.05), notFinite(m), worst(m), m.then});
  return table;
}

}  // namespace ff::chart
