// Tiles as devices take them up that resolve rows themselves: the words of TileJob (shaders/shared.h).
#pragma once
#include <cstdint>
#include <span>
#include <vector>

#include "runtime/cut/local_matrix.h"
#include "runtime/cut/page_table.h"

namespace ff::runtime {

// Where what of a tile lies, in words of 32 bits from its first.
struct PackedShape {
  uint32_t pages_at = 0, words_at = 0, words = 0;  // words: of all of it
};
PackedShape packedShape(const stream::ResidentStrip& strip, size_t partners);
// Writes that many words. bounds: of the tile. partner_pages: numbers of its partners' pages.
void writePacked(const LocalMatrix& matrix, const SlotRange& range, const Box& bounds, const stream::ResidentStrip& strip, std::span<const uint32_t> partner_pages, uint32_t* words);

// What a change brings, one after the other: a frame copies it as it is.
class PackedChange {
 public:
  static constexpr size_t kMostWords = 2 << 20;  // 8 MiB; what comes after them is written when it is taken up

  // Of a matrix that has pages. Memory grows to what the largest change so far took.
  void write(const LocalMatrix& matrix, const MatrixChange& change);
  // Of MatrixChange::entered[k]; empty: it was not written.
  std::span<const uint32_t> tile(size_t k) const { return k + 1 < tile_at_.size() ? std::span(words_).subspan(tile_at_[k], tile_at_[k + 1] - tile_at_[k]) : std::span<const uint32_t>(); }
  // Of MatrixChange::pages, in that order; all or none.
  std::span<const PageTable::Page> pages() const { return pages_; }

 private:
  formats::UnsetVector<uint32_t> words_;
  std::vector<size_t> tile_at_;  // in words_; the last one's end
  std::vector<PageTable::Page> pages_;
};

}  // namespace ff::runtime
