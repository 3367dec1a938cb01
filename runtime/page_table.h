// From a column (level, tile, index) to the slot that stands for it in the cut: the node itself where its tile is
// active, else its nearest active ancestor. As in virtual texturing, strips keep their own numbers and only this table
// follows the cut. Pages (256 slots, one tile's columns) are filled when they are first asked for.
#pragma once
#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "formats/reader.h"
#include "runtime/local_matrix.h"

namespace ff::runtime {

class PageTable {
 public:
  using Page = std::array<uint16_t, formats::kTileNodes>;

  // tiles: sorted by (level, tile), slots below kMaxSlots. outside: the slot of everything in inactive tiles; kNoSlot:
  // the nearest active ancestor.
  PageTable(const formats::World& world, std::span<const SlotRange> tiles, uint32_t outside = kNoSlot);

  // Number of the page of a tile, filling it if it is new.
  uint32_t pageOf(formats::TileId id);
  // Valid until the next pageOf().
  const Page& page(uint32_t number) const { return pages_[number]; }
  // Whether the tile is one of `tiles`; its slots are then consecutive.
  bool isActive(formats::TileId id) const;
  // Whether some node of the pages filled so far has no active ancestor (its slot reads 0).
  bool incomplete() const { return incomplete_; }

 private:
  struct Bucket {
    uint64_t key = 0;  // level and tile, + 1; 0: free
    uint32_t page = 0;
  };
  static uint64_t keyOf(formats::TileId id) { return (uint64_t{id.level} << 32 | id.tile) + 1; }
  size_t find(uint64_t key) const;  // the key's bucket, or the free one where it belongs
  void insert(uint64_t key, uint32_t page);
  uint32_t addPage(formats::TileId id);
  void fillFromAncestors(formats::TileId id, Page& page);

  const formats::World& world_;
  uint32_t outside_ = kNoSlot;
  uint32_t active_pages_ = 0;  // pages of active tiles come first
  bool incomplete_ = false;
  std::vector<Page> pages_;
  std::vector<Bucket> buckets_;  // open addressing, a power of two, at most half full
  size_t used_ = 0;
};

}  // namespace ff::runtime
