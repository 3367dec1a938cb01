// What belongs together, by group: numbers of 0 .. n - 1, ascending.
#pragma once
#include <cstddef>
#include <cstdint>
#include <span>

#include "bake/paging.h"

namespace ff::bake {

class Grouped {
 public:
  Grouped() = default;
  // group_of: of each; what is not below `groups` is in none.
  Grouped(std::span<const uint32_t> group_of, size_t groups) : first_(groups + 1) {
    for (const uint32_t g : group_of)
      if (g < groups) ++first_[g + 1];
    for (size_t g = 0; g < groups; ++g) first_[g + 1] += first_[g];
    PagedVector<uint32_t> next(first_.begin(), first_.end() - 1);
    member_.resize(first_.back());
    for (uint32_t i = 0; i < group_of.size(); ++i)
      if (group_of[i] < groups) member_[next[group_of[i]]++] = i;
  }
  std::span<const uint32_t> of(size_t group) const { return std::span(member_).subspan(first_[group], first_[group + 1] - first_[group]); }

 private:
  PagedVector<uint32_t> first_, member_;
};

}  // namespace ff::bake
