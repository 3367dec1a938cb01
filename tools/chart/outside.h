// What lies outside the active patches of a cut.
#pragma once
#include <span>
#include <vector>

#include "runtime/cut/local_matrix.h"
#include "stream/streamer.h"

namespace ff::chart {

class Outside {
 public:
  // patches: of the whole world.
  Outside(size_t patches, std::span<const runtime::SlotRange> tiles);
  Outside(size_t patches, std::span<const stream::StripPtr> active);

  // Distance from a point to the nearest patch outside, m; 1e30: there is none. nodes: the world's patches from number
  // `first` on.
  float distance(Vec3 from, std::span<const formats::Node> nodes, size_t first = 0) const;
  // By area; black where nothing is outside. The best constant for all that is far. By patch of the world, radiosity 3 each.
  runtime::Vec4 meanRadiosity(std::span<const float> areas_m2, std::span<const double> radiosity) const;

 private:
  std::vector<bool> active_;  // by patch
};

}  // namespace ff::chart
