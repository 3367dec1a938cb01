// From nodes to the slots of a cut, and back.
#pragma once
#include <algorithm>
#include <cstdint>
#include <span>
#include <utility>
#include <vector>

#include "formats/read/reader.h"
#include "runtime/cut/local_matrix.h"

namespace ff::runtime {

// One thread. No call allocates after construction.
class SlotMap {
 public:
  explicit SlotMap(uint32_t max_slots = kMaxSlots) : tile_of_slot_(max_slots, kNone) { tiles_.reserve(kMaxSlots / 16); }
  uint32_t maxSlots() const { return static_cast<uint32_t>(tile_of_slot_.size()); }

  // tiles: as LocalMatrix::tiles.
  void follow(std::span<const SlotRange> tiles) {
    tiles_.assign(tiles.begin(), tiles.end());
    slots_follow_ = false;
  }

  std::span<const SlotRange> tiles() const { return tiles_; }
  // The active tile that holds a slot; null: none. Constant time, but for the first call after follow().
  const SlotRange* tileOf(uint32_t slot) {
    if (!std::exchange(slots_follow_, true)) {
      std::ranges::fill(tile_of_slot_, kNone);
      for (uint32_t t = 0; t < tiles_.size(); ++t) std::fill_n(tile_of_slot_.begin() + tiles_[t].first_slot, tiles_[t].nodes, t);
    }
    return slot < tile_of_slot_.size() && tile_of_slot_[slot] != kNone ? &tiles_[tile_of_slot_[slot]] : nullptr;
  }
  // Slot of node number `index` of a tile: its own, else its nearest active ancestor's; kNoSlot: it has none.
  uint32_t slotOf(const formats::TileRef& tile, uint32_t index) const { return slotFor(tiles_, tile, index); }

 private:
  static constexpr uint32_t kNone = 0xffffffffu;
  std::vector<SlotRange> tiles_;
  std::vector<uint32_t> tile_of_slot_;  // index in tiles_
  bool slots_follow_ = false;           // tile_of_slot_ is that of tiles_
};

}  // namespace ff::runtime
