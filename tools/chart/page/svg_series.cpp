// What a chart shows of its series.
#include <algorithm>
#include <cmath>

#include "tools/chart/page/figure_text.h"
#include "tools/chart/page/svg_plot.h"

namespace ff::chart {
namespace {

constexpr double kHidden = 5;        // px: error bars shorter than that lie under their dot
constexpr double kHit = 10;          // px: where hovering finds a point
constexpr size_t kDotsOfALine = 60;  // a line of more is drawn without
constexpr size_t kHovers = 400;      // of one series; of more, every so many

using Drawn = SvgPlot::Drawn;

std::string stairsOrLine(const Drawn& d) {
  std::string path;
  for (const Drawn::At& at : d.at) {
    if (at.new_run)
      path += pathTo("M", at.x, at.y);
    else if (d.series->steps)
      path += pathTo("H", at.x) + pathTo("V", at.y);
    else
      path += pathTo("L", at.x, at.y);
  }
  return path;
}

// No farther than half way to the nearest other point, so that each can be reached.
double hitRadius(const SvgPlot& plot, const Drawn::At& at) {
  double nearest = 2 * kHit;
  for (const Drawn& d : plot.drawn) {
    if (!d.shape || d.at.size() > kHovers) continue;
    for (const Drawn::At& other : d.at)
      if (const double distance = std::hypot(other.x - at.x, other.y - at.y); distance > 0.5)
        nearest = std::min(nearest, distance);
  }
  return std::max(0.5 * nearest, 3.0);
}

std::string hoverOf(const Chart& chart, const Series& series, const Series::Point& p) {
  if (!p.hover.empty()) return p.hover;
  return series.name + (series.name.empty() ? "" : ": ") + chart.x_label + " " + withError({p.x, p.x_error}) + ", " +
         chart.y_label + " " + withError({p.y, p.y_error});
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

}  // namespace

void drawLines(SvgPlot& plot) {
  for (const Drawn& d : plot.drawn) {
    if (!d.series->lines) continue;
    plot.svg += "<g class=\"" + d.look + "\"><path class=\"" + (d.shape ? "line" : "reference") + "\"" + d.dashes + " d=\"" +
            stairsOrLine(d) + "\"/></g>\n";
    for (size_t i = 1; i < d.at.size(); ++i) {
      const Drawn::At &a = d.at[i - 1], &b = d.at[i];
      if (b.new_run) continue;
      if (d.series->steps) {
        plot.taken.occupyLine(a.x, a.y, b.x, a.y);
        plot.taken.occupyLine(b.x, a.y, b.x, b.y);
      } else {
        plot.taken.occupyLine(a.x, a.y, b.x, b.y);
      }
    }
  }
}

void drawBars(SvgPlot& plot) {
  for (const Drawn& d : plot.drawn) {
    std::string path;
    for (const auto& [p, at_x, at_y, new_run] : d.at) {
      if (p->y_error > 0 && std::isfinite(p->y_error)) {
        const double high = std::max(plot.top, plot.y(p->y + p->y_error));
        const double low = plot.y_axis.shows(p->y - p->y_error) ? std::min(plot.bottom, plot.y(p->y - p->y_error)) : plot.bottom;
        if (low - high > 2 * kHidden)
          path += pathTo("M", at_x, high) + pathTo("V", low) + pathTo("M", at_x - 3, high) + "h6" + pathTo("M", at_x - 3, low) + "h6";
      }
      if (p->x_error > 0 && std::isfinite(p->x_error)) {
        const double high = std::min(plot.right, plot.x(p->x + p->x_error));
        const double low = plot.x_axis.shows(p->x - p->x_error) ? std::max(plot.left, plot.x(p->x - p->x_error)) : plot.left;
        if (high - low > 2 * kHidden)
          path += pathTo("M", low, at_y) + pathTo("H", high) + pathTo("M", low, at_y - 3) + "v6" + pathTo("M", high, at_y - 3) + "v6";
      }
    }
    if (!path.empty()) plot.svg += "<g class=\"" + d.look + "\"><path class=\"bar\" d=\"" + path + "\"/></g>\n";
  }
}

// Marked points last, so that they lie on top.
void drawPoints(SvgPlot& plot) {
  for (const bool marked : {false, true})
    for (const Drawn& d : plot.drawn) {
      if (!d.shape) continue;
      const bool dots = !d.series->lines || d.at.size() <= kDotsOfALine;
      const size_t stride = d.at.size() / kHovers + 1;
      std::string group;
      for (size_t i = 0; i < d.at.size(); ++i) {
        const Drawn::At& at = d.at[i];
        if (at.point->marked != marked || (!marked && !dots && i % stride != 0)) continue;
        const double r = marked ? 9 : 5;
        if (marked || dots) plot.taken.occupy({at.x - r, at.y - r, at.x + r, at.y + r});
        group += "<g class=\"point\" transform=\"translate(" + px(at.x) + " " + px(at.y) + ")\"><title>" +
                 escaped(hoverOf(plot.chart, *d.series, *at.point)) + "</title><circle class=\"hit\" r=\"" +
                 px(marked ? kHit : hitRadius(plot, at)) + "\"/>";
        if (marked) group += "<circle class=\"ring\" r=\"8.5\"/>";
        if (marked || dots) group += std::string("<path class=\"shape\" d=\"") + d.shape + "\"/>";
        group += "</g>\n";
      }
      if (!group.empty()) plot.svg += "<g class=\"" + d.look + "\">" + group + "</g>\n";
    }
}

void drawPointLabels(SvgPlot& plot) {
  for (const Drawn& d : plot.drawn)
    for (const Drawn::At& at : d.at) {
      if (at.point->label.empty()) continue;
      const std::string words = shortened(at.point->label, 30);
      const LabelBox box = plot.taken.take(aroundPoint(at.x, at.y, widthInEms(words) * kTextSize));
      // Beside the point the near end is the one that must be in place, however wide the words turn out.
      if (box.x0 > at.x)
        plot.text(box.x0, box.y1 - 3, words, "halo strong");
      else if (box.x1 < at.x)
        plot.text(box.x1, box.y1 - 3, words, "halo strong", "end");
      else
        plot.text((box.x0 + box.x1) / 2, box.y1 - 3, words, "halo strong", "middle");
    }
}

}  // namespace ff::chart
