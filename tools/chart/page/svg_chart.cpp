#include <algorithm>
#include <cmath>

#include "tools/chart/page/axis.h"
#include "tools/chart/page/figure_text.h"
#include "tools/chart/page/label_places.h"
#include "tools/chart/page/page.h"
#include "tools/chart/page/svg_style.h"

namespace ff::chart {
namespace {

constexpr double kWidth = 640, kPlotHeight = 310, kEdge = 18;  // px
constexpr double kText = 12, kTitle = 15, kRow = 20;           // px: sizes of text, height of a row of the legend
constexpr double kHidden = 5;                                 // px: error bars shorter than that lie under their dot
constexpr double kHit = 10;                                    // px: where hovering finds a point
constexpr size_t kDotsOfALine = 60;                            // a line of more is drawn without
constexpr size_t kHovers = 400;                                // of one series; of more, every so many
constexpr size_t kDirectLabels = 5;                            // more series than that get a legend

using Point = Series::Point;

struct Drawn {
  const Series* series = nullptr;
  std::string look;                  // classes: its colour
  const char* shape = nullptr;       // null: no dots
  std::string dashes;                // attribute
  struct At { const Point* point; double x, y; bool new_run; };
  std::vector<At> at;                // px; the points that can be shown
};

std::string px(double v) { return fixedNumber(v, 1); }

// Commands of a path.
std::string to(const char* command, double v) {
  std::string s = command;
  return s += px(v);
}
std::string to(const char* command, double x, double y) {
  std::string s = to(command, x);
  s += ' ';
  return s += px(y);
}

class Drawing {
 public:
  explicit Drawing(const Chart& chart);
  std::string document();

 private:
  void choosePlaces();
  void legend();
  void axes();
  void lines();
  void bars();
  void points();
  void pointLabels();
  void endLabels();
  void targets();
  void footer();
  std::string stairsOrLine(const Drawn& d) const;
  std::string swatch(const Drawn& d, double x, double y) const;
  void text(double x, double y, const std::string& words, const std::string& classes, const char* anchor = "start");
  void line(double x0, double y0, double x1, double y1, const std::string& classes);
  double x(double v) const { return left_ + x_.share(v) * (right_ - left_); }
  double y(double v) const { return bottom_ - y_.share(v) * (bottom_ - top_); }
  double hitRadius(const Drawn::At& at) const;

