// What stands between faces that meet: a wall on the joint of two floors.
#pragma once
#include <array>
#include <cstdint>
#include <span>
#include <unordered_map>
#include <vector>

#include "formats/vec3.h"

namespace ff::view {

using GridCell = std::array<int32_t, 3>;
struct GridCellHash {
  size_t operator()(const GridCell& c) const {
    return static_cast<size_t>(static_cast<uint32_t>(c[0])) * 73856093u ^
           static_cast<size_t>(static_cast<uint32_t>(c[1])) * 19349663u ^
           static_cast<size_t>(static_cast<uint32_t>(c[2])) * 83492791u;
  }
};

class Walls {
 public:
  // corners: three per triangle, known to `tolerance`; patches: one per triangle. Both outlive this.
  Walls(std::span<const Vec3> corners, std::span<const uint32_t> patches, float cell_m, float tolerance);
  // Corners at one place, of faces that point the same way, in groups: two faces that share a side from there on are apart where
  // a wall stands on it, unless there is a way around the place or they are of one patch. Those without area are with their patch. One group where no wall stands.
  std::vector<std::vector<uint32_t>> split(std::span<const uint32_t> alike) const;

 private:
  bool wallBetween(uint32_t c, uint32_t d, Vec3 on_side, Vec3 along) const;

  std::span<const Vec3> corners_;
  std::span<const uint32_t> patches_;
  float step_m_, tolerance_;
  std::unordered_map<GridCell, std::vector<uint32_t>, GridCellHash> triangles_;  // by the cells of step_m_ that their boxes touch
};

}  // namespace ff::view
