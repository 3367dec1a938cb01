#include "runtime/dense/cut_places.h"

#include <algorithm>

namespace ff::runtime {

CutPlaces::CutPlaces(uint32_t capacity) : slot_of_place_(capacity, kNoSlot) {
  for (auto* list : {&place_of_slot_, &old_place_, &leaving_, &entering_}) list->reserve(kMaxSlots);
  refused_.reserve(kMaxSlots);
  tiles_before_.reserve(kMaxSlots / 16);
}

std::span<const uint32_t> CutPlaces::update(const LocalMatrix& matrix, const MatrixChange& change, bool afresh) {
  matrix_ = &matrix;
  leaving_.clear();
  if (afresh) {
    place_of_slot_.clear();
    clear();
  } else if (change.renumbered) {
    renumber();
  } else {
    for (const SlotRange& range : change.left)
      for (uint32_t s = range.first_slot; s < range.first_slot + range.nodes; ++s) leave(s);
  }
  place_of_slot_.resize(matrix.slots(), kNoPlace);
  for (const uint32_t slot : slot_of_place_)
    if (slot != kNoSlot && !matrix.leaf[slot]) leave(slot);
  tiles_before_ = matrix.tiles;
  refused_.assign(matrix.slots(), 0);
  blocks_.takeUp(matrix);
  leaves_ = static_cast<uint32_t>(matrix.leaves.size());
  waiting_ = leaves_ - taken_;
  return leaving_;
}

void CutPlaces::clear() {
  std::fill(slot_of_place_.begin(), slot_of_place_.end(), kNoSlot);
  std::fill(place_of_slot_.begin(), place_of_slot_.end(), kNoPlace);
  std::fill(refused_.begin(), refused_.end(), uint8_t{0});
  leaving_.clear();
  taken_ = 0;
  waiting_ = leaves_;
}

void CutPlaces::giveUp(uint32_t place) {
  refused_[slot_of_place_[place]] = 1;
  leave(slot_of_place_[place]);
}

void CutPlaces::leave(uint32_t slot) {
  const uint32_t place = place_of_slot_[slot];
  if (place == kNoPlace) return;
  leaving_.push_back(place);
  slot_of_place_[place] = kNoSlot;
  place_of_slot_[slot] = kNoPlace;
  --taken_;
}

// The same nodes under other numbers. Tiles that are no longer there give up their places.
void CutPlaces::renumber() {
  old_place_.swap(place_of_slot_);
  place_of_slot_.assign(matrix_->slots(), kNoPlace);
  for (const SlotRange& old : tiles_before_) {
    const uint32_t now = matrix_->slotOf(old.id.level, old.first_node);
    for (uint32_t i = 0; i < old.nodes; ++i) {
      const uint32_t place = old_place_[old.first_slot + i];
      if (place == kNoPlace) continue;
      slot_of_place_[place] = now != kNoSlot ? now + i : kNoSlot;
      now != kNoSlot ? void(place_of_slot_[now + i] = place) : leaving_.push_back(place);
    }
  }
  for (uint32_t place = 0; place < slot_of_place_.size(); ++place)  // the ambient slot belongs to no tile
    if (slot_of_place_[place] != kNoSlot &&
        (slot_of_place_[place] >= place_of_slot_.size() || place_of_slot_[slot_of_place_[place]] != place)) {
      slot_of_place_[place] = kNoSlot;
      leaving_.push_back(place);
    }
  taken_ -= static_cast<uint32_t>(leaving_.size());
}

uint32_t CutPlaces::choose(uint64_t most) {
  most = std::min<uint64_t>(most, slot_of_place_.size() - taken_);
  entering_.clear();
  next_free_ = 0;
  if (most == 0) return 0;
  for (const uint32_t s : matrix_->leaves) {
    if (entering_.size() == most) break;
    if (place_of_slot_[s] == kNoPlace && !refused_[s]) entering_.push_back(s);
  }
  if (!entering_.empty()) blocks_.collect(entering_, place_of_slot_);
  return static_cast<uint32_t>(entering_.size());
}

EnteringBlock CutPlaces::take(uint32_t first, uint32_t count) {
  for (uint32_t e = first; e < first + count; ++e) {
    while (slot_of_place_[next_free_] != kNoSlot) ++next_free_;
    slot_of_place_[next_free_] = entering_[e];
    place_of_slot_[entering_[e]] = next_free_;
  }
  taken_ += count;
  waiting_ -= count;
  return blocks_.block(first, count, place_of_slot_);
}

void CutPlaces::unseat(uint32_t first, uint32_t count, bool refused) {
  for (uint32_t e = first; e < first + count; ++e) {
    slot_of_place_[place_of_slot_[entering_[e]]] = kNoSlot;
    place_of_slot_[entering_[e]] = kNoPlace;
    refused_[entering_[e]] = refused;
  }
  taken_ -= count;
  if (!refused) waiting_ += count;
  next_free_ = 0;
}

}  // namespace ff::runtime
