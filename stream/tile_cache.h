// Decoded strips within a budget of bytes. Wanted strips stay; the others are kept for the observer's return until room
// is needed, and leave in the order in which they stopped being wanted. One thread; no call allocates or frees memory
// after construction: strips that leave are handed to the caller.
#pragma once
#include <cstdint>
#include <memory>
#include <vector>

#include "stream/resident_strip.h"
#include "stream/tile_numbers.h"

namespace ff::stream {

class TileCache {
 public:
  TileCache(const formats::World& world, uint64_t memory_bytes);

  // Takes a strip, evicting unwanted ones if need be. An unwanted strip for which that would be needed is refused.
  // Wanted strips are always taken: whoever wants tiles keeps them within the budget.
  // leaving: evicted and refused strips are appended; needs room for as many as there are tiles.
  void insert(StripPtr strip, bool wanted, std::vector<StripPtr>& leaving);
  // Null if the tile is not here.
  const StripPtr& find(formats::TileId id) const { return items_[numbers_.of(id)].strip; }
  // No effect on absent tiles.
  void setWanted(formats::TileId id, bool wanted);

  uint64_t bytes() const { return bytes_; }
  uint64_t peakBytes() const { return peak_bytes_; }
  uint64_t evicted() const { return evicted_; }
  uint32_t tiles() const { return tiles_; }

 private:
  static constexpr uint32_t kNone = 0xffffffffu;
  struct Item {
    StripPtr strip;
    uint64_t bytes = 0;
    uint32_t before = kNone, after = kNone;  // neighbours in the queue of unwanted strips
    bool wanted = false;
  };
  void enqueue(uint32_t number);
  void dequeue(uint32_t number);

  const TileNumbers numbers_;
  uint64_t memory_bytes_ = 0, bytes_ = 0, peak_bytes_ = 0, evicted_ = 0;
  uint32_t tiles_ = 0;
  std::vector<Item> items_;                   // by tile number
  uint32_t oldest_ = kNone, newest_ = kNone;  // unwanted; the oldest goes first
};

}  // namespace ff::stream
