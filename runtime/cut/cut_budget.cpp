#include "runtime/cut/cut_budget.h"

#include <algorithm>

#include "runtime/cut/local_matrix.h"

namespace ff::runtime {

using stream::StripPtr;

CutBudget::CutBudget(const formats::World& world, uint32_t tiles) : world_(world), tiles_(tiles) {
  if (tiles == 0) return;
  entering_.reserve(kMaxSlots / 16);
  kept_.reserve(kMaxSlots / 16);
  cut_.reserve(kMaxSlots / 16);
}

std::span<const StripPtr> CutBudget::limit(std::span<const StripPtr> wanted, std::span<const StripPtr> there, const stream::Observers& observers) {
  waiting_ = 0;
  if (tiles_ == 0 || std::ranges::equal(wanted, there)) return wanted;
  entering_.clear();
  kept_.assign(wanted.size(), 1);
  auto old = there.begin();
  for (uint32_t at = 0; at < wanted.size(); ++at) {
    const formats::TileId id = wanted[at]->id;
    while (old != there.end() && (*old)->id < id) ++old;
    if (old != there.end() && (*old)->id == id) continue;
    entering_.push_back({observers.distance(wanted[at]->tile.info().bounds) / world_.levels()[id.level].cell_m, at});
    kept_[at] = 0;
  }
  if (entering_.size() <= tiles_) return wanted;
  waiting_ = static_cast<uint32_t>(entering_.size()) - tiles_;
  std::ranges::nth_element(entering_, entering_.begin() + tiles_, [](const Entering& a, const Entering& b) {
    return a.nearness != b.nearness ? a.nearness < b.nearness : a.at > b.at;  // the coarser levels come last
  });
  for (const Entering& tile : std::span(entering_).first(tiles_)) kept_[tile.at] = 1;
  cut_.clear();
  for (uint32_t at = 0; at < wanted.size(); ++at)
    if (kept_[at]) cut_.push_back(wanted[at]);
  return cut_;
}

}  // namespace ff::runtime
