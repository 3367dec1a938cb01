#include "tools/chart/page/svg_plot.h"

#include <algorithm>

#include "tools/chart/page/figure_text.h"
#include "tools/chart/page/svg_style.h"

namespace ff::chart {
namespace {

std::vector<double> valuesOf(const Chart& chart, bool of_x) {
  const bool log = of_x ? chart.log_x : chart.log_y;
  std::vector<double> values;
  for (const Chart::Mark& mark : of_x ? chart.x_marks : chart.y_marks) values.push_back(mark.at);
  for (const Series& series : chart.series)
    for (const Series::Point& p : series.points) {
      const double v = of_x ? p.x : p.y, e = of_x ? p.x_error : p.y_error;
      values.push_back(v);
      if (!(e > 0)) continue;
      values.push_back(v + e);
      // An error as large as the figure would draw a logarithmic axis out to nothing.
      values.push_back(log ? std::max(v - e, 0.5 * v) : v - e);
    }
  return values;
}

}  // namespace

SvgPlot::SvgPlot(const Chart& of)
    : chart(of), x_axis(valuesOf(of, true), of.log_x), y_axis(valuesOf(of, false), of.log_y) {
  size_t coloured = 0, references = 0;
  for (const Series& s : chart.series) {
    Drawn d;
    d.series = &s;
    if (s.dots) {  // a series without points keeps its colour, so that charts of the same series agree
      d.look = "c";
      d.look += std::to_string(coloured % kSeriesColours.size());
      d.shape = kShapes[(coloured + coloured / kSeriesColours.size()) % kShapes.size()];  // another pair each time around
      if (coloured >= kSeriesColours.size()) d.dashes = " stroke-dasharray=\"7 4\"";
      ++coloured;
    } else if (references++ > 0) {
      d.dashes = " stroke-dasharray=\"" + std::to_string(2 * references) + " 3\"";
    }
    size_t shown = 0;
    for (const Series::Point& p : s.points) shown += x_axis.shows(p.x) && y_axis.shows(p.y) ? 1 : 0;
    left_out += s.points.size() - shown;
    if (shown > 0) drawn.push_back(std::move(d));
  }
}

void SvgPlot::place(double left_px, double top_px, double right_px, double bottom_px) {
  left = left_px;
  top = top_px;
  right = right_px;
  bottom = bottom_px;
  taken = LabelPlaces({left, top, right, bottom});
  for (Drawn& d : drawn) {
    bool new_run = true;
    for (const Series::Point& p : d.series->points) {
      const bool shown = x_axis.shows(p.x) && y_axis.shows(p.y);
      if (shown) d.at.push_back({&p, x(p.x), y(p.y), new_run});
      new_run = !shown;
    }
  }
}

void SvgPlot::text(double at_x, double at_y, const std::string& words, const std::string& classes, const char* anchor) {
  svg += "<text x=\"" + px(at_x) + "\" y=\"" + px(at_y) + "\"";
  if (!classes.empty()) svg += " class=\"" + classes + "\"";
  if (std::string(anchor) != "start") svg += std::string(" text-anchor=\"") + anchor + "\"";
  svg += '>';
  svg += escaped(words) + "</text>\n";
}

void SvgPlot::line(double x0, double y0, double x1, double y1, const std::string& classes) {
  svg += "<path class=\"" + classes + "\" d=\"" + pathTo("M", x0, y0) + pathTo("L", x1, y1) + "\"/>\n";
}

std::string px(double v) { return fixedNumber(v, 1); }

// Commands of a path.
std::string pathTo(const char* command, double v) {
  std::string s = command;
  return s += px(v);
}
std::string pathTo(const char* command, double x, double y) {
  std::string s = pathTo(command, x);
  s += ' ';
  return s += px(y);
}

}  // namespace ff::chart
