#include "formats/parent_links.h"

#include <algorithm>
#include <bit>

namespace ff::formats {

ParentLinks::ParentLinks(std::vector<uint64_t> words, uint32_t nodes) : words_(std::move(words)), nodes_(nodes) {
  ranks_.reserve(words_.size() + 1);
  uint32_t rank = 0;
  for (uint64_t w : words_) {
    ranks_.push_back(rank);
    rank += static_cast<uint32_t>(std::popcount(w));
  }
  ranks_.push_back(rank);
}

uint32_t ParentLinks::parent(uint32_t node) const {
  const uint64_t up_to_node = words_[node / 64] & (~uint64_t{0} >> (63 - node % 64));
  return ranks_[node / 64] + static_cast<uint32_t>(std::popcount(up_to_node)) - 1;
}

uint32_t ParentLinks::select(uint32_t rank) const {
  const auto word = static_cast<size_t>(std::upper_bound(ranks_.begin(), ranks_.end(), rank) - ranks_.begin()) - 1;
  uint64_t w = words_[word];
  for (uint32_t k = ranks_[word]; k < rank; ++k) w &= w - 1;
  return static_cast<uint32_t>(word * 64) + static_cast<uint32_t>(std::countr_zero(w));
}

std::pair<uint32_t, uint32_t> ParentLinks::children(uint32_t parent) const {
  return {select(parent), parent + 1 < parents() ? select(parent + 1) : nodes_};
}

}  // namespace ff::formats
