#include "runtime/cut/page_table.h"

#include <algorithm>
#include <bit>

namespace ff::runtime {
namespace {

constexpr size_t kPagesAtFirst = 8192;  // 2 MiB; or those of the whole world

}  // namespace

PageTable::PageTable(const formats::World& world, uint32_t outside) : outside_(outside) {
  size_t pages = 0;
  for (const formats::LevelInfo& level : world.levels()) pages += level.tiles;
  pages = std::min(pages, kPagesAtFirst);
  slot_of_.reserve(pages);
  page_of_.reserve(pages);
  pages_.reserve(pages);
  infos_.reserve(pages);
  free_.reserve(pages);
  changed_.reserve(pages);
  toggled_.reserve(pages);
}

uint32_t PageTable::hold(const formats::Chunk& chunk, uint32_t tile) {
  const formats::TileId id{chunk.level, tile};
  const auto [at, is_new] = page_of_.insert({id, 0});
  uint32_t& number = at.value();
  if (is_new) {
    if (free_.empty()) {
      free_.push_back(static_cast<uint32_t>(pages_.size()));
      pages_.emplace_back();
      infos_.emplace_back();
    }
    number = free_.back();
    free_.pop_back();
    infos_[number] = {id, &chunk, 0, infos_[number].refreshed, true};
  }
  ++infos_[number].holds;
  return number;
}

void PageTable::release(uint32_t page) {
  Info& info = infos_[page];
  if (--info.holds > 0) return;
  page_of_.erase(info.id);
  info.stale = false;
  free_.push_back(page);
}

void PageTable::setActive(formats::TileId id, uint32_t first_slot) {
  if (first_slot == kNoSlot)
    slot_of_.erase(id);
  else
    slot_of_[id] = first_slot;
  toggled_.insert(id);
  toggled_levels_ |= 1u << id.level;
}

// Whether a tile or one of its ancestors is among toggled_.
bool PageTable::isBeneathToggled(const Info& info) const {
  const auto end = static_cast<uint32_t>(std::bit_width(toggled_levels_));
  formats::TileId at = info.id;
  for (const formats::Chunk* chunk = info.chunk;; chunk = chunk->parent.get()) {
    if ((toggled_levels_ >> at.level & 1) != 0 && toggled_.contains(at)) return true;
    if (at.level + 1 >= end || chunk->isTop()) return false;
    at = {at.level + 1, chunk->tiles[at.tile - chunk->firstTile()].parent_tile};
  }
}

std::span<const uint32_t> PageTable::refresh() {
  ++round_;
  changed_.clear();
  incomplete_ = false;
  for (uint32_t p = 0; p < pages_.size(); ++p) {
    Info& info = infos_[p];
    if (info.holds == 0) continue;
    if (!info.stale && (toggled_levels_ >> info.id.level == 0 || !isBeneathToggled(info))) continue;
    fill(info, pages_[p]);
    info.stale = false;
    info.refreshed = round_;
    changed_.push_back(p);
  }
  if (!toggled_.empty()) toggled_.clear();
  toggled_levels_ = 0;
  return changed_;
}

void PageTable::fill(const Info& info, Page& page) {
  const uint32_t own = info.id.tile - info.chunk->firstTile(), nodes = info.chunk->tiles[own].nodes;
  if (const uint32_t first = activeSlot(info.id); first != kNoSlot) {
    page.first_slot = first;
    for (uint32_t i = 0; i < nodes; ++i) page.index[i] = static_cast<uint8_t>(i);
    return;
  }
  if (outside_ != kNoSlot) {
    page.first_slot = outside_;
    page.index.fill(0);
    return;
  }
  // The ancestors of all of the tile's nodes lie in one tile a level: the lowest active one has their slots.
  std::array<std::span<const uint8_t>, formats::kMaxLevels> up;  // from a tile's nodes to its parent tile's
  uint32_t steps = 0, slots = kNoSlot, tile = own;
  for (const formats::Chunk* chunk = info.chunk; slots == kNoSlot && !chunk->isTop();) {
    up[steps++] = chunk->parentIndexOf(tile);
    const uint32_t parent = chunk->tiles[tile].parent_tile;
    chunk = chunk->parent.get();
    tile = parent - chunk->firstTile();
    slots = activeSlot({chunk->level, parent});
  }
  if (slots == kNoSlot) {
    incomplete_ = true;
    page = {};
    return;
  }
  page.first_slot = slots;
  for (uint32_t i = 0; i < nodes; ++i) {
    uint32_t index = i;
    for (uint32_t step = 0; step < steps; ++step) index = up[step][index];
    page.index[i] = static_cast<uint8_t>(index);
  }
}

}  // namespace ff::runtime
