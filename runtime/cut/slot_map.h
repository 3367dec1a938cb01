// From nodes to the slots of a cut, in constant time a level.
#pragma once
#include <cstdint>
#include <span>
#include <vector>

#include "formats/reader.h"
#include "runtime/cut/local_matrix.h"
#include "stream/tile_map.h"

namespace ff::runtime {

// One thread. No call allocates after construction.
class SlotMap {
 public:
  explicit SlotMap(const formats::World& world)
      : world_(world), tile_of_slot_(kMaxSlots, kNone) {
    tiles_.reserve(kMaxSlots);
    first_slot_.reserve(kMaxSlots);
  }

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
    return slot < kMaxSlots && tile_of_slot_[slot] != kNone ? &tiles_[tile_of_slot_[slot]] : nullptr;
  }
  // Slot of a node of tile `id`: its own, else its nearest active ancestor's; kNoSlot: it has none.
  uint32_t slotOf(formats::TileId id, uint32_t node) const {
    for (;;) {
      if (const auto at = first_slot_.find(id); at != first_slot_.end()) return at->second + node - world_.tiles(id.level)[id.tile].first_node;
      if (id.level + 1 == world_.levels().size()) return kNoSlot;
      node = world_.parent(id.level, node);
      id = {id.level + 1, world_.parentTile(id)};
    }
  }

 private:
  static constexpr uint32_t kNone = 0xffffffffu;
  const formats::World& world_;
  stream::TileMap<uint32_t> first_slot_;  // of active tiles
  std::vector<uint32_t> tile_of_slot_;  // index in tiles_
  std::vector<SlotRange> tiles_;
};

}  // namespace ff::runtime
