// Decoded strips within a budget of bytes. Wanted strips stay; the others are kept for the observer's return until room
// is needed, and leave in the order in which they stopped being wanted. One thread.
#pragma once
#include <cstdint>
#include <list>
#include <memory>
#include <unordered_map>

#include "formats/layout.h"

namespace ff::stream {

class TileCache {
 public:
  using StripPtr = std::shared_ptr<const formats::Strip>;
  explicit TileCache(uint64_t memory_bytes) : memory_bytes_(memory_bytes) {}

  // Takes a strip, evicting unwanted ones if need be. An unwanted strip for which that would be needed is refused.
  // Wanted strips are always taken: whoever wants tiles keeps them within the budget.
  bool insert(StripPtr strip, bool wanted);
  // Null if the tile is not here.
  StripPtr find(formats::TileId id) const;
  // No effect on absent tiles.
  void setWanted(formats::TileId id, bool wanted);

  uint64_t bytes() const { return bytes_; }
  uint64_t peakBytes() const { return peak_bytes_; }
  uint64_t evicted() const { return evicted_; }
  size_t tiles() const { return items_.size(); }

 private:
  struct Item {
    StripPtr strip;
    uint64_t bytes = 0;
    bool wanted = false;
    std::list<uint64_t>::iterator queued;  // in unwanted_, if not wanted
  };
  static uint64_t keyOf(formats::TileId id) { return uint64_t{id.level} << 32 | id.tile; }

  uint64_t memory_bytes_ = 0, bytes_ = 0, peak_bytes_ = 0, evicted_ = 0;
  std::unordered_map<uint64_t, Item> items_;
  std::list<uint64_t> unwanted_;  // keys, first to go first
};

}  // namespace ff::stream
