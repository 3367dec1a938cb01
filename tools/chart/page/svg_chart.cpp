// A chart's frame: title, legend, axes, targets, names at the ends of lines.
#include <algorithm>

#include "tools/chart/page/figure_text.h"
#include "tools/chart/page/page.h"
#include "tools/chart/page/svg_plot.h"
#include "tools/chart/page/svg_style.h"

namespace ff::chart {
namespace {

constexpr double kWidth = 640, kPlotHeight = 310, kEdge = 18;  // px
constexpr double kTitle = 15, kRow = 20;                       // px: size of its text, height of a row of the legend
constexpr size_t kDirectLabels = 5;                            // more series than that get a legend

class Frame {
 public:
  explicit Frame(const Chart& chart) : plot_(chart) { choosePlaces(); }
  std::string document();

 private:
  void choosePlaces();
  void legend();
  void axes();
  void endLabels();
  void targets();
  void footer();

  SvgPlot plot_;
  bool direct_ = false;  // names stand at the ends of lines, not in a legend
  double left_ = 0, right_ = 0, top_ = 0, height_ = 0;
};

// Direct labels where there are few lines and all of them end near the right edge.
void Frame::choosePlaces() {
  double label_ems = 0;
  direct_ = !plot_.drawn.empty() && plot_.drawn.size() <= kDirectLabels;
  for (const SvgPlot::Drawn& d : plot_.drawn) {
    label_ems = std::max(label_ems, widthInEms(d.series->name));
    double end = 0;
    for (const Series::Point& p : d.series->points)
      if (plot_.x_axis.shows(p.x) && plot_.y_axis.shows(p.y)) end = plot_.x_axis.share(p.x);
    direct_ = direct_ && d.series->lines && end > 0.8;
  }
  direct_ = direct_ && label_ems * kTextSize < 170;
  double number_ems = 0;
  for (const Axis::Tick& tick : plot_.y_axis.ticks()) number_ems = std::max(number_ems, widthInEms(tick.label));
  left_ = kEdge + number_ems * kTextSize + 8;
  right_ = kWidth - kEdge - (direct_ ? label_ems * kTextSize + 14 : 4);
  top_ = kEdge + 8;  // the title's baseline comes first; legend() and document() move it on
}

std::string swatch(const SvgPlot::Drawn& d, double at_x, double at_y) {
  std::string s = "<g class=\"" + d.look + "\" transform=\"translate(" + px(at_x) + " " + px(at_y) + ")\">";
  if (d.series->lines)
    s += std::string("<path class=\"") + (d.shape ? "line" : "reference") + "\"" + d.dashes + " d=\"M-10 0H10\"/>";
  if (d.shape) s += std::string("<path class=\"shape\" d=\"") + d.shape + "\"/>";
  return s + "</g>";
}

// In rows above the plot, where it cannot cover anything.
void Frame::legend() {
  if (direct_ || plot_.drawn.empty()) return;
  double at_x = kEdge + 10;
  top_ += kRow + 4;
  for (const SvgPlot::Drawn& d : plot_.drawn) {
    const std::string name = shortened(d.series->name, 46);
    const double width = 34 + widthInEms(name) * kTextSize;
    if (at_x + width > kWidth && at_x > kEdge + 10) at_x = kEdge + 10, top_ += kRow;
    plot_.svg += swatch(d, at_x, top_ - 4);
    plot_.text(at_x + 15, top_, name, "");
    at_x += width + 8;
  }
}

void Frame::axes() {
  for (const Axis::Tick& tick : plot_.x_axis.ticks()) {
    plot_.line(plot_.x(tick.at), plot_.top, plot_.x(tick.at), plot_.bottom, tick.label.empty() ? "minor" : "grid");
    if (!tick.label.empty()) plot_.text(plot_.x(tick.at), plot_.bottom + 18, tick.label, "", "middle");
  }
  for (const Axis::Tick& tick : plot_.y_axis.ticks()) {
    plot_.line(plot_.left, plot_.y(tick.at), plot_.right, plot_.y(tick.at), tick.label.empty() ? "minor" : "grid");
    if (!tick.label.empty()) plot_.text(plot_.left - 8, plot_.y(tick.at) + 4, tick.label, "", "end");
  }
  plot_.line(plot_.left, plot_.bottom, plot_.right, plot_.bottom, "axis");
  plot_.text(kEdge, plot_.top - 12, plot_.chart.y_label, "quiet");
  plot_.text(plot_.right, plot_.bottom + 38, plot_.chart.x_label, "quiet", "end");
}

// Spread so that they do not cover each other; a thin line leads to where the series ends.
void Frame::endLabels() {
  if (!direct_) return;
  std::vector<std::pair<double, const SvgPlot::Drawn*>> labels;
  for (const SvgPlot::Drawn& d : plot_.drawn) labels.push_back({d.at.back().y, &d});
  std::stable_sort(labels.begin(), labels.end(), [](const auto& a, const auto& b) { return a.first < b.first; });
  constexpr double kApart = 16;
  double floor = plot_.top + 4;
  for (auto& [at_y, d] : labels) at_y = std::max(at_y, floor), floor = at_y + kApart;
  double ceiling = plot_.bottom - 2;
  for (auto i = labels.rbegin(); i != labels.rend(); ++i) i->first = std::min(i->first, ceiling), ceiling = i->first - kApart;
  for (const auto& [at_y, d] : labels) {
    const SvgPlot::Drawn::At& end = d->at.back();
    plot_.svg += "<g class=\"" + d->look + "\">";
    plot_.line(end.x + 6, end.y, plot_.right + 10, at_y, d->shape ? "lead" : "lead quiet");
    plot_.svg += "</g>";
    plot_.text(plot_.right + 13, at_y + 4, d->series->name, "");
  }
}

void Frame::targets() {
  for (const Chart::Mark& mark : plot_.chart.y_marks) {
    if (!plot_.y_axis.shows(mark.at)) continue;
    const double at = plot_.y(mark.at), width = widthInEms(mark.text) * kTextSize;
    plot_.line(plot_.left, at, plot_.right, at, "target");
    std::vector<LabelBox> boxes;
    for (const double share : {1.0, 0.0, 0.5, 0.25, 0.75})
      for (const double above : {-9.0, 10.0}) {
        const double x0 = plot_.left + 4 + share * (plot_.right - plot_.left - width - 8);
        boxes.push_back({x0, at + above - 7, x0 + width, at + above + 7});
      }
    const LabelBox box = plot_.taken.take(boxes);
    plot_.text((box.x0 + box.x1) / 2, box.y1 - 3, mark.text, "halo", "middle");
  }
  for (const Chart::Mark& mark : plot_.chart.x_marks) {
    if (!plot_.x_axis.shows(mark.at)) continue;
    const double at = plot_.x(mark.at), width = widthInEms(mark.text) * kTextSize;
    plot_.line(at, plot_.top, at, plot_.bottom, "target");
    std::vector<LabelBox> boxes;
    for (const double share : {0.0, 1.0, 0.5, 0.25, 0.75})
      for (const bool right : {true, false}) {
        const double y0 = plot_.top + 2 + share * (plot_.bottom - plot_.top - 18), x0 = right ? at + 6 : at - 6 - width;
        boxes.push_back({x0, y0, x0 + width, y0 + 14});
      }
    const LabelBox box = plot_.taken.take(boxes);
    plot_.text((box.x0 + box.x1) / 2, box.y1 - 3, mark.text, "halo", "middle");
  }
}

void Frame::footer() {
  height_ = plot_.bottom + 38 + 14;
  if (plot_.drawn.empty()) plot_.text((plot_.left + plot_.right) / 2, (plot_.top + plot_.bottom) / 2, "nothing was measured", "quiet", "middle");
  if (plot_.left_out == 0) return;
  std::string words = std::to_string(plot_.left_out) + (plot_.left_out == 1 ? " point is" : " points are") + " not shown: not measured";
  if (plot_.chart.log_x || plot_.chart.log_y) words += ", or not above zero on a logarithmic axis";
  plot_.text(kEdge, height_ + 2, words + ".", "quiet");
  height_ += 16;
}

std::string Frame::document() {
  plot_.text(kEdge, top_, shortened(plot_.chart.title, (kWidth - 2 * kEdge) / kTitle), "title");
  legend();
  top_ += 34 + (plot_.chart.y_label.empty() ? -14 : 0);
  plot_.place(left_, top_, right_, top_ + kPlotHeight);
  axes();
  drawLines(plot_);
  drawBars(plot_);
  drawPoints(plot_);
  endLabels();
  drawPointLabels(plot_);
  targets();
  footer();
  const std::string size = px(kWidth) + " " + px(height_);
  return "<svg xmlns=\"http://www.w3.org/2000/svg\" class=\"ffc\" role=\"img\" aria-label=\"" + escaped(plot_.chart.title) +
         "\" viewBox=\"0 0 " + size + "\">\n<style>" + chartStyle() + "</style>\n<rect class=\"paper\" width=\"" +
         px(kWidth) + "\" height=\"" + px(height_) + "\"/>\n" + plot_.svg + "</svg>\n";
}

}  // namespace

std::string svgChart(const Chart& chart) { return Frame(chart).document(); }

}  // namespace ff::chart
