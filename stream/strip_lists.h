// Lists of strips that threads hand to each other whole: whoever holds one reads it, and nobody copies it.
#pragma once
#include <memory>
#include <vector>

#include "stream/resident_strip.h"

namespace ff::stream {

// Stays as it is.
using StripList = std::shared_ptr<const std::vector<StripPtr>>;

// Whoever makes them. One thread calls; others hold lists and let go of them at any time.
class StripLists {
 public:
  explicit StripLists(size_t max_strips) : max_strips_(max_strips) {
    for (int k = 0; k < kAtFirst; ++k) add();
  }

  // An empty one that nobody else holds. Takes memory only where more are held than ever before.
  std::shared_ptr<std::vector<StripPtr>> next() {
    for (const auto& list : lists_)
      if (forget(list)) return list;
    return add();
  }
  // Lets go of the strips in lists that nobody holds.
  void forgetIdle() {
    for (const auto& list : lists_) (void)forget(list);
  }

 private:
  static constexpr int kAtFirst = 6;
  // Whether nobody else holds it, so that it is empty now.
  static bool forget(const std::shared_ptr<std::vector<StripPtr>>& list) {
    if (list.use_count() != 1) return false;
    std::shared_ptr<std::vector<StripPtr>>(list).reset();  // all that others have read of it was before
    list->clear();
    return true;
  }
  std::shared_ptr<std::vector<StripPtr>> add() {
    lists_.push_back(std::make_shared<std::vector<StripPtr>>());
    lists_.back()->reserve(max_strips_);
    return lists_.back();
  }

  const size_t max_strips_;
  std::vector<std::shared_ptr<std::vector<StripPtr>>> lists_;
};

}  // namespace ff::stream
