#include "runtime/cut/packed_rows.h"

#include <algorithm>
#include <bit>

#include "shaders/shared.h"

namespace ff::runtime {

PackedShape packedShape(const stream::ResidentStrip& strip, size_t partners) {
  const auto nodes = static_cast<uint32_t>(strip.row_start.size() - 1);
  PackedShape shape;
  shape.pages_at = 2 * (nodes + 1) + shaders::kNodeWords * nodes + strip.run_start[nodes];
  shape.words_at = shape.pages_at + static_cast<uint32_t>(partners);
  shape.words = shape.words_at + (strip.row_start[nodes] + 1) / 2 + shaders::kPlaceWords;
  return shape;
}

void writePacked(const LocalMatrix& matrix, const SlotRange& range, const Box& bounds, const stream::ResidentStrip& strip, std::span<const uint32_t> partner_pages, uint32_t* words) {
  uint32_t* at = std::copy(strip.run_start.begin(), strip.run_start.end(), words);
  at = std::copy(strip.row_start.begin(), strip.row_start.end(), at);
  for (uint32_t slot = range.first_slot; slot < range.first_slot + range.nodes; ++slot) {
    const Vec4& albedo = matrix.albedo[slot];
    for (const float value : {albedo.x, albedo.y, albedo.z, matrix.area_m2[slot], matrix.row_scale[slot]})
      *at++ = std::bit_cast<uint32_t>(value);
    *at++ = matrix.parent_slot[slot];
    *at++ = matrix.next_sibling[slot];
  }
  for (const auto& run : strip.runs) *at++ = uint32_t{run.words} << 16 | run.partner;
  at = std::copy(partner_pages.begin(), partner_pages.end(), at);
  for (size_t w = 0; w < strip.words.size(); w += 2)
    *at++ = strip.words[w] | (w + 1 < strip.words.size() ? uint32_t{strip.words[w + 1]} << 16 : 0u);
  for (const Vec3& corner : {bounds.lo, bounds.hi})
    for (const float x : {corner.x, corner.y, corner.z}) *at++ = std::bit_cast<uint32_t>(x);
  *at = range.id.level;
}

void PackedChange::write(const LocalMatrix& matrix, const MatrixChange& change) {
  words_.clear();
  tile_at_.assign(1, 0);
  for (const uint32_t t : change.entered) {
    const LocalMatrix::PackedRows& rows = matrix.packed[t];
    const PackedShape shape = packedShape(*rows.strip, rows.partner_pages.size());
    const size_t at = words_.size();
    if (at + shape.words > kMostWords) break;
    words_.resize(at + shape.words);
    writePacked(matrix, matrix.tiles[t], matrix.places[t].bounds, *rows.strip, rows.partner_pages, words_.data() + at);
    tile_at_.push_back(words_.size());
  }
  pages_.clear();
  if (change.pages.size() * sizeof(PageTable::Page) > kMostWords * sizeof(uint32_t)) return;
  for (const uint32_t page : change.pages) pages_.push_back(matrix.pages->page(page));
}

}  // namespace ff::runtime
