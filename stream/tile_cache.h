// Decoded strips within a budget of bytes. Wanted strips stay; the others are kept for the observer's return, within a budget of their own and until
// room is needed, and leave in the order in which they stopped being wanted. One thread; no call allocates or frees memory
// after construction: strips that leave are handed to the caller.
#pragma once
#include <cstdint>
#include <memory>
#include <vector>

#include "stream/resident_strip.h"
#include "stream/tile_map.h"

namespace ff::stream {

class TileCache {
 public:
  // max_tiles: at least as many as are wanted at any time, and one more.
  // kept_bytes: of unwanted strips.
  TileCache(uint64_t memory_bytes, uint64_t kept_bytes, size_t max_tiles);

  // Takes a strip, evicting unwanted ones if need be. An unwanted strip for which that would be needed is refused.
  // Wanted strips are always taken: whoever wants tiles keeps them within the budget.
  // leaving: evicted and refused strips are appended; needs room for max_tiles of them.
  void insert(StripPtr strip, bool wanted, std::vector<std::shared_ptr<const void>>& leaving);
  // Null if the tile is not here.
  const StripPtr& find(formats::TileId id) const {
    const auto at = places_.find(id);
    return at == places_.end() ? none_ : items_[at->second].strip;
  }
  // No effect on absent tiles. What then goes beyond kept_bytes stays until trim().
  void setWanted(formats::TileId id, bool wanted);
  // leaving: as for insert().
  void trim(std::vector<std::shared_ptr<const void>>& leaving) {
    while (unwanted_bytes_ > kept_bytes_) evictOldest(leaving);
  }

  uint64_t bytes() const { return bytes_; }
  uint64_t peakBytes() const { return peak_bytes_; }
  uint64_t evicted() const { return evicted_; }
  uint32_t tiles() const { return static_cast<uint32_t>(places_.size()); }

 private:
  static constexpr uint32_t kNone = 0xffffffffu;
  struct Item {
    StripPtr strip;
    uint64_t bytes = 0;
    uint32_t before = kNone, after = kNone;  // neighbours in the queue of unwanted strips
    bool wanted = false;
  };
  void evictOldest(std::vector<std::shared_ptr<const void>>& leaving);
  void enqueue(uint32_t place);
  void dequeue(uint32_t place);

  uint64_t memory_bytes_ = 0, kept_bytes_ = 0, unwanted_bytes_ = 0, bytes_ = 0, peak_bytes_ = 0, evicted_ = 0;
  const StripPtr none_;
  std::vector<Item> items_;
  std::vector<uint32_t> free_;                // items without a strip
  TileMap<uint32_t> places_;          // of the strips in items_
  uint32_t oldest_ = kNone, newest_ = kNone;  // unwanted; the oldest goes first
};

}  // namespace ff::stream
