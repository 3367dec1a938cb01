#include "runtime/cut/page_table.h"

#include <algorithm>
#include <tuple>

namespace ff::runtime {
namespace {

constexpr size_t kPagesAtFirst = 8192;  // 4 MiB; or those of the whole world

}  // namespace

PageTable::PageTable(const formats::World& world, uint32_t outside) : world_(world), outside_(outside) {
  size_t pages = 0;
  for (const formats::LevelInfo& level : world.levels()) pages += level.tiles;
  pages = std::min(pages, kPagesAtFirst);
  slot_of_.reserve(pages);
  page_of_.reserve(pages);
  pages_.reserve(pages);
  infos_.reserve(pages);
  free_.reserve(pages);
  changed_.reserve(pages);
  toggled_.reserve(kPagesAtFirst);
}

uint32_t PageTable::hold(formats::TileId id) {
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
    infos_[number] = {id, 0, infos_[number].refreshed, true};
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
  Toggled toggled{id.level, {}};
  uint32_t first = id.tile, end = id.tile + 1;
  for (uint32_t level = id.level;; --level) {
    toggled.tiles[level] = {first, end};
    if (level == 0) break;
    std::tie(first, end) = world_.childTiles(level, first, end);
  }
  toggled_.push_back(toggled);
}

std::span<const uint32_t> PageTable::refresh() {
  ++round_;
  changed_.clear();
  incomplete_ = false;
  for (uint32_t p = 0; p < pages_.size(); ++p) {
    Info& info = infos_[p];
    if (info.holds == 0) continue;
    for (const Toggled& t : toggled_) {
      if (info.stale) break;
      const auto [first, end] = t.tiles[info.id.level];
      info.stale = info.id.level <= t.level && first <= info.id.tile && info.id.tile < end;
    }
    if (!info.stale) continue;
    fill(info.id, pages_[p]);
    info.stale = false;
    info.refreshed = round_;
    changed_.push_back(p);
  }
  toggled_.clear();
  return changed_;
}

void PageTable::fill(formats::TileId id, Page& page) {
  const formats::TileInfo& info = world_.tiles(id.level)[id.tile];
  if (const uint32_t first = activeSlot(id); first != kNoSlot) {
    for (uint32_t i = 0; i < info.nodes; ++i) page[i] = static_cast<uint16_t>(first + i);
    return;
  }
  if (outside_ != kNoSlot) {
    page.fill(static_cast<uint16_t>(outside_));
    return;
  }
  // The ancestors of all of the tile's nodes lie in one tile a level: the lowest active one has their slots.
  std::array<formats::TileId, formats::kMaxLevels> up;
  uint32_t steps = 0, slots = kNoSlot;
  for (formats::TileId at = id; slots == kNoSlot && at.level + 1 < world_.levels().size(); slots = activeSlot(at))
    up[steps++] = at = {at.level + 1, world_.parentTile(at)};
  if (slots == kNoSlot) {
    incomplete_ = true;
    page.fill(0);
    return;
  }
  for (uint32_t i = 0; i < info.nodes; ++i) {
    uint32_t level = id.level, node = info.first_node + i, place = 0;
    for (uint32_t step = 0; step < steps; ++step, ++level) {
      place = world_.placeOfParent(level, node);
      node = world_.tiles(level + 1)[up[step].tile].first_node + place;
    }
    page[i] = static_cast<uint16_t>(slots + place);
  }
}

}  // namespace ff::runtime
