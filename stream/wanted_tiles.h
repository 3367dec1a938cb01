// Which tiles the observer wants: a best-first walk down the hierarchy that visits only what it admits and its
// children.
#pragma once
#include <algorithm>
#include <cstdint>
#include <span>
#include <vector>

#include "stream/streamer.h"

namespace ff::stream {

// Bytes in memory, at most, of a tile that is not decoded yet.
uint64_t residentBytesBound(const formats::World& world, const formats::TileInfo& info);

// The wanted set; walks allocate nothing, but for a heap that outgrows kHeapAtFirst once. The top level is always wanted; another tile when its parent tile is and its bounds
// are within its level's radius of the observer (times hysteresis if the walk before wanted it).
// Tiles are admitted in order of distance over radius (their own or an ancestor's, whichever is larger), so a budget
// that runs out acts as a smaller radius_m: max_nodes and memory_bytes end the walk, max_level0_nodes only closes level
// 0.
class WantedTiles {
 public:
  WantedTiles(const formats::World& world, const StreamSettings& settings);

  // Wanted tiles sorted by (level, tile). Valid until the next walk.
  std::span<const formats::TileId> walk(Vec3 observer);
  bool isWanted(formats::TileId id) const { return std::ranges::binary_search(wanted_, id); }
  // Tiles of a walk, at most.
  size_t mostWanted() const { return most_wanted_; }
  float radius(uint32_t level) const { return radius_m_[level]; }

 private:
  struct Candidate {
    float key = 0;  // distance over radius
    formats::TileId id;
    // For a heap whose front is next: nearest first, then the coarser level, then the lower tile.
    friend bool operator<(const Candidate& a, const Candidate& b) {
      if (a.key != b.key) return a.key > b.key;
      if (a.id.level != b.id.level) return a.id.level < b.id.level;
      return a.id.tile > b.id.tile;
    }
  };
  void admit(const formats::TileInfo& info, Vec3 observer);
  void offerChildren(const formats::TileInfo& parent, Vec3 observer);

  const formats::World& world_;
  const StreamSettings settings_;
  size_t most_wanted_ = 0;
  std::vector<float> radius_m_;  // per level
  std::vector<Candidate> heap_;
  std::vector<formats::TileId> wanted_, wanted_before_;  // by the last walk, by the one before; sorted
  uint64_t bytes_ = 0;
  uint32_t nodes_ = 0, level0_nodes_ = 0;
  bool level0_closed_ = false;
};

}  // namespace ff::stream
