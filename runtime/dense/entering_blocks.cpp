#include "runtime/dense/entering_blocks.h"

namespace ff::runtime {
namespace {
constexpr uint32_t kNone = 0xffffffffu;
}

EnteringBlocks::EnteringBlocks() {
  for (auto* per_slot : {&refined_of_, &number_}) per_slot->reserve(kMaxSlots);
  leads_.reserve(kMaxSlots);
  sum_.reserve(kMaxSlots);
  for (auto* list : {&met_, &entering_, &row_start_, &column_start_}) list->reserve(kMaxSlots + 1);
  // Some hundred columns for each of some thousand nodes; more is taken when it is met.
  constexpr size_t kEntries = size_t{1} << 19;
  rows_.reserve(kEntries);
  columns_met_.reserve(kEntries);
  columns_.reserve(kEntries);
  for (auto* list : {&block_columns_, &receivers_}) list->reserve(kEntries / 4);
  for (auto* list : {&row_values_, &column_values_}) list->reserve(kEntries / 4);
  for (auto* list : {&places_, &block_row_start_, &block_column_start_}) list->reserve(kMaxBlock + 1);
  albedo_.reserve(kMaxBlock);
}

void EnteringBlocks::takeUp(const LocalMatrix& matrix) {
  matrix_ = &matrix;
  const uint32_t slots = matrix.slots();
  refined_of_.assign(slots, kNone);
  number_.assign(slots, kNone);
  leads_.assign(slots, 0);
  sum_.assign(slots, 0);
  for (uint32_t r = 0; r < matrix.refined.size(); ++r) refined_of_[matrix.refined[r].slot] = r;
}

void EnteringBlocks::spread(uint32_t slot, float value, bool all) {
  if (value == 0 || (!all && !leads_[slot])) return;
  if (refined_of_[slot] == kNone) {
    if (number_[slot] == kNone && place_of_slot_[slot] == kNoPlace) return;
    if (sum_[slot] == 0) met_.push_back(slot);
    sum_[slot] += value;
    return;
  }
  matrix_->forEachChild(matrix_->refined[refined_of_[slot]], [&](uint32_t c) { spread(c, value * matrix_->child_weight[c], all); });
}

void EnteringBlocks::collect(std::span<const uint32_t> entering, std::span<const uint32_t> place_of_slot) {
  const LocalMatrix& m = *matrix_;
  place_of_slot_ = place_of_slot;
  for (const uint32_t slot : entering_)
    if (slot < number_.size()) number_[slot] = kNone;
  entering_.assign(entering.begin(), entering.end());
  for (uint32_t e = 0; e < entering_.size(); ++e) {
    number_[entering_[e]] = e;
    for (uint32_t s = entering_[e]; s != kNoSlot && !leads_[s]; s = m.parent_slot[s]) leads_[s] = 1;
  }
  rows_.clear();
  columns_met_.clear();
  row_start_.assign(1, 0);
  for (const uint32_t i : m.leaves) {
    const bool enters = number_[i] != kNone;
    if (!enters && place_of_slot[i] == kNoPlace) continue;
    for (const uint32_t entry : m.row(i))
      if (const uint32_t count = countOfEntry(entry); count > 0)
        spread(slotOfEntry(entry), static_cast<float>(count) * m.row_scale[i], enters);
    for (const uint32_t j : met_) {
      if (enters) rows_.push_back({j, sum_[j]});
      if (number_[j] != kNone) columns_met_.push_back({number_[j], i, sum_[j]});
      sum_[j] = 0;
    }
    met_.clear();
    if (enters) row_start_.push_back(static_cast<uint32_t>(rows_.size()));
  }
  FF_CHECK_EQ(row_start_.size(), entering_.size() + 1);
  column_start_.assign(entering_.size() + 1, 0);
  for (const Met& met : columns_met_) ++column_start_[met.number + 1];
  for (size_t e = 0; e < entering_.size(); ++e) column_start_[e + 1] += column_start_[e];
  columns_.resize(columns_met_.size());
  for (const Met& met : columns_met_) columns_[column_start_[met.number]++] = {met.receiver, met.value};
  for (size_t e = entering_.size(); e > 0; --e) column_start_[e] = column_start_[e - 1];
  column_start_[0] = 0;
  for (const uint32_t slot : entering_)
    for (uint32_t s = slot; s != kNoSlot && leads_[s]; s = m.parent_slot[s]) leads_[s] = 0;
}

EnteringBlock EnteringBlocks::block(uint32_t first, uint32_t count, std::span<const uint32_t> place_of_slot) {
  for (auto* list : {&places_, &block_columns_, &receivers_}) list->clear();
  for (auto* list : {&row_values_, &column_values_}) list->clear();
  albedo_.clear();
  block_row_start_.assign(1, 0);
  block_column_start_.assign(1, 0);
  for (uint32_t e = first; e < first + count; ++e) {
    places_.push_back(place_of_slot[entering_[e]]);
    albedo_.push_back(matrix_->albedo[entering_[e]]);
    for (uint32_t k = row_start_[e]; k < row_start_[e + 1]; ++k) {
      if (place_of_slot[rows_[k].slot] == kNoPlace) continue;
      block_columns_.push_back(place_of_slot[rows_[k].slot]);
      row_values_.push_back(rows_[k].value);
    }
    block_row_start_.push_back(static_cast<uint32_t>(block_columns_.size()));
    for (uint32_t k = column_start_[e]; k < column_start_[e + 1]; ++k) {
      const uint32_t i = columns_[k].slot;
      if (place_of_slot[i] == kNoPlace || (number_[i] >= first && number_[i] < first + count)) continue;
      receivers_.push_back(place_of_slot[i]);
      column_values_.push_back(columns_[k].value);
    }
    block_column_start_.push_back(static_cast<uint32_t>(receivers_.size()));
  }
  return {places_,    albedo_,       block_row_start_, block_columns_, row_values_, block_column_start_,
          receivers_, column_values_};
}

}  // namespace ff::runtime
