#include "runtime/gather/gather_layout.h"

#include <algorithm>
#include <functional>
#include <string>

#include "runtime/cut/packed_rows.h"
#include "shaders/shared.h"

namespace ff::runtime {
namespace {

constexpr uint32_t kNoLevel = 0xffffffffu;  // of the ambient slot's tile: sorts behind all others

}  // namespace

GatherLayout::GatherLayout(const GatherRoom& room) : room_(room) {
  tiles_.reserve(room.tiles);
  next_tiles_.reserve(room.tiles);
  ambient_.id = {kNoLevel, 0};
  ambient_.run_start = ambient_.row_start = {0, 0};
  packed_ = RangeAllocator(room_.packed_words);
  segments_.reserve(room_.segments);
  for (uint32_t s = 0; s < room_.segments; ++s) segments_.emplace_back(room_.segment_vectors);  // a copy has no reserve
}

void GatherLayout::forget() {
  packed_.reset();
  for (RangeAllocator& segment : segments_) segment.reset();
}

Result<void> GatherLayout::update(const LocalMatrix& matrix, const MatrixChange& change, bool afresh) {
  const bool by_hand = !matrix.pages;
  if (by_hand) packByHand(matrix);
  if (afresh || by_hand) {
    tiles_.clear();
    forget();
  }
  listTiles(matrix);
  if (next_tiles_.size() > room_.tiles) {
    tiles_.clear();
    return Error{ErrorCode::kIo,
                 "",
                 "vulkan",
                 std::to_string(next_tiles_.size()) + " tiles in the cut, room was made for " + std::to_string(room_.tiles),
                 "raise the capacity",
                 ErrorCause::kOutOfDeviceMemory};
  }
  // Both lists are sorted: those that left give their room back first. A tile may leave and enter at once.
  const auto stayed = [&](size_t tile) { return !std::ranges::binary_search(change.entered, static_cast<uint32_t>(tile), std::greater{}); };
  size_t next = 0;
  for (Tile& old : tiles_) {
    while (next < next_tiles_.size() && next_tiles_[next].range.id < old.range.id) ++next;
    if (next < next_tiles_.size() && next_tiles_[next].range.id == old.range.id && stayed(next)) {
      Tile& same = next_tiles_[next];
      const Tile fresh = same;
      same = old;
      same.strip = fresh.strip;
      same.partner_pages = fresh.partner_pages;
      same.placed = same.entered = false;
    } else {
      packed_.release(old.packed_at, old.packed_words);
      segments_[old.segment].release(old.entries_at, old.entry_vectors);
    }
  }
  tiles_.swap(next_tiles_);
  for (Tile& tile : tiles_) {
    if (!tile.entered || place(tile)) continue;
    forget();
    for (Tile& again : tiles_) {
      if (place(again)) continue;
      const uint64_t words = room_.packed_words, vectors = room_.segment_vectors * room_.segments;
      tiles_.clear();
      return Error{ErrorCode::kIo,
                   "",
                   "vulkan",
                   "the cut does not fit the room that was made for it: " + std::to_string(words >> 18) +
                       " MiB of packed rows, " + std::to_string(vectors >> 16) + " MiB of entries",
                   "raise the capacity, or lower the radius",
                   ErrorCause::kOutOfDeviceMemory};
    }
    break;
  }
  return {};
}

void GatherLayout::listTiles(const LocalMatrix& matrix) {
  next_tiles_.clear();
  const auto add = [&](const SlotRange& range, const stream::ResidentStrip& strip, std::span<const uint32_t> pages) {
    Tile tile;
    tile.range = range;
    tile.strip = &strip;
    tile.partner_pages = pages;
    tile.entered = true;
    next_tiles_.push_back(tile);
  };
  for (size_t t = 0; t < by_hand_.size() && !matrix.pages; ++t) {
    const auto nodes = static_cast<uint32_t>(by_hand_[t].row_start.size() - 1);
    add({by_hand_[t].id, static_cast<uint32_t>(by_hand_[t].first_node), by_hand_[t].first_node, nodes}, by_hand_[t], all_pages_);
  }
  for (size_t t = 0; t < matrix.packed.size(); ++t)
    add(matrix.tiles[t], *matrix.packed[t].strip, matrix.packed[t].partner_pages);
  if (matrix.ambient_slot != kNoSlot) add({ambient_.id, matrix.ambient_slot, 0, 1}, ambient_, {});
}

bool GatherLayout::place(Tile& tile) {
  const stream::ResidentStrip& strip = *tile.strip;
  const uint32_t nodes = tile.range.nodes, words = strip.row_start[nodes];
  const PackedShape shape = packedShape(strip, tile.partner_pages.size());
  tile.pages_at = shape.pages_at;
  tile.words_at = shape.words_at;
  tile.packed_words = shape.words;
  tile.entry_vectors = (words + shaders::kEntriesPerLoad - 1) / shaders::kEntriesPerLoad + nodes;
  const auto packed_at = packed_.allocate(tile.packed_words, 1);
  if (!packed_at) return false;
  for (uint32_t s = 0; s < room_.segments; ++s) {
    const auto entries_at = segments_[s].allocate(tile.entry_vectors, 1);
    if (!entries_at) continue;
    tile.packed_at = *packed_at;
    tile.entries_at = *entries_at;
    tile.segment = s;
    tile.placed = true;
    return true;
  }
  packed_.release(*packed_at, tile.packed_words);
  return false;
}

// Every entry becomes a run of its own, in as many words as its count needs.
void GatherLayout::packByHand(const LocalMatrix& matrix) {
  by_hand_.clear();
  all_pages_.clear();
  for (uint32_t page = 0; page * formats::kTileNodes < matrix.slots(); ++page) all_pages_.push_back(page);
  for (uint32_t first = 0; first < matrix.slots(); first += formats::kTileNodes) {
    const uint32_t end = std::min(first + formats::kTileNodes, matrix.slots());
    stream::ResidentStrip& strip = by_hand_.emplace_back();
    strip.id = {0, first / formats::kTileNodes};
    strip.first_node = first;
    strip.run_start = strip.row_start = {0};
    for (uint32_t slot = first; slot < end; ++slot) {
      for (const uint32_t entry : matrix.row(slot)) {
        const uint32_t column = slotOfEntry(entry);
        uint32_t words = 0;
        for (uint32_t left = countOfEntry(entry); left > 0; ++words) {
          const uint32_t count = std::min(left, 255u);
          strip.words.push_back(static_cast<uint16_t>(column % formats::kTileNodes << 8 | count));
          left -= count;
        }
        strip.runs.push_back({static_cast<uint16_t>(column / formats::kTileNodes), static_cast<uint16_t>(words)});
      }
      strip.run_start.push_back(static_cast<uint32_t>(strip.runs.size()));
      strip.row_start.push_back(static_cast<uint32_t>(strip.words.size()));
    }
  }
}

}  // namespace ff::runtime
