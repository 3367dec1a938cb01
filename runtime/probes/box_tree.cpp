#include "runtime/probes/box_tree.h"

#include <algorithm>
#include <numeric>

namespace ff::runtime {

BoxTree::BoxTree(std::span<const Box> boxes, uint32_t leaf) : order_(boxes.size()) {
  if (boxes.empty()) return;
  std::iota(order_.begin(), order_.end(), 0u);
  const auto centre = [&](uint32_t i, int a) { return boxes[i].lo[a] + boxes[i].hi[a]; };  // twice
  struct Part {
    uint32_t node, first, last, depth;
  };
  std::vector<Part> parts{{0, 0, static_cast<uint32_t>(boxes.size()), 0}};
  nodes_.emplace_back();
  while (!parts.empty()) {
    const Part part = parts.back();
    parts.pop_back();
    Box all, centres;
    for (uint32_t k = part.first; k < part.last; ++k) {
      all.add(boxes[order_[k]]);
      centres.add(Vec3{centre(order_[k], 0), centre(order_[k], 1), centre(order_[k], 2)});
    }
    nodes_[part.node].lo = all.lo;
    nodes_[part.node].hi = all.hi;
    if (part.last - part.first <= leaf) {
      nodes_[part.node].first = part.first;
      nodes_[part.node].count = part.last - part.first;
      continue;
    }
    const Vec3 extent = centres.hi - centres.lo;
    const int a = extent.x >= extent.y && extent.x >= extent.z ? 0 : extent.y >= extent.z ? 1 : 2;
    const auto begin = order_.begin() + part.first, end = order_.begin() + part.last;
    const float middle = (centres.lo[a] + centres.hi[a]) / 2;
    auto split = std::partition(begin, end, [&](uint32_t i) { return centre(i, a) < middle; });
    if (split == begin || split == end || part.depth >= kMaxDepth / 2) {
      split = begin + (end - begin) / 2;
      std::nth_element(begin, split, end, [&](uint32_t i, uint32_t j) { return centre(i, a) < centre(j, a); });
    }
    const auto at = static_cast<uint32_t>(split - order_.begin());
    const auto left = static_cast<uint32_t>(nodes_.size());
    nodes_[part.node].first = left;
    nodes_.resize(nodes_.size() + 2);
    parts.push_back({left, part.first, at, part.depth + 1});
    parts.push_back({left + 1, at, part.last, part.depth + 1});
  }
}

}  // namespace ff::runtime
