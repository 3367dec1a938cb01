// What stands where, as digests: what rays can meet in each cube of the world, whatever patches that is cut into, and the patches of small cubes. Equal
// digests of where rays went and of the patches that they met: they find the same, whatever it emits (lamp_digests.h).
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

inline constexpr int kCubeLog = 1;  // cells a side, at least; more where the box would have more than kMaxCubes
inline constexpr double kMaxCubes = 1 << 26;
inline constexpr int kMetLog = 1;   // cells a side of a cube whose patches are looked at together, log2

class Contents {
 public:
  // On all of TBB's threads. Both outlive it.
  Contents(const Scene& scene, const PatchSet& set);

  // Holds the scene and some air around it.
  const CubeBox& box() const { return box_; }
  // Appends what is held by cubes of a block, whose first cube may be in the box or not: place and digest of each that holds anything. place: of the
  // block's first cube.
  void append(const CubeBox::Cube& block, uint64_t cubes, uint64_t place, std::vector<Digest>& held) const;
  // Of the patches whose cells lie in a cube of 2^kMetLog cells, by its Hilbert key: names, orientations and corners, in order. Zeros: there are none.
  Digest patchesIn(uint64_t key) const;
  // Of patches [first, end): all that a ray that starts on them depends on, or that is aimed at them.
  Digest surface(uint32_t first, uint32_t end) const;

  // All blocks' digests, for changesSince().
  std::vector<std::byte> encoded() const;
  // Middles of blocks, m, that hold something else than they did when `before` was encoded; none where that is of other cubes.
  std::vector<Vec3> changesSince(std::span<const std::byte> before) const;

  // The first patch of a cube of 2^kMetLog cells, and one after the last; both 0 where there are none.
  std::pair<uint32_t, uint32_t> rangeOf(uint64_t key) const;

 private:
  struct Block {
    uint64_t held = 0;  // cubes that hold anything, a bit each
    size_t first = 0;   // of their digests, in held_
  };

  struct Range {
    uint64_t key;
    uint32_t first, end;
    Digest digest;
  };

  void addPieces();
  const Range* find(uint64_t key) const;  // null: no patches
  uint64_t blockDigest(const Block& block) const;
  uint64_t materialDigest(const Material& material) const;
  uint64_t triangleDigest(uint32_t t) const;

  const Scene& scene_;
  const PatchSet& set_;
  CubeBox box_;
  PagedVector<uint64_t> material_, triangle_;        // digests
  PagedVector<uint64_t> held_;                       // digests of cubes that hold anything
  std::unordered_map<uint32_t, Block> blocks_;       // those that hold anything
  PagedVector<Range> patches_;                       // by cube of 2^kMetLog cells, ascending
};

}  // namespace ff::bake