  const Chart& chart_;
  Axis x_, y_;
  std::vector<Drawn> drawn_;
  size_t left_out_ = 0;
  bool direct_ = false;  // names stand at the ends of lines, not in a legend
  double left_ = 0, right_ = 0, top_ = 0, bottom_ = 0, height_ = 0;
  LabelPlaces places_{{}};
  std::string out_;
};

std::vector<double> valuesOf(const Chart& chart, bool of_x) {
  const bool log = of_x ? chart.log_x : chart.log_y;
  std::vector<double> values;
  for (const Chart::Mark& mark : of_x ? chart.x_marks : chart.y_marks) values.push_back(mark.at);
  for (const Series& series : chart.series)
    for (const Point& p : series.points) {
      const double v = of_x ? p.x : p.y, e = of_x ? p.x_error : p.y_error;
      values.push_back(v);
      if (!(e > 0)) continue;
      values.push_back(v + e);
      // An error as large as the figure would draw a logarithmic axis out to nothing.
      values.push_back(log ? std::max(v - e, 0.5 * v) : v - e);
    }
  return values;
}

Drawing::Drawing(const Chart& chart)
    : chart_(chart), x_(valuesOf(chart, true), chart.log_x), y_(valuesOf(chart, false), chart.log_y) {
  size_t coloured = 0, references = 0;
  for (const Series& series : chart.series) {
    Drawn d;
    d.series = &series;
    if (series.dots) {  // a series without points keeps its colour, so that charts of the same series agree
      d.look = "c" + std::to_string(coloured % kSeriesColours.size());
      d.shape = kShapes[(coloured + coloured / kSeriesColours.size()) % kShapes.size()];  // another pair each time around
      if (coloured >= kSeriesColours.size()) d.dashes = " stroke-dasharray=\"7 4\"";
      ++coloured;
    } else if (references++ > 0) {
      d.dashes = " stroke-dasharray=\"" + std::to_string(2 * references) + " 3\"";
    }
    size_t shown = 0;
    for (const Point& p : series.points) shown += x_.shows(p.x) && y_.shows(p.y) ? 1 : 0;
    left_out_ += series.points.size() - shown;
    if (shown > 0) drawn_.push_back(std::move(d));
  }
  choosePlaces();
  for (Drawn& d : drawn_) {
    bool new_run = true;
    for (const Point& p : d.series->points) {
      const bool shown = x_.shows(p.x) && y_.shows(p.y);
      if (shown) d.at.push_back({&p, x(p.x), y(p.y), new_run});
      new_run = !shown;
    }
  }
}

// Direct labels where there are few lines and all of them end near the right edge.
void Drawing::choosePlaces() {
  double label_ems = 0;
  direct_ = !drawn_.empty() && drawn_.size() <= kDirectLabels;
  for (const Drawn& d : drawn_) {
    label_ems = std::max(label_ems, widthInEms(d.series->name));
    double end = 0;
    for (const Point& p : d.series->points)
      if (x_.shows(p.x) && y_.shows(p.y)) end = x_.share(p.x);
    direct_ = direct_ && d.series->lines && end > 0.8;
  }
  direct_ = direct_ && label_ems * kText < 170;
  double number_ems = 0;
  for (const Axis::Tick& tick : y_.ticks()) number_ems = std::max(number_ems, widthInEms(tick.label));
  left_ = kEdge + number_ems * kText + 8;
  right_ = kWidth - kEdge - (direct_ ? label_ems * kText + 14 : 4);
  top_ = kEdge + 8;  // the title's baseline comes first; legend() and document() move it on
}

void Drawing::text(double at_x, double at_y, const std::string& words, const std::string& classes, const char* anchor) {
  out_ += "<text x=\"" + px(at_x) + "\" y=\"" + px(at_y) + "\"";
  if (!classes.empty()) out_ += " class=\"" + classes + "\"";
  if (std::string(anchor) != "start") out_ += std::string(" text-anchor=\"") + anchor + "\"";
  out_ += ">" + escaped(words) + "</text>\n";
}

void Drawing::line(double x0, double y0, double x1, double y1, const std::string& classes) {
  out_ += "<path class=\"" + classes + "\" d=\"" + to("M", x0, y0) + to("L", x1, y1) + "\"/>\n";
}

std::string Drawing::swatch(const Drawn& d, double at_x, double at_y) const {
  std::string s = "<g class=\"" + d.look + "\" transform=\"translate(" + px(at_x) + " " + px(at_y) + ")\">";
  if (d.series->lines)
    s += std::string("<path class=\"") + (d.shape ? "line" : "reference") + "\"" + d.dashes + " d=\"M-10 0H10\"/>";
  if (d.shape) s += std::string("<path class=\"shape\" d=\"") + d.shape + "\"/>";
  return s + "</g>";
}

// In rows above the plot, where it cannot cover anything.
void Drawing::legend() {
  if (direct_ || drawn_.empty()) return;
  double at_x = kEdge + 10;
  top_ += kRow + 4;
  for (const Drawn& d : drawn_) {
    const std::string name = shortened(d.series->name, 46);
    const double width = 34 + widthInEms(name) * kText;
    if (at_x + width > kWidth && at_x > kEdge + 10) at_x = kEdge + 10, top_ += kRow;
    out_ += swatch(d, at_x, top_ - 4);
    text(at_x + 15, top_, name, "");
    at_x += width + 8;
  }
}

void Drawing::axes() {
  for (const Axis::Tick& tick : x_.ticks()) {
    line(x(tick.at), top_, x(tick.at), bottom_, tick.label.empty() ? "minor" : "grid");
    if (!tick.label.empty()) text(x(tick.at), bottom_ + 18, tick.label, "", "middle");
  }
  for (const Axis::Tick& tick : y_.ticks()) {
    line(left_, y(tick.at), right_, y(tick.at), tick.label.empty() ? "minor" : "grid");
    if (!tick.label.empty()) text(left_ - 8, y(tick.at) + 4, tick.label, "", "end");
  }
  line(left_, bottom_, right_, bottom_, "axis");
  text(kEdge, top_ - 12, chart_.y_label, "quiet");
  text(right_, bottom_ + 38, chart_.x_label, "quiet", "end");
}

std::string Drawing::stairsOrLine(const Drawn& d) const {
  std::string path;
  for (const Drawn::At& at : d.at) {
    if (at.new_run)
      path += to("M", at.x, at.y);
    else if (d.series->steps)
      path += to("H", at.x) + to("V", at.y);
    else
      path += to("L", at.x, at.y);
  }
  return path;
}

void Drawing::lines() {
  for (const Drawn& d : drawn_) {
    if (!d.series->lines) continue;
    out_ += "<g class=\"" + d.look + "\"><path class=\"" + (d.shape ? "line" : "reference") + "\"" + d.dashes + " d=\"" +
            stairsOrLine(d) + "\"/></g>\n";
    for (size_t i = 1; i < d.at.size(); ++i) {
      const Drawn::At &a = d.at[i - 1], &b = d.at[i];
      if (b.new_run) continue;
      if (d.series->steps) {
        places_.occupyLine(a.x, a.y, b.x, a.y);
        places_.occupyLine(b.x, a.y, b.x, b.y);
      } else {
        places_.occupyLine(a.x, a.y, b.x, b.y);
      }
    }
  }
}

void Drawing::bars() {
  for (const Drawn& d : drawn_) {
    std::string path;
    for (const auto& [p, at_x, at_y, new_run] : d.at) {
      if (p->y_error > 0 && std::isfinite(p->y_error)) {
        const double high = std::max(top_, y(p->y + p->y_error));
        const double low = y_.shows(p->y - p->y_error) ? std::min(bottom_, y(p->y - p->y_error)) : bottom_;
        if (low - high > 2 * kHidden)
          path += to("M", at_x, high) + to("V", low) + to("M", at_x - 3, high) + "h6" + to("M", at_x - 3, low) + "h6";
      }
      if (p->x_error > 0 && std::isfinite(p->x_error)) {
        const double high = std::min(right_, x(p->x + p->x_error));
        const double low = x_.shows(p->x - p->x_error) ? std::max(left_, x(p->x - p->x_error)) : left_;
        if (high - low > 2 * kHidden)
          path += to("M", low, at_y) + to("H", high) + to("M", low, at_y - 3) + "v6" + to("M", high, at_y - 3) + "v6";
      }
    }
    if (!path.empty()) out_ += "<g class=\"" + d.look + "\"><path class=\"bar\" d=\"" + path + "\"/></g>\n";
  }
}

// No farther than half way to the nearest other point, so that each can be reached.
double Drawing::hitRadius(const Drawn::At& at) const {
  double nearest = 2 * kHit;
  for (const Drawn& d : drawn_) {
    if (!d.shape || d.at.size() > kHovers) continue;
    for (const Drawn::At& other : d.at)
      if (const double distance = std::hypot(other.x - at.x, other.y - at.y); distance > 0.5)
        nearest = std::min(nearest, distance);
  }
  return std::max(0.5 * nearest, 3.0);
}

std::string hoverOf(const Chart& chart, const Series& series, const Point& p) {
  if (!p.hover.empty()) return p.hover;
  return series.name + (series.name.empty() ? "" : ": ") + chart.x_label + " " + withError({p.x, p.x_error}) + ", " +
         chart.y_label + " " + withError({p.y, p.y_error});
}

// Marked points last, so that they lie on top.
void Drawing::points() {
  for (const bool marked : {false, true})
    for (const Drawn& d : drawn_) {
      if (!d.shape) continue;
      const bool dots = !d.series->lines || d.at.size() <= kDotsOfALine;
      const size_t stride = d.at.size() / kHovers + 1;
      std::string group;
      for (size_t i = 0; i < d.at.size(); ++i) {
        const Drawn::At& at = d.at[i];
        if (at.point->marked != marked || (!marked && !dots && i % stride != 0)) continue;
        const double r = marked ? 9 : 5;
        if (marked || dots) places_.occupy({at.x - r, at.y - r, at.x + r, at.y + r});
        group += "<g class=\"point\" transform=\"translate(" + px(at.x) + " " + px(at.y) + ")\"><title>" +
                 escaped(hoverOf(chart_, *d.series, *at.point)) + "</title><circle class=\"hit\" r=\"" +
                 px(marked ? kHit : hitRadius(at)) + "\"/>";
        if (marked) group += "<circle class=\"ring\" r=\"8.5\"/>";
        if (marked || dots) group += std::string("<path class=\"shape\" d=\"") + d.shape + "\"/>";
        group += "</g>\n";
      }
      if (!group.empty()) out_ += "<g class=\"" + d.look + "\">" + group + "</g>\n";
    }
}

std::vector<LabelBox> aroundPoint(double x, double y, double width) {
  std::vector<LabelBox> boxes;
  for (const double away : {11.0, 22.0})
    for (const auto& [dx, dy] : {std::pair{1, 0}, {1, -1}, {1, 1}, {-1, 0}, {-1, -1}, {-1, 1}, {0, -1}, {0, 1}}) {
      const double cx = x + dx * (away + width / 2) - (dx != 0 && dy != 0 ? dx * 5 : 0), cy = y + dy * (away + 2);
      boxes.push_back({cx - width / 2, cy - 7, cx + width / 2, cy + 7});
    }
  return boxes;
}

void Drawing::pointLabels() {
  for (const Drawn& d : drawn_)
    for (const Drawn::At& at : d.at) {
      if (at.point->label.empty()) continue;
      const std::string words = shortened(at.point->label, 30);
      const LabelBox box = places_.take(aroundPoint(at.x, at.y, widthInEms(words) * kText));
      // Beside the point the near end is the one that must be in place, however wide the words turn out.
      if (box.x0 > at.x)
        text(box.x0, box.y1 - 3, words, "halo strong");
      else if (box.x1 < at.x)
        text(box.x1, box.y1 - 3, words, "halo strong", "end");
      else
        text((box.x0 + box.x1) / 2, box.y1 - 3, words, "halo strong", "middle");
    }
}

// Spread so that they do not cover each other; a thin line leads to where the series ends.
void Drawing::endLabels() {
  if (!direct_) return;
  std::vector<std::pair<double, const Drawn*>> labels;
  for (const Drawn& d : drawn_) labels.push_back({d.at.back().y, &d});
  std::stable_sort(labels.begin(), labels.end(), [](const auto& a, const auto& b) { return a.first < b.first; });
  constexpr double kApart = 16;
  double floor = top_ + 4;
  for (auto& [at_y, d] : labels) at_y = std::max(at_y, floor), floor = at_y + kApart;
  double ceiling = bottom_ - 2;
  for (auto i = labels.rbegin(); i != labels.rend(); ++i) i->first = std::min(i->first, ceiling), ceiling = i->first - kApart;
  for (const auto& [at_y, d] : labels) {
    const Drawn::At& end = d->at.back();
    out_ += "<g class=\"" + d->look + "\">";
    line(end.x + 6, end.y, right_ + 10, at_y, d->shape ? "lead" : "lead quiet");
    out_ += "</g>";
    text(right_ + 13, at_y + 4, d->series->name, "");
  }
}

void Drawing::targets() {
  for (const Chart::Mark& mark : chart_.y_marks) {
    if (!y_.shows(mark.at)) continue;
    const double at = y(mark.at), width = widthInEms(mark.text) * kText;
    line(left_, at, right_, at, "target");
    std::vector<LabelBox> boxes;
    for (const double share : {1.0, 0.0, 0.5, 0.25, 0.75})
      for (const double above : {-9.0, 10.0}) {
        const double x0 = left_ + 4 + share * (right_ - left_ - width - 8);
        boxes.push_back({x0, at + above - 7, x0 + width, at + above + 7});
      }
    const LabelBox box = places_.take(boxes);
    text((box.x0 + box.x1) / 2, box.y1 - 3, mark.text, "halo", "middle");
  }
  for (const Chart::Mark& mark : chart_.x_marks) {
    if (!x_.shows(mark.at)) continue;
    const double at = x(mark.at), width = widthInEms(mark.text) * kText;
    line(at, top_, at, bottom_, "target");
    std::vector<LabelBox> boxes;
    for (const double share : {0.0, 1.0, 0.5, 0.25, 0.75})
      for (const bool right : {true, false}) {
        const double y0 = top_ + 2 + share * (bottom_ - top_ - 18), x0 = right ? at + 6 : at - 6 - width;
        boxes.push_back({x0, y0, x0 + width, y0 + 14});
      }
    const LabelBox box = places_.take(boxes);
    text((box.x0 + box.x1) / 2, box.y1 - 3, mark.text, "halo", "middle");
  }
}

void Drawing::footer() {
  height_ = bottom_ + 38 + 14;
  if (drawn_.empty()) text((left_ + right_) / 2, (top_ + bottom_) / 2, "nothing was measured", "quiet", "middle");
  if (left_out_ == 0) return;
  std::string words = std::to_string(left_out_) + (left_out_ == 1 ? " point is" : " points are") + " not shown: not measured";
  if (chart_.log_x || chart_.log_y) words += ", or not above zero on a logarithmic axis";
  text(kEdge, height_ + 2, words + ".", "quiet");
  height_ += 16;
}

std::string Drawing::document() {
  text(kEdge, top_, shortened(chart_.title, (kWidth - 2 * kEdge) / kTitle), "title");
  legend();
  top_ += 34 + (chart_.y_label.empty() ? -14 : 0);
  bottom_ = top_ + kPlotHeight;
  places_ = LabelPlaces({left_, top_, right_, bottom_});
  for (Drawn& d : drawn_)
    for (Drawn::At& at : d.at) at.x = x(at.point->x), at.y = y(at.point->y);
  axes();
  lines();
  bars();
  points();
  endLabels();
  pointLabels();
  targets();
  footer();
  const std::string size = px(kWidth) + " " + px(height_);
  return "<svg xmlns=\"http://www.w3.org/2000/svg\" class=\"ffc\" role=\"img\" aria-label=\"" + escaped(chart_.title) +
         "\" viewBox=\"0 0 " + size + "\">\n<style>" + chartStyle() + "</style>\n<rect class=\"paper\" width=\"" +
         px(kWidth) + "\" height=\"" + px(height_) + "\"/>\n" + out_ + "</svg>\n";
}

}  // namespace

std::string svgChart(const Chart& chart) { return Drawing(chart).document(); }

}  // namespace ff::chart
