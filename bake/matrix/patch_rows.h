// What stands between rays and the rows of level 0: hits are put aside as they are cast, and pooled once all are there.
#pragma once
#include <cstdint>
#include <mutex>
#include <span>
#include <string>
#include <vector>

#include "bake/light/hit_rows.h"
#include "bake/matrix/level_rows.h"
#include "bake/matrix/pyramid.h"
#include "bake/matrix/row_samples.h"
#include "bake/spill.h"
#include "bake/work_count.h"

namespace ff::bake {

// Where rays ended, in the order in which they were cast.
class PutAside {
 public:
  // path, memory_bytes: Spill's.
  PutAside(size_t patches, const std::string& path, uint64_t memory_bytes) : sight(patches), pooling_bytes_(patches), spill_(path, memory_bytes) {}

  // Thread-safe for different patches.
  void put(uint32_t first, const HitRows& rows);

  size_t ranges() const { return ranges_.size(); }
  // What put() was given; once for each. Thread-safe for different ones.
  std::pair<uint32_t, HitRows> take(size_t range);
  // What a patch's row takes while it is pooled, B, about; once all are put.
  uint32_t poolingBytes(size_t patch) const { return pooling_bytes_[patch]; }
  uint64_t spilled() const { return spill_.written(); }
  // Of all ranges, the heaviest first; once all are put.
  std::vector<Leak> leaks(float cell_m, size_t most) const;

  PagedVector<PatchSight> sight;  // by patch

 private:
  struct Range {
    uint32_t first;
    Spill::Block block;
    std::vector<Leak> leaks;
  };
  std::mutex mutex_;
  PagedVector<uint32_t> pooling_bytes_;  // by patch
  Spill spill_;
  std::vector<Range> ranges_;
};

// What the rows of patches are made of beside hits. By patch: patches, whose area is the exposed one, whole_area, m2, and sun. By node: patch_of, and density of
// rays, 1/m2. All outlive what is made.
struct PatchRowSource {
  std::span<const Patch> patches;
  std::span<const float> whole_area;
  std::span<const SunLight> sun;
  std::span<const uint32_t> patch_of;
  std::span<const double> density;
};

// Fills the rows of level 0; returns what its patches reflect once light has bounced twice, by node, as rowFactor() asks for it. memory_bytes: most that the
// process may hold, or 0: what is free; what does not fit goes to files named after `path`, of which `spilled` grows by the size. done: counts ranges, and tiles twice.
PagedVector<LightValues> poolPatches(const PatchRowSource& source, const Hierarchy& hierarchy, PutAside& hits, const std::string& path, uint64_t memory_bytes,
                                     LevelRows& rows, WorkCount& done, uint64_t& spilled);

}  // namespace ff::bake
