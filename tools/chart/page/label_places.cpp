#include "tools/chart/page/label_places.h"

#include <algorithm>
#include <cmath>

namespace ff::chart {
namespace {

double overlap(const LabelBox& a, const LabelBox& b) {
  const double w = std::min(a.x1, b.x1) - std::max(a.x0, b.x0), h = std::min(a.y1, b.y1) - std::max(a.y0, b.y0);
  return w > 0 && h > 0 ? w * h : 0;
}

}  // namespace

void LabelPlaces::occupyLine(double x0, double y0, double x1, double y1) {
  const int parts = std::max(1, static_cast<int>(std::hypot(x1 - x0, y1 - y0) / 6));
  for (int i = 0; i <= parts; ++i) {
    const double t = static_cast<double>(i) / parts, x = x0 + t * (x1 - x0), y = y0 + t * (y1 - y0);
    occupy({x - 1.5, y - 1.5, x + 1.5, y + 1.5});
  }
}

double LabelPlaces::covered(const LabelBox& box) const {
  const double area = (box.x1 - box.x0) * (box.y1 - box.y0);
  double sum = 20 * (area - overlap(box, plot_));  // outside is worse than over anything
  for (const LabelBox& other : taken_) sum += overlap(box, other);
  return sum;
}

LabelBox LabelPlaces::take(const std::vector<LabelBox>& candidates) {
  LabelBox best = candidates.front();
  double least = covered(best);
  for (size_t i = 1; i < candidates.size() && least > 0; ++i)
    if (const double here = covered(candidates[i]); here < least) least = here, best = candidates[i];
  occupy(best);
  return best;
}

}  // namespace ff::chart
