#include "runtime/cut/cut_choice.h"

#include <algorithm>

namespace ff::runtime {
namespace {

using stream::StripPtr;

constexpr size_t kCrowd_percent = 50;  // of max_nodes: past it those that show least hurry, the more the less they show, so that few have to leave at once

}  // namespace

CutChoice::CutChoice(uint32_t max_nodes, uint32_t max_slots) : max_nodes_(max_nodes), max_slots_(max_slots) {
  leaving_.reserve(kMaxSlots / 16);
  order_.reserve(kMaxSlots / 16);
}

void CutChoice::choose(std::span<const StripPtr> active, std::span<const StripPtr> before, std::span<const SlotRange> tiles, std::span<const float> own, std::vector<StripPtr>& cut,
                       std::vector<FadingTile>& fading) {
  cut.clear();
  fading.clear();
  leaving_.clear();
  if (!own.empty()) {
    listLeaving(active, before, tiles, own);
    keepTheMost(active);
  }
  size_t a = 0;
  for (const Leaving& leaving : leaving_) {
    if (!leaving.kept) continue;
    for (; a < active.size() && active[a]->id < leaving.tile.id; ++a) cut.push_back(active[a]);
    cut.push_back(before[leaving.at]);
    fading.push_back(leaving.tile);
  }
  cut.insert(cut.end(), active.begin() + static_cast<ptrdiff_t>(a), active.end());
}

// Tiles of the matrix that are active no more, kept as long as they or their descendants show anything.
void CutChoice::listLeaving(std::span<const StripPtr> active, std::span<const StripPtr> before, std::span<const SlotRange> tiles, std::span<const float> own) {
  size_t a = 0, t = 0;
  for (uint32_t k = 0; k < before.size(); ++k) {
    const stream::ResidentStrip& strip = *before[k];
    while (a < active.size() && active[a]->id < strip.id) ++a;
    if (a < active.size() && active[a]->id == strip.id) continue;
    while (t < tiles.size() && tiles[t].id < strip.id) ++t;
    if (t == tiles.size() || tiles[t].id != strip.id) continue;  // one that leaves before it was ever there just goes
    leaving_.push_back({k, {strip.id, own[t]}, {strip.id.level + 1, strip.tile.info().parent_tile}, static_cast<uint32_t>(strip.nodes.size()), own[t] > 0});
  }
  for (const Leaving& leaving : leaving_) {  // children first: the finest levels come first
    if (!leaving.kept) continue;
    const auto above = std::ranges::lower_bound(leaving_, leaving.parent, {}, [](const Leaving& l) { return l.tile.id; });
    if (above == leaving_.end() || above->tile.id != leaving.parent) continue;
    above->kept = true;
    above->tile.weight = std::max(above->tile.weight, leaving.tile.weight);
  }
}

// Within max_nodes, and what slots there are: those that show most, parents before their children.
void CutChoice::keepTheMost(std::span<const StripPtr> active) {
  size_t wanted = 0, nodes = 0;
  for (const StripPtr& strip : active) wanted += strip->nodes.size();
  const size_t slots = max_slots_ - max_slots_ / 16;  // so that a tile that enters finds consecutive ones
  const size_t room = std::min<size_t>(max_nodes_, wanted < slots ? slots - wanted : 0);
  order_.clear();
  for (uint32_t k = 0; k < leaving_.size(); ++k)
    if (leaving_[k].kept) {
      order_.push_back(k);
      nodes += leaving_[k].nodes;
    }
  const size_t crowd = room * kCrowd_percent / 100;
  if (nodes <= crowd) return;
  std::ranges::sort(order_, [&](uint32_t x, uint32_t y) {  // of two that show as much, the coarser first
    const float a = leaving_[x].tile.weight, b = leaving_[y].tile.weight;
    return a != b ? a > b : x > y;
  });
  nodes = 0;
  for (const uint32_t k : order_) {
    nodes += leaving_[k].nodes;
    leaving_[k].kept = nodes <= room;
    if (nodes > crowd) leaving_[k].tile.hurry = std::min(static_cast<float>(nodes - crowd) / static_cast<float>(room - crowd), 1.0f);
  }
}

}  // namespace ff::runtime
