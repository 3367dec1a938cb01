// A dense grid of unit voxels of a few kinds, and its exposed faces as a mesh.
// A face is exposed between a solid voxel and air. Outside the grid counts as air above and as solid on the five other
// sides: the world has no underside and no outer walls, so a ray that leaves it meets the sky.
#pragma once
#include <array>
#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "tools/scene/model.h"

namespace ff::tools {

struct Int3 {
  int x = 0, y = 0, z = 0;
  friend bool operator==(const Int3&, const Int3&) = default;
};
inline Int3 operator+(Int3 a, Int3 b) { return {a.x + b.x, a.y + b.y, a.z + b.z}; }

inline constexpr std::array<Int3, 6> kFaceNormals{
    {{-1, 0, 0}, {1, 0, 0}, {0, -1, 0}, {0, 1, 0}, {0, 0, -1}, {0, 0, 1}}};

class Voxels {
 public:
  static constexpr uint8_t kAir = 0;

  explicit Voxels(Int3 size)
      : size_(size), kind_(static_cast<size_t>(size.x) * static_cast<size_t>(size.y) * static_cast<size_t>(size.z)) {}

  Int3 size() const { return size_; }
  bool contains(Int3 p) const {
    return p.x >= 0 && p.y >= 0 && p.z >= 0 && p.x < size_.x && p.y < size_.y && p.z < size_.z;
  }
  uint8_t at(Int3 p) const {
    if (contains(p)) return kind_[index(p)];
    return p.y >= size_.y ? kAir : kOutside;
  }
  bool air(Int3 p) const { return at(p) == kAir; }
  // Silently ignored outside the grid: things may be cropped at its border.
  void set(Int3 p, uint8_t kind) {
    if (contains(p)) kind_[index(p)] = kind;
  }
  // Every voxel of the box lo..hi, both included.
  void fill(Int3 lo, Int3 hi, uint8_t kind) {
    for (int y = lo.y; y <= hi.y; ++y)
      for (int z = lo.z; z <= hi.z; ++z)
        for (int x = lo.x; x <= hi.x; ++x) set({x, y, z}, kind);
  }
  uint64_t exposedFaces() const;
  uint64_t count(std::span<const uint8_t> kinds) const;

 private:
  static constexpr uint8_t kOutside = 255;
  size_t index(Int3 p) const {
    return (static_cast<size_t>(p.y) * static_cast<size_t>(size_.z) + static_cast<size_t>(p.z)) *
               static_cast<size_t>(size_.x) +
           static_cast<size_t>(p.x);
  }

  Int3 size_;
  std::vector<uint8_t> kind_;
};

struct VoxelMeshOptions {
  Int3 origin;         // coordinates of the lowest corner of voxel (0,0,0), in voxels
  bool merge = false;  // coplanar faces of one kind to larger rectangles, inside a chunk (leaves T-junctions)
  int chunk = 64;      // voxels along a chunk's edge: one node each
};

// Parts are numbered by material = kind - 1. Chunks without faces get no node.
std::vector<SceneNode> meshVoxels(const Voxels& voxels, const VoxelMeshOptions& options);

}  // namespace ff::tools
