#include "runtime/page_table.h"

namespace ff::runtime {
namespace {

constexpr size_t kPagesAtFirst = 2048;  // 1 MiB

}  // namespace

PageTable::PageTable(const formats::World& world, uint32_t outside) : world_(world), outside_(outside) {
  for (const formats::LevelInfo& level : world.levels()) {
    slot_of_.emplace_back(level.tiles, kNoSlot);
    page_of_.emplace_back(level.tiles, kNoPage);
  }
  pages_.reserve(kPagesAtFirst);
  infos_.reserve(kPagesAtFirst);
  free_.reserve(kPagesAtFirst);
  changed_.reserve(kPagesAtFirst);
  toggled_.reserve(kPagesAtFirst);
}

uint32_t PageTable::hold(formats::TileId id) {
  uint32_t& number = page_of_[id.level][id.tile];
  if (number == kNoPage) {
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
  page_of_[info.id.level][info.id.tile] = kNoPage;
  info.stale = false;
  free_.push_back(page);
}

void PageTable::setActive(formats::TileId id, uint32_t first_slot) {
  slot_of_[id.level][id.tile] = first_slot;
  const formats::TileInfo& info = world_.tiles(id.level)[id.tile];
  Toggled toggled{id.level, {}};
  uint32_t first = info.first_node, end = info.first_node + info.nodes;
  for (uint32_t level = id.level;; --level) {
    toggled.nodes[level] = {first, end};
    if (level == 0) break;
    // Children of consecutive nodes are consecutive.
    const uint32_t last = end - 1;
    end = world_.children(level, last).second;
    first = world_.children(level, first).first;
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
    const formats::TileInfo& tile = world_.tiles(info.id.level)[info.id.tile];
    for (const Toggled& t : toggled_) {
      if (info.stale) break;
      const auto [first, end] = t.nodes[info.id.level];
      info.stale = info.id.level <= t.level && tile.first_node < end && first < tile.first_node + tile.nodes;
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
  uint32_t parent = formats::kNoParent, slot = 0;  // of the node before: siblings are consecutive
  for (uint32_t i = 0; i < info.nodes; ++i) {
    const uint32_t its_parent = world_.parent(id.level, info.first_node + i);
    if (its_parent != parent || i == 0) {
      parent = its_parent;
      slot = kNoSlot;
      uint32_t level = id.level + 1, node = parent;
      for (; level < world_.levels().size() && slot == kNoSlot; ++level) {
        const uint32_t tile = world_.tileOf(level, node);
        const uint32_t first = activeSlot({level, tile});
        if (first != kNoSlot)
          slot = first + (node - world_.tiles(level)[tile].first_node);
        else
          node = world_.parent(level, node);
      }
      if (slot == kNoSlot) {
        incomplete_ = true;
        slot = 0;
      }
    }
    page[i] = static_cast<uint16_t>(slot);
  }
}

}  // namespace ff::runtime
