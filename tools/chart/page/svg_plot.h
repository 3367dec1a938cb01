// The plot of a chart: where its series lie in px, what is taken there, and the SVG that has been drawn so far.
#pragma once
#include <string>
#include <vector>

#include "tools/chart/page/axis.h"
#include "tools/chart/page/label_places.h"
#include "tools/chart/report.h"

namespace ff::chart {

inline constexpr double kTextSize = 12;  // px

struct SvgPlot {
  // A series of which something can be shown.
  struct Drawn {
    const Series* series = nullptr;
    std::string look{};          // classes: its colour
    const char* shape = nullptr; // null: no dots
    std::string dashes{};        // attribute
    struct At { const Series::Point* point; double x, y; bool new_run; };
    std::vector<At> at{};        // px; the points that can be shown
  };

  // The chart outlives it. Nothing has a place until place() has been called.
  explicit SvgPlot(const Chart& chart);
  // Where the plot lies, px: all that is drawn in it comes after this.
  void place(double left_px, double top_px, double right_px, double bottom_px);

  double x(double v) const { return left + x_axis.share(v) * (right - left); }
  double y(double v) const { return bottom - y_axis.share(v) * (bottom - top); }
  void text(double x, double y, const std::string& words, const std::string& classes, const char* anchor = "start");
  void line(double x0, double y0, double x1, double y1, const std::string& classes);

  const Chart& chart;
  Axis x_axis, y_axis;
  std::vector<Drawn> drawn;
  size_t left_out = 0;           // points that cannot be shown
  double left = 0, right = 0, top = 0, bottom = 0;
  LabelPlaces taken{{}};
  std::string svg;
};

// Lines, error bars, points with what hovering says, and the words beside them, in this order.
void drawLines(SvgPlot& plot);
void drawBars(SvgPlot& plot);
void drawPoints(SvgPlot& plot);
void drawPointLabels(SvgPlot& plot);

// Numbers and commands of SVG.
std::string px(double v);
std::string pathTo(const char* command, double v);
std::string pathTo(const char* command, double x, double y);

}  // namespace ff::chart
