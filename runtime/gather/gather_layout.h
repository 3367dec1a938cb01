// Where the packed rows of the cut's tiles (packed_rows.h) and the entries that they resolve to lie on a device. Bookkeeping of the Vulkan gather, without Vulkan.
#pragma once
#include <cstdint>
#include <span>
#include <vector>

#include "runtime/cut/local_matrix.h"
#include "runtime/cut/range_allocator.h"

namespace ff::runtime {

struct GatherRoom {
  uint64_t packed_words = 0;    // 32-bit
  uint64_t segment_vectors = 0; // entries that one binding holds, four to a vector
  uint32_t segments = 1;
  uint32_t tiles = 0;           // active at once, at most
};

class GatherLayout {
 public:
  struct Tile {
    SlotRange range;
    const stream::ResidentStrip* strip = nullptr;
    std::span<const uint32_t> partner_pages;
    uint64_t packed_at = 0, packed_words = 0;
    uint64_t entries_at = 0, entry_vectors = 0;
    uint32_t segment = 0;
    uint32_t pages_at = 0, words_at = 0;  // words from packed_at
    bool placed = false;                  // by the last update(): its packed words must be written
    bool entered = false;                 // was not there before the last update()
  };

  GatherLayout() = default;
  explicit GatherLayout(const GatherRoom& room);
  // Follows the matrix. afresh: nothing is known of the tiles before. Where room is fragmented all tiles are placed anew.
  // A matrix made by hand is packed here (256 slots a tile, pages in the order of slots), which allocates.
  // Errors (kOutOfDeviceMemory): no room; tiles() is then empty.
  Result<void> update(const LocalMatrix& matrix, const MatrixChange& change, bool afresh);
  // In the order of LocalMatrix::tiles; an ambient slot's comes last.
  std::span<const Tile> tiles() const { return tiles_; }

 private:
  void packByHand(const LocalMatrix& matrix);
  void listTiles(const LocalMatrix& matrix);
  bool place(Tile& tile);
  void forget();

  GatherRoom room_;
  RangeAllocator packed_{0};
  std::vector<RangeAllocator> segments_;
  std::vector<Tile> tiles_, next_tiles_;
  stream::ResidentStrip ambient_;
  std::vector<stream::ResidentStrip> by_hand_;
  std::vector<uint32_t> all_pages_;
};

}  // namespace ff::runtime
