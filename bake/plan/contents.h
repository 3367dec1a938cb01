// What stands where, as digests: what rays can meet in each cube of the world, and the patches of each range that is cast together. Equal
// digests: rays that stay there find the same.
#pragma once
#include <cstdint>
#include <span>
#include <unordered_map>
#include <vector>

#include "bake/plan/cache.h"
#include "bake/rays/ray_trail.h"
#include "bake/scene.h"
#include "bake/surface/patches.h"

namespace ff::bake {

inline constexpr int kCubeLog = 3;  // cells a side, at least; more where the box would have more than kMaxCubes
inline constexpr double kMaxCubes = 1 << 26;

class Contents {
 public:
  // On all of TBB's threads. Both outlive it.
  Contents(const Scene& scene, const PatchSet& set);

  // Holds the scene and some air around it.
  const CubeBox& box() const { return box_; }
  // Of a cube, in the box or not.
  Digest cube(const CubeBox::Cube& cube) const;
  // Of the patches whose cells lie in a cube of 2^kCastLog cells, by its Hilbert key: their names and orientations, in order. Zeros: there are none.
  Digest patchesIn(uint64_t cast_cube) const;
  // Of patches [first, end): all that a ray that starts on them depends on.
  Digest surface(uint32_t first, uint32_t end) const;
  // Of all that emits: the aims of rays towards lamps depend on every lamp.
  const Digest& lamps() const { return lamps_; }

  // All cubes' digests, for changesSince().
  std::vector<std::byte> encoded() const;
  // Middles of cubes, m, that hold something else than they did when `before` was encoded; none where that is of other cubes.
  std::vector<Vec3> changesSince(std::span<const std::byte> before) const;

  // The first patch of a cube of 2^kCastLog cells, and one after the last; both 0 where there are none.
  std::pair<uint32_t, uint32_t> rangeOf(uint64_t cast_cube) const;

 private:
  void addPieces();
  uint64_t materialDigest(const Material& material) const;
  uint64_t triangleDigest(uint32_t t) const;
  uint64_t patchName(uint32_t patch) const;

  const Scene& scene_;
  const PatchSet& set_;
  CubeBox box_;
  PagedVector<uint64_t> material_, triangle_;        // digests
  std::unordered_map<uint32_t, Digest> cube_;        // of those that hold anything
  struct Range {
    uint32_t first, end;
    Digest digest;
  };
  std::unordered_map<uint64_t, Range> patches_;      // by cube of 2^kCastLog cells
  Digest lamps_{};
};

}  // namespace ff::bake
