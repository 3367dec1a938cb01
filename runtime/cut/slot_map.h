// From nodes to the slots of a cut, in constant time a level.
#pragma once
#include <cstdint>
#include <span>
#include <vector>

#include "formats/read/reader.h"
#include "runtime/cut/local_matrix.h"
#include "stream/tile_map.h"

namespace ff::runtime {

// One thread. No call allocates after construction.
class SlotMap {
 public:
  explicit SlotMap(uint32_t max_slots = kMaxSlots) : tile_of_slot_(max_slots, kNone) {
    tiles_.reserve(max_slots);
    first_slot_.reserve(max_slots);
  }
  uint32_t maxSlots() const { return static_cast<uint32_t>(tile_of_slot_.size()); }

  void follow(std::span<const SlotRange> tiles) {
    for (const SlotRange& old : tiles_) {
      first_slot_.erase(old.id);
      for (uint32_t i = 0; i < old.nodes; ++i) tile_of_slot_[old.first_slot + i] = kNone;
    }
    tiles_.assign(tiles.begin(), tiles.end());
    for (uint32_t t = 0; t < tiles_.size(); ++t) {
      first_slot_[tiles_[t].id] = tiles_[t].first_slot;
      for (uint32_t i = 0; i < tiles_[t].nodes; ++i) tile_of_slot_[tiles_[t].first_slot + i] = t;
    }
  }

  std::span<const SlotRange> tiles() const { return tiles_; }
  // The active tile that holds a slot; null: none.
  const SlotRange* tileOf(uint32_t slot) const {
    return slot < tile_of_slot_.size() && tile_of_slot_[slot] != kNone ? &tiles_[tile_of_slot_[slot]] : nullptr;
  }
  // Slot of node number `index` of a tile: its own, else its nearest active ancestor's; kNoSlot: it has none.
  uint32_t slotOf(const formats::TileRef& tile, uint32_t index) const {
    uint32_t at_tile = tile.index;
    for (const formats::Chunk* chunk = tile.chunk.get();;) {
      if (const auto at = first_slot_.find(chunk->tiles[at_tile].id); at != first_slot_.end()) return at->second + index;
      if (chunk->isTop()) return kNoSlot;
      index = chunk->parentIndexOf(at_tile)[index];
      const uint32_t parent = chunk->tiles[at_tile].parent_tile;
      chunk = chunk->parent.get();
      at_tile = parent - chunk->firstTile();
    }
  }

 private:
  static constexpr uint32_t kNone = 0xffffffffu;
  stream::TileMap<uint32_t> first_slot_;  // of active tiles
  std::vector<uint32_t> tile_of_slot_;  // index in tiles_
  std::vector<SlotRange> tiles_;
};

}  // namespace ff::runtime
