// From a column (level, tile, index) to the slot that stands for it in the cut: the node itself where its tile is
// active, else its nearest active ancestor. As in virtual texturing, strips keep their own numbers and only this table
// follows the cut. A page is the 256 slots of one tile's columns; pages exist for the tiles that someone holds, keep
// their numbers while held, and are filled anew only where the cut changed.
#pragma once
#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "runtime/cut/local_matrix.h"
#include "stream/tile_map.h"

namespace ff::runtime {

class PageTable {
 public:
  // Shared with devices, word for word (shaders::kPageWords).
  struct Page {
    uint32_t first_slot = 0;
    std::array<uint8_t, formats::kTileNodes> index{};  // column i has slot first_slot + index[i]: whatever stands for a tile's nodes is one tile, too
    uint32_t slot(uint32_t column) const { return first_slot + index[column]; }
    bool operator==(const Page&) const = default;
  };

  // outside: the slot of everything in inactive tiles; kNoSlot: the nearest active ancestor.
  explicit PageTable(const formats::World& world, uint32_t outside = kNoSlot);

  // The number of a tile's page, for as long as it is held; each hold is given back by release(). Who holds it keeps the tile's chunk.
  // tile: number within its level.
  uint32_t hold(const formats::Chunk& chunk, uint32_t tile);
  void release(uint32_t page);
  // The tile's nodes have slots first_slot, first_slot + 1, ... from now on; kNoSlot: none.
  void setActive(formats::TileId id, uint32_t first_slot);
  // Fills the pages that are new or whose slots the calls of setActive() changed. Their numbers, each once; valid until
  // the next call.
  std::span<const uint32_t> refresh();

  const Page& page(uint32_t number) const { return pages_[number]; }
  std::span<const Page> pages() const { return pages_; }
  // First slot of the page's tile if that is active (the page then counts up from it), else kNoSlot.
  uint32_t firstSlot(uint32_t number) const { return activeSlot(infos_[number].id); }
  bool changed(uint32_t number) const { return infos_[number].refreshed == round_; }
  uint32_t activeSlot(formats::TileId id) const {
    const auto at = slot_of_.find(id);
    return at == slot_of_.end() ? kNoSlot : at->second;
  }
  // Whether some node of the pages filled last has no active ancestor (its slot reads 0).
  bool incomplete() const { return incomplete_; }

 private:
  struct Info {
    formats::TileId id;
    const formats::Chunk* chunk = nullptr;
    uint32_t holds = 0;
    uint32_t refreshed = 0;  // round
    bool stale = false;
  };
  bool isBeneathToggled(const Info& info) const;
  void fill(const Info& info, Page& page);

  uint32_t outside_ = kNoSlot;
  bool incomplete_ = false;
  uint32_t round_ = 0;
  stream::TileMap<uint32_t> slot_of_;  // of active tiles
  stream::TileMap<uint32_t> page_of_;  // of tiles that are held
  std::vector<Page> pages_;
  std::vector<Info> infos_;
  std::vector<uint32_t> free_, changed_;
  stream::TileSet toggled_;     // tiles whose slots setActive() changed
  uint32_t toggled_levels_ = 0;  // theirs, a bit each
};

}  // namespace ff::runtime
