#include "tools/chart/outside.h"

#include <algorithm>

namespace ff::chart {

using runtime::Vec4;

Outside::Outside(size_t patches, std::span<const runtime::SlotRange> tiles) : active_(patches, false) {
  for (const runtime::SlotRange& range : tiles)
    if (range.id.level == 0) std::fill_n(active_.begin() + range.first_node, range.nodes, true);
}

Outside::Outside(size_t patches, std::span<const stream::StripPtr> active) : active_(patches, false) {
  for (const stream::StripPtr& strip : active)
    if (strip->id.level == 0) std::fill_n(active_.begin() + strip->first_node, strip->nodes.size(), true);
}

float Outside::distance(Vec3 from, std::span<const formats::Node> nodes, size_t first) const {
  float nearest = 1e30f;
  for (size_t i = 0; i < nodes.size(); ++i)
    if (!active_[first + i]) nearest = std::min(nearest, length(nodes[i].centroid - from));
  return nearest;
}

Vec4 Outside::meanRadiosity(std::span<const float> areas_m2, std::span<const double> radiosity) const {
  double area = 0, sum[3] = {0, 0, 0};
  for (size_t p = 0; p < active_.size(); ++p) {
    if (active_[p]) continue;
    const auto a = static_cast<double>(areas_m2[p]);
    area += a;
    for (size_t c = 0; c < 3; ++c) sum[c] += a * radiosity[3 * p + c];
  }
  if (area == 0) return {};
  return {static_cast<float>(sum[0] / area), static_cast<float>(sum[1] / area), static_cast<float>(sum[2] / area), 0};
}

}  // namespace ff::chart
